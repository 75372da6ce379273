// Rays of a tile and the response of one Gaussian on one of them.
#include "gsut/raster/scores/tile_walk.h"

#include <algorithm>
#include <cmath>

#include "gsut/gaussians/activations.h"
#include "gsut/gaussians/surfels.h"

namespace gsut {

using Eigen::Map;
using Eigen::Matrix3d;
using Eigen::Vector3d;

// A Gaussian about the camera's centre, in double: A = S^-1 R^T, and A m for its mean m.
WalkGaussian WalkGaussianOf(const WalkScene& scene, std::int64_t index) {
  const GaussiansView<const float>& g = scene.gaussians;
  WalkGaussian out;
  out.index = index;
  double quat[4], rotation[9];
  for (int k = 0; k < 4; ++k) quat[k] = static_cast<double>(g.quats[4 * index + k]);
  RotationFromQuaternion(quat, rotation);
  for (int k = 0; k < 3; ++k) out.scale[k] = g.Scale(index, k);
  if (IsFlat(g.primitive)) out.scale[2] = kSurfelThickness * out.scale.head<2>().minCoeff();
  out.whiten = out.scale.cwiseInverse().asDiagonal() *
               Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(rotation).transpose();
  out.whitened = out.whiten * (Map<const Eigen::Vector3f>(g.means + 3 * index).cast<double>() -
                               scene.camera_from_world.CenterInSource());
  out.strength = g.Strength(index);
  out.profile = Profile{g.primitive};
  return out;
}

TileWalk::TileWalk(const WalkScene& scene, int tile, const std::uint8_t* chosen)
    : scene_(scene), tile_(tile) {
  const TileGrid& tiles = *scene.tiles;
  const auto at = static_cast<std::size_t>(tile);
  const float* frame = scene.lines == nullptr ? tiles.bundles[at].values + RayBundle::kFrame
                                              : scene.lines->bundles[at].values + LineBundle::kD;
  Vector3d axes[3];
  for (int k = 0; k < 3; ++k) {
    axes[k] = scene.camera_from_world.rotation.transpose() *
              Map<const Eigen::Vector3f>(frame + 3 * k).cast<double>();
  }
  const auto& [d, e1, e2] = axes;
  start_.fill(0.0);
  pixels_.fill(-1);
  directions_.fill(d);
  origins_.fill(Vector3d::Zero());
  const int x0 = (tile % tiles.tiles_x) * kTileSize, y0 = (tile / tiles.tiles_x) * kTileSize;
  // A ray is D + s E1 + t E2, and a line's origin a E1 + b E2 plus what it was slid along the ray.
  for (int y = y0; y < std::min(y0 + kTileSize, tiles.height); ++y) {
    for (int x = x0; x < std::min(x0 + kTileSize, tiles.width); ++x) {
      const auto offset = static_cast<std::size_t>(tiles.PixelOffset(x - x0, y - y0));
      const std::size_t i = at * kTilePixels + offset;
      const std::int64_t pixel = static_cast<std::int64_t>(y) * tiles.width + x;
      pixels_[offset] = pixel;
      if (chosen != nullptr && !chosen[pixel]) continue;
      start_[offset] = static_cast<double>(tiles.start[i]);
      const Vector3d direction =
          d + static_cast<double>(tiles.s[i]) * e1 + static_cast<double>(tiles.t[i]) * e2;
      directions_[offset] = direction;
      if (scene.lines == nullptr) continue;
      origins_[offset] = static_cast<double>(scene.lines->a[i]) * e1 +
                         static_cast<double>(scene.lines->b[i]) * e2 +
                         static_cast<double>(scene.lines->slide[i]) * direction;
    }
  }
}

// Response at the point of the ray that is nearest in whitened coordinates, as in the reference.
// The rays are the tile's own floats: scores judge what was drawn.
bool TileWalk::Evaluate(const WalkGaussian& g, int offset, WalkHit* hit) const {
  const auto at = static_cast<std::size_t>(offset);
  const BlendRule& rule = scene_.rule;
  const Vector3d w = g.whiten * directions_[at];
  Vector3d whitened = g.whitened;
  if (scene_.lines != nullptr) whitened -= g.whiten * origins_[at];
  const bool is_flat = IsFlat(g.profile.primitive);
  hit->along = is_flat ? whitened.z() / w.z() : whitened.dot(w) / w.squaredNorm();
  if (!(hit->along > 0.0)) return false;
  hit->residual = whitened - hit->along * w;
  hit->pull = hit->residual;
  double d2 = hit->residual.squaredNorm();
  if (is_flat) {  // as Passing in reference/blend_ray.h
    double slopes[2];
    const double gauge = g.profile.Gauge(-hit->residual.x(), -hit->residual.y(), slopes);
    d2 = gauge * gauge;
    hit->pull << -slopes[0], -slopes[1], (slopes[0] * w.x() + slopes[1] * w.y()) / w.z();
    hit->pull *= gauge;
  }
  // The slope of what follows from D^2 is a Gaussian's times that of its primitive, as in the
  // kernels: ln f is a function of -D^2 / 2 alone.
  const bool is_gaussian = g.profile.IsGaussian();
  const double response = is_gaussian ? std::exp(-0.5 * d2) : g.profile.Response(d2);
  if (!(response > rule.response_min)) return false;
  const double raw = g.strength * response;
  const Response kind = scene_.gaussians.response;
  const double alpha = AlphaOf(kind, raw);
  hit->alpha = std::min(alpha, rule.alpha_max);
  hit->by_strength = alpha > rule.alpha_max ? 0.0 : raw * AlphaSlope(kind, alpha);
  hit->slope = is_gaussian ? hit->by_strength : hit->by_strength * g.profile.Slope(d2);
  return hit->alpha >= rule.alpha_min;
}

}  // namespace gsut
