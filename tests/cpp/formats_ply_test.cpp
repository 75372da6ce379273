// Tests the C++ interface of gsut/formats/ply; files of all kinds are tested from Python.
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/formats/ply.h"

namespace gsut {
namespace {

// Ten rows of consecutive numbers, K coefficients.
struct Scene {
  explicit Scene(int coefficients) {
    const std::size_t widths[5] = {3, 4, 3, 1, 3 * static_cast<std::size_t>(coefficients)};
    float value = 0.1f;
    for (int k = 0; k < 5; ++k) {
      for (std::size_t i = 0; i < 10 * widths[k]; ++i) arrays[k].push_back(value += 1.7f);
    }
    view = {10,
            coefficients,
            arrays[0].data(),
            arrays[1].data(),
            arrays[2].data(),
            arrays[3].data(),
            arrays[4].data()};
  }
  std::vector<float> arrays[5];
  GaussiansView<float> view;
};

class PlyTest : public testing::Test {
 protected:
  // Its own file a process: ctest runs tests side by side.
  std::string path_ = testing::TempDir() + "gsut_ply_" + std::to_string(getpid()) + ".ply";
  void TearDown() override { std::remove(path_.c_str()); }
};

TEST_F(PlyTest, RoundTripKeepsEveryBit) {
  int cases = 0;
  for (const int coefficients : {1, 4, 9, 16}) {
    const Scene written(coefficients);
    WritePly(path_, written.view.AsConst(), {"comment"});
    EXPECT_FALSE(std::filesystem::exists(path_ + ".partial"));
    PlyGaussianReader reader(path_);
    ASSERT_EQ(reader.size(), 10);
    ASSERT_EQ(reader.sh_coefficients(), coefficients);
    Scene found(coefficients);
    for (auto& array : found.arrays) std::fill(array.begin(), array.end(), 0.0f);
    EXPECT_EQ(reader.Read(found.view), 0);
    for (int k = 0; k < 5; ++k) EXPECT_EQ(found.arrays[k], written.arrays[k]);
    ++cases;
  }
  EXPECT_EQ(cases, 4);
}

TEST_F(PlyTest, FailedWriteKeepsTheOldFile) {
  const Scene scene(1);
  WritePly(path_, scene.view.AsConst());
  const auto size = std::filesystem::file_size(path_);
  std::filesystem::create_directory(path_ + ".partial");  // the temporary file cannot be opened
  EXPECT_THROW(WritePly(path_, Scene(4).view.AsConst()), InputError);
  std::filesystem::remove(path_ + ".partial");
  EXPECT_EQ(std::filesystem::file_size(path_), size);
}

TEST_F(PlyTest, PointsWithoutColorsAreGrey) {
  std::ofstream(path_) << "ply\nformat ascii 1.0\nelement vertex 1\nproperty int x\n"
                          "property int y\nproperty int z\nend_header\n1 -2 +3\n";
  const PlyPoints points = ReadPlyPoints(path_);
  EXPECT_EQ(points.unusual_white, 0.0);
  EXPECT_EQ(points.positions, (std::vector<double>{1, -2, 3}));
  EXPECT_EQ(points.colors, (std::vector<std::uint8_t>{128, 128, 128}));
}

}  // namespace
}  // namespace gsut
