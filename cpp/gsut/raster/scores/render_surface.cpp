// The surface behind each pixel of the last frame, and the gradients of its normals.
#include <Eigen/Core>
#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "gsut/base/check_arguments.h"
#include "gsut/base/errors.h"
#include "gsut/gaussians/activations.h"
#include "gsut/gaussians/check_gaussians.h"
#include "gsut/raster/render.h"
#include "gsut/raster/scores/add_over_tiles.h"
#include "gsut/raster/scores/tile_walk.h"

namespace gsut {
namespace {

using Eigen::Map;
using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr float kNone = std::numeric_limits<float>::quiet_NaN();
constexpr double kHalf = 0.5;  // of the light: where the median lies

// What a pixel's blended distances add up to.
struct DistanceSums {
  double weight = 0, first = 0, second = 0, most = 0;
  float median = kNone, strongest = kNone;

  void Add(const WalkHit& hit, double distance) {
    // About the first distance, so that little is lost in the difference of squares.
    if (weight == 0.0) origin = distance;
    const double from_origin = distance - origin;
    weight += hit.weight;
    first += hit.weight * from_origin;
    second += hit.weight * from_origin * from_origin;
    if (hit.transmittance >= kHalf && hit.transmittance - hit.weight < kHalf) {
      median = static_cast<float>(distance);
    }
    if (hit.weight > most) {
      most = hit.weight;
      strongest = static_cast<float>(distance);
    }
  }
  float Spread() const {
    if (weight == 0.0) return kNone;
    const double mean = first / weight;
    return static_cast<float>(std::sqrt(std::max(second / weight - mean * mean, 0.0)));
  }

 private:
  double origin = 0;
};

// A Gaussian's normal at a hit, -A^T A (2 x - m), before it is made a unit vector.
struct NormalAtHit {
  Vector3d w;            // A d, d the ray's direction
  Vector3d in_whitened;  // A (m - 2 x)
  Vector3d normal;
  double length;

