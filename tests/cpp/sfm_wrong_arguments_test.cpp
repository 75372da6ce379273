// Wrong arguments of public functions raise InputError and never a signal.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <utility>
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
#include "gsut/cameras/ray_jacobian.h"
#include "gsut/projection/project_moving.h"
#include "gsut/raster/lens_gradients.h"
#include "gsut/raster/reference/reference.h"
#include "gsut/raster/render.h"
#include "gsut/raster/surroundings.h"
#include "gsut/sfm/absolute_pose.h"
#include "gsut/sfm/bundle.h"
#include "gsut/sfm/match.h"
#include "gsut/sfm/refine_structure.h"
#include "gsut/sfm/relative_pose.h"
#include "gsut/sfm/structure.h"
#include "gsut/sfm/tracks.h"
#include "gsut/surface/depth_view.h"
#include "gsut/surface/triangle_tree.h"
#include "random_gaussians.h"
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
  const auto adam = [](int active, std::vector<double> rates) {
    static float value = 0;
    return AdamGroup{&value, &value, &value, &value, 1, active, std::move(rates)};
  };
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
      {"bundle's point beyond",
       [] {
         Bundle bundle = MakeBundle(WideLens(), 3, 20, 16);
         bundle.observations[0].point = 20;
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
      {"beta 1",
       [] {
         AdamStep({}, 1, 1, nullptr, {1.0, 0.999, 1e-15});
       }},
      {"columns beyond", [adam] { AdamStep({adam(2, {1e-2})}, 1, 1, nullptr); }},
      {"two rates",
       [adam] {
         AdamStep({adam(1, {1e-2, 1e-2})}, 1, 1, nullptr);
       }},
      {"rate of NaN", [adam] { AdamStep({adam(1, {NAN})}, 1, 1, nullptr); }},
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

// A small picture of two Gaussians, rendered for gradients, and what its calls write to.
struct Picture {
  Camera camera{"pinhole", {8, 8, 8, 8}, kSide, kSide};
  testing_scenes::OwnedGaussians<float> gaussians{2}, gradients{2}, of_one{1};
  testing_scenes::OwnedGaussians<double> exact{2}, to_exact{2}, to_one{1};
  std::vector<float> image = std::vector<float>(3 * kSide * kSide);
  std::vector<double> to_image = std::vector<double>(3 * kSide * kSide);
  std::vector<std::uint8_t> touched = std::vector<std::uint8_t>(2);
  ViewRays view = MakeViewRays(camera, Pose());
  double numbers[64] = {};
  float floats[64] = {};
  Renderer renderer;

  RenderJob Job() {
    RenderJob job{camera, Pose()};
    job.image = image.data();
    return job;
  }
  Renderer* Rendered() {
    renderer.Render(gaussians.View(), Job());
    return &renderer;
  }
  void RenderWith(const std::function<void(RenderJob*)>& change) {
    RenderJob job = Job();
    change(&job);
    renderer.Render(gaussians.View(), job);
  }
  void Backward(const ImageGradients& to_pixels, const GradientRows& rows) {
    Rendered()->Backward(to_pixels, rows, nullptr);
  }
  void ExactBackward(const ReferenceGradients& to, const GaussiansView<double>& rows) {
    RenderReferenceBackward(exact.View(), camera, Pose(), {}, to, rows, numbers);
  }
};

std::vector<WrongCall> ListWrongRenders() {
  static Picture p;
  static const RayGradients none;
  static const std::vector<int> beyond = {99};
  static RenderSettings below_0;
  below_0.sh_degree = -1;
  return {
      {"Gaussians null", [] { p.renderer.Render({.size = 2}, p.Job()); }},
      {"Gaussians below 0", [] { p.renderer.Render({.size = -2}, p.Job()); }},
      {"harmonics of 5",
       [] {
         GaussiansView<const float> view = p.gaussians.View();
         view.sh_coefficients = 5;
         p.renderer.Render(view, p.Job());
       }},
      {"image null", [] { p.RenderWith([](RenderJob* job) { job->image = nullptr; }); }},
      {"degree below 0",
       [] { p.RenderWith([](RenderJob* job) { job->settings.sh_degree = -1; }); }},
      {"channels below 0", [] { p.RenderWith([](RenderJob* job) { job->channels.count = -1; }); }},
      {"channels null", [] { p.RenderWith([](RenderJob* job) { job->channels.count = 2; }); }},
      {"background null",
       [] { p.RenderWith([](RenderJob* job) {
              job->channels = {2, p.floats, nullptr};
            }); }},
      {"no render before", [] { Renderer().Backward({p.floats}, {}, nullptr); }},
      {"gradient to the image null",
       [] {
         p.Backward({nullptr}, {p.gradients.MutableView(), p.touched.data()});
       }},
      {"gradients null",
       [] {
         p.Backward({p.image.data()}, {{.size = 2}, p.touched.data()});
       }},
      {"gradients of one",
       [] {
         p.Backward({p.image.data()}, {p.of_one.MutableView(), p.touched.data()});
       }},
      {"touched null",
       [] {
         p.Backward({p.image.data()}, {p.gradients.MutableView(), nullptr});
       }},
      {"rays null", [] { p.Rendered()->Rays(nullptr, nullptr); }},
      {"pixel beyond",
       [] {
         const std::uint32_t pixels[] = {kSide * kSide};
         p.Rendered()->Jacobian(pixels, p.numbers, p.numbers);
       }},
      {"significance null",
       [] { p.Rendered()->AddSignificance(nullptr, nullptr, nullptr, nullptr); }},
      {"Fisher null", [] { p.Rendered()->AddFisher(nullptr, nullptr); }},
      {"photograph null", [] { p.Rendered()->AddSupport(nullptr, nullptr, p.numbers); }},
      {"map null", [] { p.Rendered()->AddFeatures(nullptr, 1, p.floats); }},
      {"map of no values", [] { p.Rendered()->AddFeatures(p.image.data(), 0, p.floats); }},
      {"normals of one",
       [] { p.Rendered()->SurfaceBackward(p.image.data(), p.of_one.MutableView()); }},
      {"exact Gaussians null", [] { RenderReference({.size = 2}, p.view, {}); }},
      {"rays of no image", [] { RenderReference(p.exact.View(), ViewRays(), {}); }},
      {"exact degree below 0", [] { RenderReference(p.exact.View(), p.view, below_0); }},
      {"exact channels null",
       [] { RenderReference(p.exact.View(), p.view, {}, nullptr, {.count = 2}); }},
      {"exact gradient null", [] { p.ExactBackward({nullptr}, p.to_exact.MutableView()); }},
      {"exact gradients of one",
       [] { p.ExactBackward({p.to_image.data()}, p.to_one.MutableView()); }},
      {"exact gradients null", [] { p.ExactBackward({p.to_image.data()}, {.size = 2}); }},
      {"gradients of no ray", [] { ChainToLens(p.view, p.camera, Pose(), none); }},
      {"gradients of no ray, poses",
       [] { ChainToPoses(p.view, p.camera, Pose(), none, {}, p.numbers); }},
      {"rays of another image",
       [] {
         ChainToLens(p.view, p.camera.Resized(8, 8), Pose(), {p.to_image, p.to_image});
       }},
      {"derivatives of rays null",
       [] { RayJacobian(p.camera, 1, nullptr, nullptr, {}, nullptr, nullptr, nullptr); }},
      {"derivative by no parameter",
       [] {
         RayJacobian(p.camera, 1, p.numbers, nullptr, beyond, p.numbers, nullptr, p.touched.data());
       }},
      {"surroundings null",
       [] { ComputeSurroundings(kSide, kSide, nullptr, nullptr, nullptr, nullptr); }},
      {"surroundings of no image",
       [] { ComputeSurroundings(0, kSide, p.floats, p.floats, p.touched.data(), p.floats); }},
      {"splats null", [] { Project(p.gaussians.View(), p.camera, Pose(), {}, {}, nullptr); }},
      {"projected Gaussians null",
       [] {
         Splats splats;
         Project({.size = 2}, p.camera, Pose(), {}, {}, &splats);
       }},
      {"exact splats null",
       [] { ProjectReference(p.exact.View(), p.camera, {}, {}, nullptr, nullptr, nullptr); }},
      {"moving means null",
       [] {
         ProjectMoving(p.exact.View(), p.camera, Pose(), {}, nullptr, nullptr, nullptr, nullptr);
       }},
      {"points null", [] { p.camera.Project(2, nullptr, nullptr, nullptr); }},
      {"column beyond",
       [] {
         p.camera.ProjectJacobian(1, p.numbers, p.numbers, p.touched.data(), nullptr, p.numbers,
                                  beyond);
       }},
      {"pixels below 0", [] { p.camera.Unproject(-2, p.numbers, p.numbers, p.touched.data()); }},
  };
}

// Structures and bundles whose lists do not fit each other.
std::vector<WrongCall> ListWrongStructures() {
  static const std::vector<Camera> cameras = {WideLens()};
  static const std::vector<ImageFeatures> images(3);
  static const std::vector<Pose> poses(3);
  const auto refine = [](const std::function<void(StructureOptions*)>& change) {
    StructureOptions options;
    change(&options);
    RefineStructure(cameras, images, {}, poses, {}, options, {});
  };
  return {
      {"no cameras", [] { EstimatePoses({}, images, {}, {}, {}); }},
      {"poses of no image", [] { RefineStructure(cameras, images, {}, {}, {}, {}, {}); }},
      {"pair of unknown images",
       [] {
         std::vector<VerifiedPair> pairs(1);
         pairs[0].second = 9;
         pairs[0].matches.resize(1);
         EstimatePoses(cameras, images, pairs, {}, {});
       }},
      {"readouts of one image",
       [=] { refine([](StructureOptions* options) { options->image_readouts = {1.0}; }); }},
      {"places of one image", [=] { refine([](StructureOptions* o) { o->places.resize(1); }); }},
      {"stated point of no image",
       [=] { refine([](StructureOptions* o) {
               o->stated_points = {{{9, 0}, {}, {}}};
             }); }},
      {"turn of no image",
       [=] { refine([](StructureOptions* o) { o->turns.resize(1), o->turns[0].second = 9; }); }},
      {"mounts without priors",
       [] {
         Bundle bundle;
         bundle.camera_from_body.resize(2);
         BundleOptions options;
         options.mount_priors.resize(1);
         AdjustBundle(&bundle, options);
       }},
  };
}

TEST(WrongArgumentsTest, EveryCallRaisesInputError) {
  std::vector<WrongCall> calls = ListWrongCalls();
  for (const auto& list : {ListWrongRenders(), ListWrongStructures()}) {
    calls.insert(calls.end(), list.begin(), list.end());
  }
  ASSERT_GT(calls.size(), 80u);
  for (const WrongCall& wrong : calls) EXPECT_THROW(wrong.call(), InputError) << wrong.name;
}

TEST(WrongArgumentsTest, EmptyBundleIsLeftAsItIs) {
  Bundle bundle;
  EXPECT_EQ(AdjustBundle(&bundle, {}).iterations, 0);
}

}  // namespace
}  // namespace gsut
