// Wrong arguments of public functions raise InputError and never a signal.
#include <gtest/gtest.h>

#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/base/isa.h"
#include "gsut/base/parallel.h"
#include "gsut/cameras/camera.h"
#include "gsut/gaussians/seed.h"
#include "gsut/loss/light.h"
#include "gsut/loss/metrics.h"
#include "gsut/loss/photometric.h"
#include "gsut/optimize/adam.h"
#include "gsut/optimize/compact.h"
#include "gsut/optimize/palette.h"
#include "gsut/sfm/absolute_pose.h"
#include "gsut/sfm/bundle.h"
#include "gsut/sfm/match.h"
#include "gsut/sfm/relative_pose.h"
#include "gsut/sfm/tracks.h"
#include "gsut/surface/depth_view.h"
#include "gsut/surface/triangle_tree.h"
#include "synthetic_bundle.h"

namespace gsut {
namespace {

constexpr int kSide = 16;  // pixels of the images here, above the window of SSIM

struct WrongCall {
  std::string name;
  std::function<void()> call;
};

// An observation of an image that is not there.
Bundle BundleWithoutImages() {
  Bundle bundle;
  bundle.observations.emplace_back();
  return bundle;
}

std::vector<WrongCall> ListWrongCalls() {
  static const Camera camera = WideLens();
  static const std::vector<float> grey(3 * kSide * kSide, 0.5F);
  static const std::vector<double> image(grey.begin(), grey.end());
  static const std::vector<Bearing> bearings(8);
  static const std::vector<Eigen::Vector3d> points(7);
  static const PhotometricTarget target(grey.data(), kSide, kSide, nullptr, {});
  static const TriangleTree tree({0, 0, 0, 1, 0, 0, 0, 1, 0}, {0, 1, 2});
  static const std::vector<std::uint32_t> beyond = {0, 5};
  static double numbers[6] = {};
  static std::int64_t found[2] = {};
  static GaussianArrays gaussians(2, 1);
  const auto view = [] { return gaussians.View().AsConst(); };
  return {
      {"threads below 0", [] { SetNumThreads(-5); }},
      {"unknown instruction set", [] { SetIsa("none"); }},
      {"unknown lens", [] { Camera("none", {}, 4, 4); }},
      {"lens without parameters", [] { Camera("pinhole", {}, 4, 4); }},
      {"lens of negative size",
       [] {
         Camera("pinhole", {1, 1, 0, 0}, -4, 4);
       }},
      {"bundle null", [] { AdjustBundle(nullptr, {}); }},
      {"bundle without images",
       [] {
         Bundle bundle = BundleWithoutImages();
         AdjustBundle(&bundle, {});
       }},
      {"covariances without images", [] { PoseCovariances(BundleWithoutImages(), {}); }},
      {"bearings and points", [] { EstimateAbsolutePose(bearings, points, {}); }},
      {"bearings and points of a refined pose",
       [] { RefineAbsolutePose({}, std::span(bearings).first(3), points, 1.0); }},
      {"bearings of two images",
       [] { EstimateRelativePose(bearings, std::span(bearings).first(3), {}); }},
      {"descriptors null", [] { MatchDescriptors(nullptr, 2, nullptr, 0, {}); }},
      {"descriptors below 0", [] { MatchDescriptors(nullptr, 0, nullptr, -2, {}); }},
      {"tracks of no image",
       [] {
         const std::vector<TrackJoin> joins(1);
         JoinTracks({}, joins);
       }},
      {"image null of PSNR", [] { Psnr(nullptr, image.data(), nullptr, nullptr, kSide, kSide); }},
      {"height below 0", [] { Psnr(image.data(), image.data(), nullptr, nullptr, -1, kSide); }},
      {"image null of SSIM", [] { Ssim(image.data(), nullptr, nullptr, kSide, kSide); }},
      {"target null",
       [] {
         const float* none = nullptr;
         PhotometricTarget(none, kSide, kSide, nullptr, {});
       }},
      {"image null of the loss", [] { PhotometricLoss(target, nullptr, 0.2, nullptr); }},
      {"image null of light",
       [] {
         LightSums sums;
         SumLight(target, nullptr, nullptr, 1, &sums);
       }},
      {"bins below 0", [] { SumLight(target, grey.data(), nullptr, -1, nullptr); }},
      {"step 0", [] { AdamStep({}, 1, 0, nullptr); }},
      {"merged rows beyond", [view] { MergePairs(view(), beyond, nullptr, 1, {}); }},
      {"herded rows beyond", [view] { HerdPaper(view(), beyond, {}); }},
      {"Gaussians null", [] { HerdPaper({.size = 2, .sh_coefficients = 1}, {0}, {}); }},
      {"palette null", [] { MakePalette(nullptr, 2, 3, {}); }},
      {"palette below 0", [] { MakePalette(grey.data(), -2, 3, {}); }},
      {"seeds null", [] { SeedFromPoints(nullptr, nullptr, {}, gaussians.View()); }},
      {"depth null",
       [] {
         DepthView(camera, {}, nullptr, nullptr, {0, 0, 0});
       }},
      {"mesh without faces", [] { TriangleTree({}, {}); }},
      {"face beyond",
       [] {
         TriangleTree({0, 0, 0}, {0, 0, 7});
       }},
      {"half a face",
       [] {
         TriangleTree({0, 0, 0}, {0, 0});
       }},
      {"queries null", [] { tree.Nearest(1, nullptr, numbers, found); }},
      {"rays below 0", [] { tree.Cast(-1, numbers, numbers, numbers, found); }},
      {"labels null", [] { LabelParts(2, 0, nullptr, nullptr); }},
      {"labelled face beyond",
       [] {
         const std::uint32_t faces[3] = {0, 1, 9};
         std::uint32_t labels[2] = {};
         LabelParts(2, 1, faces, labels);
       }},
  };
}

TEST(WrongArgumentsTest, EveryCallRaisesInputError) {
  const std::vector<WrongCall> calls = ListWrongCalls();
  ASSERT_GT(calls.size(), 35u);
  for (const WrongCall& wrong : calls) EXPECT_THROW(wrong.call(), InputError) << wrong.name;
}

TEST(WrongArgumentsTest, EmptyBundleIsLeftAsItIs) {
  Bundle bundle;
  EXPECT_EQ(AdjustBundle(&bundle, {}).iterations, 0);
}

}  // namespace
}  // namespace gsut
