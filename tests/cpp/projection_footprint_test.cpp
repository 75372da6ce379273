// Tests the footprints of gsut/projection: float against double, boxes against every pixel.
//
// GSUT_FOOTPRINTS=100000 sets the number of Gaussians a lens in the search for missed pixels.
#include "gsut/projection/footprint.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

#include "gsut/base/isa.h"
#include "gsut/base/parallel.h"
#include "gsut/gaussians/activations.h"
#include "random_gaussians.h"

namespace gsut {
namespace {

using namespace testing_scenes;

constexpr ProjectionMethod kAllMethods[] = {ProjectionMethod::kEwa, ProjectionMethod::kUnscented,
                                            ProjectionMethod::kSilhouette};

// A pixel this much above the cut-off, relative, is above it in float, too (see raster_test.cpp).
constexpr double kMissMargin = 2e-3;

// What is drawn at random: from ordinary to hostile. Sizes are standard deviations over distance.
constexpr SceneKind kKinds[] = {
    {"ordinary", 1.0, 6.0, 0.005, 0.2, 0.5, 0.0}, {"small", 1.0, 6.0, 0.0005, 0.02, 0.7, 0.0},
    {"needles", 1.0, 6.0, 0.01, 0.1, 2.5, 1.0},   {"close", 0.05, 0.5, 0.05, 1.0, 0.7, 0.0},
    {"huge", 1.0, 6.0, 0.5, 5.0, 0.7, 0.0},       {"faint", 1.0, 6.0, 0.02, 0.5, 0.7, -5.0},
};

// Gaussians anywhere around the camera: behind, at poles and seams, across the domain's edge.
OwnedGaussians<float> Anywhere(const Pose& pose, std::int64_t n, Draws* draws) {
  OwnedGaussians<float> g(n);
  for (std::int64_t i = 0; i < n; ++i) {
    const std::size_t row = static_cast<std::size_t>(i);
    Eigen::Vector3d direction(draws->Normal(), draws->Normal(), draws->Normal());
    // A third lies on an axis of the camera: where poles, seams and the back are.
    if (draws->Uniform(0, 1) < 0.33) {
      const int axis = static_cast<int>(draws->Index(3));
      const double side = draws->Uniform(0, 1) < 0.5 ? -1.0 : 1.0;
      direction = side * Eigen::Vector3d::Unit(axis) + 0.05 * direction;
    }
    const double distance = draws->LogUniform(0.3, 5.0);
    const double size = distance * draws->LogUniform(0.003, 0.5);
    const Eigen::Vector3d mean =
        pose.rotation.transpose() * (direction.normalized() * distance - pose.translation);
    for (std::size_t k = 0; k < 3; ++k) {
      g.means[3 * row + k] = static_cast<float>(mean[static_cast<int>(k)]);
      g.log_scales[3 * row + k] = static_cast<float>(std::log(size) + draws->Normal());
    }
    for (std::size_t k = 0; k < 4; ++k) {
      g.quats[4 * row + k] = static_cast<float>(draws->Normal());
    }
    g.opacity_logits[row] = static_cast<float>(1.5 * draws->Normal());
  }
  return g;
}

// Pixel centres (u, v) that a box must hold so that it holds every pixel with alpha >= alpha_min,
// found by looking at every pixel: two corners, or on a panorama all of them.
using Seen = std::vector<std::array<double, 2>>;

Seen SeenPixels(const OwnedGaussians<double>& g, std::size_t i, const Camera& camera,
                const Pose& pose, double alpha_min, bool keep_all) {
  double r[9];
  RotationFromQuaternion(&g.quats[4 * i], r);
  const Eigen::Matrix3d axes =
      pose.rotation * Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(r);
  const Eigen::Array3d scale = Eigen::Map<const Eigen::Array3d>(&g.log_scales[3 * i]).exp();
  const Eigen::Matrix3d whiten = scale.inverse().matrix().asDiagonal() * axes.transpose();
  const Eigen::Vector3d center =
      whiten *
      (pose.rotation * Eigen::Map<const Eigen::Vector3d>(&g.means[3 * i]) + pose.translation);
  const double cutoff = 2.0 * std::log(Sigmoid(g.opacity_logits[i]) / alpha_min);
  Seen seen;
  if (!(cutoff > 0.0)) return seen;
  const RayTable& table = camera.Rays();
  std::array<double, 2> low = {1e9, 1e9}, high = {-1e9, -1e9};
  for (std::size_t p = 0; p < table.valid.size(); ++p) {
    if (!table.valid[p]) continue;
    const Eigen::Map<const Eigen::Vector3d> ray(&table.rays[3 * p]);
    const Eigen::Vector3d d = whiten * ray;
    Eigen::Vector3d seen_from = center;
    if (!table.origins.empty()) {
      seen_from -= whiten * Eigen::Map<const Eigen::Vector3d>(&table.origins[3 * p]);
    }
    if (!(seen_from.dot(d) > 0.0)) continue;
    if (!(seen_from.cross(d).squaredNorm() < cutoff * d.squaredNorm())) continue;
    const std::size_t width = static_cast<std::size_t>(camera.width());
    const std::size_t row = p / width, column = p % width;
    const std::array<double, 2> pixel = {static_cast<double>(column) + 0.5,
                                         static_cast<double>(row) + 0.5};
    if (keep_all) seen.push_back(pixel);
    for (std::size_t k = 0; k < 2; ++k) {
      low[k] = std::min(low[k], pixel[k]);
      high[k] = std::max(high[k], pixel[k]);
    }
  }
  if (!keep_all && low[0] < high[0] + 1.0) seen = {low, high};
  return seen;
}

// Whether [low, high], or a copy of it `period` pixels to either side, holds x.
bool Holds(double low, double high, double x, double period) {
  return (low <= x && x <= high) || (period > 0.0 && ((low <= x + period && x + period <= high) ||
                                                      (low <= x - period && x - period <= high)));
}

struct MethodCount {
  std::int64_t seen = 0;    // Gaussians that a pixel sees
  std::int64_t missed = 0;  // of these, the ones of which a pixel lies outside the box
};

template <class T>
void CountMisses(const Footprints<T>& found, const std::vector<Seen>& truth, const Camera& camera,
                 MethodCount* count) {
  const LensDomain& domain = camera.domain();
  for (std::size_t i = 0; i < truth.size(); ++i) {
    if (truth[i].empty()) continue;
    bool holds = found.status[i] == FootprintStatus::kBox;
    for (const auto& [u, v] : truth[i]) {
      holds = holds && Holds(found.low_u[i], found.high_u[i], u, domain.period_u) &&
              Holds(found.low_v[i], found.high_v[i], v, domain.period_v);
    }
    ++count->seen;
    count->missed += !holds;
  }
}

std::int64_t GaussiansALens() {
  const char* text = std::getenv("GSUT_FOOTPRINTS");
  return text == nullptr ? 1400 : std::stoll(text);
}

TEST(FootprintTest, SilhouetteMissesNoPixelOnAnyLens) {
  MethodCount counts[3][std::size(kAllMethods)] =
      {};  // double, float with the best, and lowest ISA
  std::int64_t pairs = 0;
  std::uint64_t stream = 0;
  const std::vector<std::string> isas = AvailableIsas();
  const std::int64_t each = GaussiansALens() / static_cast<std::int64_t>(std::size(kKinds) + 1) + 1;
  for (const NamedCamera& lens : EveryLens(48)) {
    for (std::size_t kind = 0; kind <= std::size(kKinds); ++kind) {
      Draws draws(11, stream++);
      const Pose pose = RandomPose(&draws);
      const auto g = kind < std::size(kKinds)
                         ? GaussiansInView(lens.camera, pose, each, kKinds[kind], &draws)
                         : Anywhere(pose, each, &draws);
      const auto exact = ToDouble(g);
      const FootprintRule rule;
      std::vector<Seen> truth(static_cast<std::size_t>(each)), float_truth(truth.size());
      const bool keep_all = lens.camera.domain().IsPanorama();
      ParallelFor(each, 16, [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) {
          const std::size_t j = static_cast<std::size_t>(i);
          truth[j] = SeenPixels(exact, j, lens.camera, pose, rule.alpha_min, keep_all);
          float_truth[j] = SeenPixels(exact, j, lens.camera, pose,
                                      rule.alpha_min * (1.0 + kMissMargin), keep_all);
        }
      });
      pairs += each;
      for (std::size_t m = 0; m < std::size(kAllMethods); ++m) {
        FootprintOptions options;
        options.method = kAllMethods[m];
        MethodCount here[3] = {};
        Footprints<double> found;
        FindFootprintsReference(exact.View(), lens.camera, pose, options, &found);
        CountMisses(found, truth, lens.camera, &here[0]);
        for (int path = 1; path <= 2; ++path) {
          SetIsa(path == 1 ? isas.front() : isas.back());
          Footprints<float> kernel;
          FindFootprints(g.View(), lens.camera, pose, options, &kernel);
          CountMisses(kernel, float_truth, lens.camera, &here[path]);
        }
        SetIsa("");
        for (int path = 0; path < 3; ++path) {
          counts[path][m].seen += here[path].seen;
          counts[path][m].missed += here[path].missed;
          if (kAllMethods[m] == ProjectionMethod::kSilhouette) {
            EXPECT_EQ(here[path].missed, 0)
                << lens.name << " kind " << kind << " method " << m << " path " << path;
          }
        }
      }
    }
  }
  for (std::size_t m = 0; m < std::size(kAllMethods); ++m) {
    std::printf(
        "method %zu: %lld of %lld seen Gaussians have a pixel outside the box (float %lld)\n", m,
        static_cast<long long>(counts[0][m].missed), static_cast<long long>(counts[0][m].seen),
        static_cast<long long>(counts[1][m].missed));
  }
  EXPECT_GE(pairs, GaussiansALens() * static_cast<std::int64_t>(EveryLens(48).size()));
  EXPECT_GT(counts[0][0].seen, pairs / 3);
}

// Gaussians on random lines of sight, some behind their origins.
OwnedGaussians<float> OnLines(const Camera& camera, const Pose& pose, std::int64_t n,
                              Draws* draws) {
  const RayTable& table = camera.Rays();
  OwnedGaussians<float> g(n);
  for (std::int64_t i = 0; i < n; ++i) {
    const std::size_t row = static_cast<std::size_t>(i);
    std::size_t p = 0;
    do {
      p = static_cast<std::size_t>(draws->Index(static_cast<std::int64_t>(table.valid.size())));
    } while (!table.valid[p]);
    const double distance = draws->LogUniform(0.01, 10.0);
    const Eigen::Vector3d in_camera = Eigen::Map<const Eigen::Vector3d>(&table.origins[3 * p]) +
                                      (draws->Uniform(0, 1) < 0.1 ? -0.1 : 1.0) * distance *
                                          Eigen::Map<const Eigen::Vector3d>(&table.rays[3 * p]);
    const Eigen::Vector3d mean = pose.rotation.transpose() * (in_camera - pose.translation);
    const double size = distance * draws->LogUniform(0.001, 1.0);
    for (std::size_t k = 0; k < 3; ++k) {
      g.means[3 * row + k] = static_cast<float>(mean[static_cast<int>(k)]);
      g.log_scales[3 * row + k] = static_cast<float>(std::log(size) + draws->Normal());
    }
    for (std::size_t k = 0; k < 4; ++k) g.quats[4 * row + k] = static_cast<float>(draws->Normal());
    g.opacity_logits[row] = static_cast<float>(1.5 * draws->Normal());
  }
  return g;
}

TEST(FootprintTest, SilhouetteMissesNoPixelWhereRaysDoNotMeet) {
  constexpr int kColumns = 48;
  std::uint64_t stream = 900;
  int lenses = 0;
  for (const std::string& name : LensNames()) {
    for (const LensExample& example : LensExamples(LensFromName(name))) {
      const Camera whole(name, {example.params, example.params + example.num_params}, example.width,
                         example.height);
      if (whole.IsCentral()) continue;
      const Camera camera = whole.Resized(kColumns, kColumns * example.height / example.width);
      Draws draws(13, stream++);
      const Pose pose = RandomPose(&draws);
      const auto g = OnLines(camera, pose, GaussiansALens(), &draws);
      const auto exact = ToDouble(g);
      std::vector<Seen> truth, float_truth;
      const FootprintRule rule;
      for (std::size_t i = 0; i < static_cast<std::size_t>(g.size()); ++i) {
        truth.push_back(SeenPixels(exact, i, camera, pose, rule.alpha_min, false));
        float_truth.push_back(
            SeenPixels(exact, i, camera, pose, rule.alpha_min * (1.0 + kMissMargin), false));
      }
      FootprintOptions options;
      options.method = ProjectionMethod::kSilhouette;
      Footprints<double> found;
      FindFootprintsReference(exact.View(), camera, pose, options, &found);
      Footprints<float> kernel;
      FindFootprints(g.View(), camera, pose, options, &kernel);
      MethodCount count, float_count;
      CountMisses(found, truth, camera, &count);
      CountMisses(kernel, float_truth, camera, &float_count);
      EXPECT_EQ(count.missed, 0) << name;
      EXPECT_EQ(float_count.missed, 0) << name;
      EXPECT_GT(count.seen, GaussiansALens() / 2) << name;
      ++lenses;
    }
  }
  EXPECT_EQ(lenses, 3);
}

// Extents of the outline of 16 points in float against 64 in double, relative to the size: what may
// lie between two samples is 0.4 % of it for an ellipse; observed 0.026.
constexpr double kOutlineLoose = 0.05;
// Pixels of the centre in float against double, as in projection_test.cpp; observed 6.8e-5.
constexpr double kFloatPixels = 1.3e-4;
// The same of a box's edge, a centre and an extent; observed 1.4e-4.
constexpr double kFloatEdge = 2.8e-4;
// Relative error of a covariance in float; observed 2.4e-5.
constexpr double kFloatCovariance = 5e-5;
// Half width in pixels up to which footprints are compared: wider ones have points where lenses are
// steep, at coordinates of which float has few digits.
constexpr double kWidest = 40.0;

TEST(FootprintTest, FloatMatchesDoubleOnEveryLensMethodAndInstructionSet) {
  int ran = 0;
  std::uint64_t stream = 0;
  double worst_center = 0.0, worst_covariance = 0.0, worst_outline = 0.0;
  for (const NamedCamera& lens : EveryLens(100)) {
    Draws draws(12, stream++);
    const Pose pose = RandomPose(&draws);
    const SceneKind kind = {"ordinary", 1.0, 6.0, 0.005, 0.05, 0.5, 1.0};
    const auto g = GaussiansInView(lens.camera, pose, 131, kind, &draws);
    const auto exact = ToDouble(g);
    for (const ProjectionMethod method : kAllMethods) {
      FootprintOptions options;
      options.method = method;
      Footprints<double> truth;
      FindFootprintsReference(exact.View(), lens.camera, pose, options, &truth);
      for (const std::string& isa : AvailableIsas()) {
        SetIsa(isa);
        Footprints<float> found;
        FindFootprints(g.View(), lens.camera, pose, options, &found);
        int compared = 0;
        for (std::size_t i = 0; i < static_cast<std::size_t>(g.size()); ++i) {
          const double size =
              std::max(truth.high_u[i] - truth.low_u[i], truth.high_v[i] - truth.low_v[i]);
          if (!std::isfinite(truth.u[i]) || !(size < 2.0 * kWidest)) continue;
          // On the edge of the domain float may decide otherwise.
          if (found.status[i] != truth.status[i] || !std::isfinite(found.u[i])) continue;
          ++compared;
          const bool outline = method == ProjectionMethod::kSilhouette;
          const double center = std::hypot(found.u[i] - truth.u[i], found.v[i] - truth.v[i]);
          const double loose = kBoxRounding + kFloatEdge + (outline ? kOutlineLoose * size : 0.0);
          EXPECT_LT(center, kFloatPixels) << lens.name << " " << isa;
          const double variance = std::max(truth.cov_uu[i], truth.cov_vv[i]);
          const double covariance = std::max({std::abs(found.cov_uu[i] - truth.cov_uu[i]),
                                              std::abs(found.cov_uv[i] - truth.cov_uv[i]),
                                              std::abs(found.cov_vv[i] - truth.cov_vv[i])}) /
                                    std::max(variance, 1.0);
          EXPECT_LT(covariance, kFloatCovariance) << lens.name << " " << isa;
          const double low = truth.low_u[i] - found.low_u[i];
          const double high = found.high_v[i] - truth.high_v[i];
          EXPECT_GE(std::min(low, high), -kFloatEdge) << lens.name << " " << isa;
          EXPECT_LT(std::max(low, high), loose) << lens.name << " " << isa;
          worst_center = std::max(worst_center, center);
          worst_covariance = std::max(worst_covariance, covariance);
          if (outline) worst_outline = std::max(worst_outline, std::max(low, high) / size);
        }
        EXPECT_GT(compared, 100) << lens.name << " " << isa << " " << static_cast<int>(method);
        ++ran;
      }
    }
  }
  SetIsa("");
  std::printf("float: centre %.1e px, covariance %.1e, outline %.3f\n", worst_center,
              worst_covariance, worst_outline);
  EXPECT_EQ(ran, static_cast<int>(EveryLens(100).size() * std::size(kAllMethods) *
                                  AvailableIsas().size()));
}

TEST(FootprintTest, SilhouetteOfABallOnTheAxisHasItsClosedForm) {
  // A pinhole sees a ball of angular radius asin(k s / d) as a circle of radius f tan of it.
  const Camera camera("pinhole", {100.0, 100.0, 50.0, 50.0}, 100, 100);
  FootprintOptions options;
  options.method = ProjectionMethod::kSilhouette;
  int ran = 0;
  for (const double scale : {0.001, 0.01, 0.1, 0.3}) {
    OwnedGaussians<double> g(1);
    g.means = {0.0, 0.0, 2.0};
    g.quats = {1.0, 0.0, 0.0, 0.0};
    g.log_scales.assign(3, std::log(scale));
    const double sine = std::sqrt(CutoffOf(0.5, Response::kMaximum, options.rule)) * scale / 2.0;
    const double radius = 100.0 * sine / std::sqrt(1.0 - sine * sine);
    Footprints<double> found;
    FindFootprintsReference(g.View(), camera, Pose(), options, &found);
    ASSERT_EQ(found.status[0], FootprintStatus::kBox);
    // The samples include the extremes; 64 points leave 0.15 % between them.
    for (const double half : {50.0 - found.low_u[0], found.high_u[0] - 50.0, 50.0 - found.low_v[0],
                              found.high_v[0] - 50.0}) {
      EXPECT_GE(half, radius * (1.0 - 1e-12));
      EXPECT_LE(half, radius * 1.0016);
    }
    EXPECT_NEAR(found.u[0], 50.0, 1e-9);
    ++ran;
  }
  EXPECT_EQ(ran, 4);
}

}  // namespace
}  // namespace gsut
