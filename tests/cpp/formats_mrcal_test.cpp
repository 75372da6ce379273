// Reading and writing .cameramodel against libmrcal, on real files; skipped where either is absent.
#include <gtest/gtest.h>
#include <unistd.h>

#include "gsut/base/errors.h"
#include "gsut/formats/camera_model.h"

#ifdef GSUT_HAVE_MRCAL
extern "C" {
#include <mrcal/mrcal.h>
}
#endif

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

namespace gsut {
namespace {

#ifdef GSUT_HAVE_MRCAL

// gsut's pixels minus mrcal's: (0.5, 0.5) against (0, 0) is the centre of the first pixel.
constexpr double kPixelShift = 0.5;
// Doubles of size 4000 through the same formula in another order; worst observed 1.9e-12.
constexpr double kSamePixel = 3.8e-12;
constexpr int kAcross = 24;  // grid of directions

struct FreeModel {
  void operator()(mrcal_cameramodel_t* model) const { mrcal_free_cameramodel(&model); }
};
using MrcalModel = std::unique_ptr<mrcal_cameramodel_t, FreeModel>;

std::vector<std::filesystem::path> RealFiles() {
  const char* shared = std::getenv("GSUT_SHARED");
  std::vector<std::filesystem::path> files;
  std::error_code error;
  const std::filesystem::path folder =
      std::filesystem::path(shared == nullptr ? "../shared" : shared) / "data/lenses/mrcal";
  for (const auto& entry : std::filesystem::directory_iterator(folder, error)) {
    if (entry.path().extension() == ".cameramodel") files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  return files;
}

CameraModelFile ReadByGsut(const std::filesystem::path& path) {
  std::ostringstream text;
  text << std::ifstream(path).rdbuf();
  return ParseCameraModel(text.str(), path.string());
}

MrcalModel ReadByMrcal(const std::string& path) {
  return MrcalModel(mrcal_read_cameramodel_file(path.c_str()));
}

// Unit rays of a grid over the image.
std::vector<double> RaysOver(const Camera& camera) {
  std::vector<double> pixels, rays, kept;
  for (int y = 0; y < kAcross; ++y) {
    for (int x = 0; x < kAcross; ++x) {
      pixels.push_back((x + 0.5) * camera.width() / kAcross);
      pixels.push_back((y + 0.5) * camera.height() / kAcross);
    }
  }
  rays.resize(3 * kAcross * kAcross);
  std::vector<std::uint8_t> valid(kAcross * kAcross);
  camera.Unproject(kAcross * kAcross, pixels.data(), rays.data(), valid.data());
  for (int i = 0; i < kAcross * kAcross; ++i) {
    if (valid[i]) kept.insert(kept.end(), rays.begin() + 3 * i, rays.begin() + 3 * i + 3);
  }
  return kept;
}

// Largest distance of a coordinate between gsut's projection and libmrcal's.
double WorstDistance(const Camera& camera, const mrcal_cameramodel_t& model,
                     const std::vector<double>& rays) {
  const auto count = static_cast<std::int64_t>(rays.size() / 3);
  std::vector<double> pixels(2 * count);
  std::vector<std::uint8_t> valid(count);
  camera.Project(count, rays.data(), pixels.data(), valid.data());
  std::vector<mrcal_point2_t> found(count);
  const bool ok = mrcal_project(found.data(), nullptr, nullptr,
                                reinterpret_cast<const mrcal_point3_t*>(rays.data()),
                                static_cast<int>(count), &model.lensmodel, model.intrinsics);
  EXPECT_TRUE(ok);
  double worst = 0.0;
  for (std::int64_t i = 0; i < count; ++i) {
    EXPECT_TRUE(valid[i]);
    worst = std::max({worst, std::abs(pixels[2 * i] - kPixelShift - found[i].x),
                      std::abs(pixels[2 * i + 1] - kPixelShift - found[i].y)});
  }
  return worst;
}

void ExpectSame(const CameraModelFile& file, const mrcal_cameramodel_t& model) {
  EXPECT_EQ(file.camera.width(), static_cast<int>(model.imagersize[0]));
  EXPECT_EQ(file.camera.height(), static_cast<int>(model.imagersize[1]));
  for (int i = 0; i < 6; ++i) EXPECT_EQ(file.extrinsics[i], model.rt_cam_ref[i]);
}

class RealCameraModel : public testing::Test {
 protected:
  void SetUp() override {
    files_ = RealFiles();
    if (files_.empty()) {
      GTEST_SKIP() << "no .cameramodel files of mrcal: set GSUT_SHARED to the shared data";
    }
  }
  std::vector<std::filesystem::path> files_;
};

TEST_F(RealCameraModel, ReadFileProjectsAsLibmrcal) {
  for (const auto& path : files_) {
    SCOPED_TRACE(path.string());
    const CameraModelFile file = ReadByGsut(path);
    const MrcalModel model = ReadByMrcal(path.string());
    ASSERT_NE(model, nullptr);
    ExpectSame(file, *model);
    const std::vector<double> rays = RaysOver(file.camera);
    ASSERT_GT(rays.size(), 3U * kAcross * kAcross / 2);
    EXPECT_LT(WorstDistance(file.camera, *model, rays), kSamePixel);
  }
}

TEST_F(RealCameraModel, WrittenFileIsReadByLibmrcalWithTheSameNumbers) {
  const std::filesystem::path written =
      testing::TempDir() + "gsut_mrcal_" + std::to_string(getpid()) + ".cameramodel";
  for (const auto& path : files_) {
    SCOPED_TRACE(path.string());
    CameraModelFile file = ReadByGsut(path);
    file.camera = file.camera.WithValidFieldAngle(1.25);  // a key that mrcal does not know
    file.valid_region = {{1.0, 2.0}, {30.5, 2.0}, {30.5, 40.0}, {1.0, 2.0}};
    std::ofstream(written) << FormatCameraModel(file);
    const MrcalModel before = ReadByMrcal(path.string());
    const MrcalModel after = ReadByMrcal(written.string());
    ASSERT_NE(after, nullptr);
    ExpectSame(file, *after);
    EXPECT_EQ(after->lensmodel.type, before->lensmodel.type);
    const int count = mrcal_lensmodel_num_params(&before->lensmodel);
    ASSERT_EQ(mrcal_lensmodel_num_params(&after->lensmodel), count);
    for (int i = 0; i < count; ++i) {
      // The centre passes through gsut's pixels: the half is added and taken off again.
      EXPECT_NEAR(after->intrinsics[i], before->intrinsics[i], i == 2 || i == 3 ? 1e-12 : 0.0);
    }
    const CameraModelFile again = ReadByGsut(written);
    EXPECT_TRUE(again.camera == file.camera);
    EXPECT_EQ(again.valid_region, file.valid_region);
  }
  std::filesystem::remove(written);
}

TEST_F(RealCameraModel, CutOffFileIsRefusedByBoth) {
  const std::filesystem::path cut =
      testing::TempDir() + "gsut_mrcal_cut_" + std::to_string(getpid()) + ".cameramodel";
  std::filesystem::copy_file(files_.front(), cut,
                             std::filesystem::copy_options::overwrite_existing);
  std::filesystem::resize_file(cut, std::filesystem::file_size(cut) / 2);
  EXPECT_EQ(ReadByMrcal(cut.string()), nullptr);
  EXPECT_THROW(ReadByGsut(cut), CalibrationError);
  std::filesystem::remove(cut);
}

#else

TEST(RealCameraModel, ReadAndWrittenFilesAgreeWithLibmrcal) {
  GTEST_SKIP() << "libmrcal is not installed: apt-get install libmrcal-dev";
}

#endif

}  // namespace
}  // namespace gsut