  NormalAtHit(const TileWalk& walk, const WalkGaussian& g, int offset, const WalkHit& hit)
      : w(g.whiten * walk.direction(offset)), in_whitened(hit.residual - hit.along * w) {
    const Vector3d v = g.whiten.transpose() * in_whitened;
    length = v.norm();
    normal = v / length;
  }
};

// Sums of a Gaussian's gradient, in doubles: to A (9, column by column), from here on to A m ...
constexpr int kToWhitened = 9;
// ... and to the opacity.
constexpr int kToOpacity = 12;
constexpr int kSums = 13;

}  // namespace

void Renderer::Rays(float* directions, float* origins) const {
  const WalkScene scene = LastScene();
  CheckGiven(directions, "directions");
  CheckGiven(origins, "origins");
  const std::size_t size = std::size_t{3} * scene.tiles->width * scene.tiles->height;
  std::fill_n(directions, size, 0.0f);
  std::fill_n(origins, size, 0.0f);
  ParallelFor(scene.tiles->num_tiles(), 1, [&](std::int64_t number, std::int64_t) {
    const TileWalk walk(scene, static_cast<int>(number), nullptr);
    for (int offset = 0; offset < kTilePixels; ++offset) {
      const std::int64_t pixel = walk.pixel(offset);
      const std::size_t i = static_cast<std::size_t>(number) * kTilePixels + offset;
      if (pixel < 0 || scene.tiles->start[i] == 0.0f) continue;
      Map<Eigen::Vector3f>(directions + 3 * pixel) =
          walk.direction(offset).normalized().cast<float>();
      Map<Eigen::Vector3f>(origins + 3 * pixel) = walk.PointAt(offset, 0.0).cast<float>();
    }
  });
}

// The median is where the light falls below half, the strongest where the weight is largest; both
// are distances of single Gaussians. The spread is the weighted deviation of all of them.
void Renderer::Surface(const SurfaceMaps& maps) const {
  const WalkScene scene = LastScene();
  const std::int64_t pixels = std::int64_t{scene.tiles->width} * scene.tiles->height;
  if (maps.normals != nullptr) std::fill_n(maps.normals, 3 * pixels, 0.0f);
  ParallelFor(scene.tiles->num_tiles(), 1, [&](std::int64_t number, std::int64_t) {
    TileWalk walk(scene, static_cast<int>(number), nullptr);
    std::array<DistanceSums, kTilePixels> sums{};
    std::vector<Vector3d> normals(kTilePixels, Vector3d::Zero());
    walk.Run([&](std::uint32_t, const WalkGaussian& g, int offset, const WalkHit& hit) {
      const auto at = static_cast<std::size_t>(offset);
      sums[at].Add(hit, hit.along * walk.direction(offset).norm());
      if (maps.normals == nullptr) return;
      normals[at] += hit.weight * NormalAtHit(walk, g, offset, hit).normal;
    });
    for (int offset = 0; offset < kTilePixels; ++offset) {
      const auto at = static_cast<std::size_t>(offset);
      const std::int64_t pixel = walk.pixel(offset);
      if (pixel < 0) continue;
      if (maps.median != nullptr) maps.median[pixel] = sums[at].median;
      if (maps.strongest != nullptr) maps.strongest[pixel] = sums[at].strongest;
      if (maps.spread != nullptr) maps.spread[pixel] = sums[at].Spread();
      if (maps.normals != nullptr) {
        Map<Eigen::Vector3f>(maps.normals + 3 * pixel) = normals[at].cast<float>();
      }
    }
  });
}

// N = sum of w_i n_i over a pixel's Gaussians, w_i = alpha_i T_i. With g = dL/dN:
//   dL/dalpha_i = T_i g.n_i - (sum over j > i of w_j g.n_j) / (1 - alpha_i),  dL/dn_i = w_i g.
// Both lead on to A and to A m, which are summed over pixels, and from these to the parameters.
// First walk: the whole sums; second walk: the gradients, front to back.
void Renderer::SurfaceBackward(const float* dnormals, const GaussiansView<float>& gradients) const {
  if (IsFlat(task_.gaussians.primitive)) {
    throw InputError(std::string("normals of primitive \"") + NameOf(task_.gaussians.primitive) +
                     "\" have no gradient; with one: gaussian");
  }
  const WalkScene scene = LastScene();
  CheckGiven(dnormals, "dnormals");
  CheckGradients(gradients, task_.gaussians);
  const auto tile = [&](int number, double* sums) {
    TileWalk walk(scene, number, nullptr);
    const auto to_normal = [&](int offset) {
      return Vector3d(Map<const Eigen::Vector3f>(dnormals + 3 * walk.pixel(offset)).cast<double>());
    };
    // First the whole sums: what lies behind a Gaussian is the rest of them.
    std::array<double, kTilePixels> rest{};
    walk.Run([&](std::uint32_t, const WalkGaussian& g, int offset, const WalkHit& hit) {
      rest[static_cast<std::size_t>(offset)] +=
          hit.weight * to_normal(offset).dot(NormalAtHit(walk, g, offset, hit).normal);
    });
    walk.Run([&](std::uint32_t e, const WalkGaussian& g, int offset, const WalkHit& hit) {
      const NormalAtHit at(walk, g, offset, hit);
      const Vector3d to = to_normal(offset);
      const double value = to.dot(at.normal);
      double& behind = rest[static_cast<std::size_t>(offset)];
      behind -= hit.weight * value;
      const double to_alpha = hit.transmittance * value - behind / (1.0 - hit.alpha);
      // Through the unit vector to A^T y, y = A m - 2 t w, with t = (A m . w) / w^2 and w = A d.
      const Vector3d to_sum = hit.weight / at.length * (to - value * at.normal);
      const Vector3d to_y = g.whiten * to_sum;
      const double w2 = at.w.squaredNorm();
      const double to_along = -2.0 * at.w.dot(to_y);
      const double to_distance = -to_alpha * hit.slope;  // twice the gradient to D^2
      const Vector3d to_whitened = to_y + to_along / w2 * at.w + to_distance * hit.residual;
      const Vector3d to_w = -2.0 * hit.along * to_y + to_along / w2 * at.in_whitened -
                            to_distance * hit.along * hit.residual;
      double* sum = sums + std::size_t{kSums} * e;
      Map<Matrix3d>(sum) += to_w * walk.direction(offset).transpose() +
                            at.in_whitened * to_sum.transpose() -
                            to_whitened * walk.PointAt(offset, 0.0).transpose();
      Map<Vector3d>(sum + kToWhitened) += to_whitened;
      sum[kToOpacity] += to_alpha * hit.by_strength / g.strength;
    });
  };
  std::vector<double> sums(static_cast<std::size_t>(gradients.size) * kSums, 0.0);
  AddOverTiles(frame_, scene.tiles->num_tiles(), kSums, tile, sums.data());
  const Vector3d center = scene.camera_from_world.CenterInSource();
  ParallelFor(gradients.size, kRecordsPart, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      const double* sum = sums.data() + static_cast<std::size_t>(i) * kSums;
      const Map<const Vector3d> to_whitened(sum + kToWhitened);
      Matrix3d to_whiten = Map<const Matrix3d>(sum);
      if (to_whiten.isZero(0.0) && to_whitened.isZero(0.0) && sum[kToOpacity] == 0.0) continue;
      const WalkGaussian g = WalkGaussianOf(scene, i);
      const Vector3d relative =
          Map<const Eigen::Vector3f>(scene.gaussians.means + 3 * i).cast<double>() - center;
      to_whiten += to_whitened * relative.transpose();
      Map<Eigen::Vector3f>(gradients.means + 3 * i) +=
          (g.whiten.transpose() * to_whitened).cast<float>();
      gradients.opacity_logits[i] +=
          static_cast<float>(sum[kToOpacity] * scene.gaussians.StrengthSlope(g.strength));
      // A = S^-1 R^T: row k of A is column k of R divided by the scale k.
      Eigen::Matrix<double, 3, 3, Eigen::RowMajor> to_rotation;
      for (int k = 0; k < 3; ++k) {
        gradients.log_scales[3 * i + k] -= static_cast<float>(
            to_whiten.row(k).dot(g.whiten.row(k)) * scene.gaussians.LogScaleSlope(g.scale[k]));
        to_rotation.col(k) = to_whiten.row(k).transpose() / g.scale[k];
      }
      double quat[4], to_quat[4];
      for (int k = 0; k < 4; ++k) {
        quat[k] = static_cast<double>(scene.gaussians.quats[4 * i + k]);
      }
      RotationFromQuaternionBackward(quat, to_rotation.data(), to_quat);
      for (int k = 0; k < 4; ++k) gradients.quats[4 * i + k] += static_cast<float>(to_quat[k]);
    }
  });
}

}  // namespace gsut
