// Feeds the parsers with damaged files, under whatever sanitizer this is built with: a file is read
// or refused by InputError. GSUT_FUZZ_FILES: how many of each kind; GSUT_FUZZ_SEED: of the damage.
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <sstream>
#include <string>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/base/rng.h"
#include "gsut/formats/camera_model.h"
#include "gsut/formats/ply.h"
#include "gsut/gaussians/harmonics.h"

namespace gsut {
namespace {

constexpr std::int64_t kMostRows = 1 << 20;  // of a file of some kilobytes

std::uint64_t Setting(const char* name, std::uint64_t otherwise) {
  const char* text = std::getenv(name);
  return text == nullptr ? otherwise : std::strtoull(text, nullptr, 10);
}

class Damage {
 public:
  explicit Damage(std::uint64_t stream) : rng_(Setting("GSUT_FUZZ_SEED", 1), stream) {}

  std::string Of(std::string content) {
    const int changes = 1 + static_cast<int>(Below(4));
    for (int i = 0; i < changes; ++i) content = Changed(std::move(content));
    return content;
  }

 private:
  std::size_t Below(std::size_t count) {
    return static_cast<std::size_t>(rng_.Uniform(next_++) * static_cast<double>(count));
  }

  std::string Changed(std::string content) {
    static const std::array<const char*, 14> kWords = {"0",
                                                       "-1",
                                                       "nan",
                                                       "inf",
                                                       "1e308",
                                                       "1e-320",
                                                       "9223372036854775807",
                                                       "4294967296",
                                                       "\n",
                                                       "list uchar int",
                                                       "double",
                                                       "end_header\n",
                                                       "element vertex 9\n",
                                                       "]}("};
    const std::size_t begin = Below(content.size() + 1);
    constexpr std::array<std::size_t, 4> kLengths = {1, 4, 16, 200};
    const std::size_t length = std::min(content.size() - begin, kLengths[Below(4)]);
    switch (Below(7)) {
      case 0:
        return content.substr(0, begin);
      case 1:
        return content.erase(begin, length);
      case 2:
        return content.insert(begin, content.substr(begin, length));
      case 3:
        for (std::size_t i = 0; i < length; ++i) content[begin + i] = static_cast<char>(Below(256));
        return content;
      case 4:
        if (length > 0) content[begin] = static_cast<char>(content[begin] ^ (1 << Below(8)));
        return content;
      case 5:
        return content.replace(begin, length, kWords[Below(kWords.size())]);
      default: {  // a number becomes another
        const std::size_t digit = content.find_first_of("0123456789", begin);
        if (digit == std::string::npos) return content;
        const std::size_t end = content.find_first_not_of("0123456789.e+-", digit);
        return content.replace(digit, end == std::string::npos ? end : end - digit,
                               kWords[Below(8)]);
      }
    }
  }

  Rng rng_;
  std::uint64_t next_ = 0;
};

// How many damaged forms of the content were read; anything but InputError fails the test.
std::int64_t Feed(const std::string& content, std::uint64_t stream,
                  const std::function<void(const std::string&)>& parse) {
  Damage damage(stream);
  std::int64_t read = 0;
  parse(content);  // as it is, it is read
  const std::uint64_t files = Setting("GSUT_FUZZ_FILES", 300);
  for (std::uint64_t i = 0; i < files; ++i) {
    const std::string damaged = damage.Of(content);
    try {
      parse(damaged);
      ++read;
    } catch (const InputError& error) {
      EXPECT_GT(std::string(error.what()).size(), 10U);
    }
  }
  return read;
}

class FormatsFuzz : public testing::Test {
 protected:
  std::string path_ = testing::TempDir() + "gsut_fuzz_" + std::to_string(getpid()) + ".ply";
  void TearDown() override { std::remove(path_.c_str()); }

  void Write(const std::string& content) const {
    std::ofstream(path_, std::ios::binary | std::ios::trunc) << content;
  }
  std::string Content() const {
    std::ostringstream content;
    content << std::ifstream(path_, std::ios::binary).rdbuf();
    return content.str();
  }
  void ReadGaussians(const std::string& content) const {
    Write(content);
    PlyGaussianReader reader(path_);
    const std::int64_t n = reader.size();
    ASSERT_LE(n, kMostRows);
    const int k = reader.sh_coefficients();
    std::vector<float> means(3 * n), quats(4 * n), scales(3 * n), logits(n), sh(3 * n * k);
    reader.Read({n, k, means.data(), quats.data(), scales.data(), logits.data(), sh.data()});
  }
};

TEST_F(FormatsFuzz, GaussiansOfDamagedPlyFiles) {
  std::vector<float> values(600, 0.25f);
  for (const int k : {1, 16}) {
    WritePly(path_,
             {5, k, values.data(), values.data(), values.data(), values.data(), values.data()},
             {"a comment"});
    Feed(Content(), k, [this](const std::string& content) { ReadGaussians(content); });
  }
}

TEST_F(FormatsFuzz, PointsOfDamagedPlyFiles) {
  const std::string properties =
      "property float x\nproperty double y\nproperty float z\nproperty uchar red\n"
      "property uchar green\nproperty uchar blue\n";
  const std::string rows = "element vertex 3\n" + properties + "element face 1\n" +
                           "property list uchar int vertex_indices\nend_header\n";
  const std::string text =
      "ply\nformat ascii 1.0\n" + rows + "0 1 2 9 9 9\n1 2 3 9 9 9\n3 4 5 250 1 2\n3 0 1 2\n";
  const std::string binary =
      "ply\nformat binary_little_endian 1.0\n" + rows + std::string(3 * 19 + 13, '\3');
  std::uint64_t stream = 100;
  for (const std::string& content : {text, binary}) {
    Feed(content, ++stream, [this](const std::string& damaged) {
      Write(damaged);
      ASSERT_LE(ReadPlyPoints(path_).positions.size(), 3 * kMostRows);
    });
  }
}

TEST_F(FormatsFuzz, DamagedCameraModels) {
  const std::string content =
      "{ 'lensmodel': 'LENSMODEL_OPENCV4', 'intrinsics': [ 90, 91, 50, 40, 0.1, -0.02, 1e-3, "
      "2e-4,], 'extrinsics': [0, 0, 0, 0, 0, 0], 'imagersize': [100, 80], 'note': r'it\\'s', }\n";
  Feed(content, 200, [](const std::string& text) { ParseCameraModel(text, "lens.cameramodel"); });
}

}  // namespace
}  // namespace gsut
