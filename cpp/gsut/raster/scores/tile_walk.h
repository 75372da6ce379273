// Once more along the rays of a kept render, in scalar double: what a tile's pixels blend, Gaussian
// by Gaussian, for sums that the vector kernels do not make.
#pragma once

#include <Eigen/Core>
#include <array>
#include <bit>
#include <cstdint>

#include "gsut/gaussians/gaussians.h"
#include "gsut/geometry/pose.h"
#include "gsut/raster/blend_rule.h"
#include "gsut/raster/frame.h"
#include "gsut/raster/line_grid.h"
#include "gsut/raster/tile_grid.h"

namespace gsut {

// What a kept frame was made from; all of it must live, unchanged, during the walk.
struct WalkScene {
  GaussiansView<const float> gaussians;
  const Frame* frame = nullptr;
  const TileGrid* tiles = nullptr;
  const LineGrid* lines = nullptr;  // null: rays from one point
  Pose camera_from_world;           // of the rays' reference
  BlendRule rule;
};

// A Gaussian about the reference's centre, world axes.
struct WalkGaussian {
  std::int64_t index = 0;
  Eigen::Matrix3d whiten;    // A = S^-1 R^T
  Eigen::Vector3d whitened;  // A m
  Eigen::Vector3d scale;
  double strength = 0;
  Profile profile;
};

WalkGaussian WalkGaussianOf(const WalkScene& scene, std::int64_t index);

// One blended Gaussian of one pixel.
struct WalkHit {
  double alpha, transmittance, weight;  // transmittance in front of it; weight = their product
  // raw dalpha / draw, raw = strength x response, and that times dln raw / d(-D^2 / 2); 0: clamped
  double by_strength, slope;
  double along;              // of the nearest point, in lengths of the direction
  Eigen::Vector3d residual;  // from the mean to the ray in whitened space, reversed
  Eigen::Vector3d pull;      // derivative of D^2 / 2 by A m: the residual, or a gauge's
};

// The pixels of one tile.
class TileWalk {
 public:
  // chosen: (H, W) row-major, pixels with 0 are left out; null: all with a ray.
  TileWalk(const WalkScene& scene, int tile, const std::uint8_t* chosen);

  // visit(entry, gaussian, offset, hit) for all that is blended: the tile's entries nearest first,
  // entry being the number within the tile, and for each its pixels.
  template <class Visit>
  void Run(Visit&& visit) {
    std::array<double, kTilePixels> transmittance = start_;
    const Frame& frame = *scene_.frame;
    const BlendRule& rule = scene_.rule;
    const int lanes = scene_.tiles->lanes;
    const std::uint32_t begin = frame.tile_begin[static_cast<std::size_t>(tile_)];
    for (std::uint32_t e = 0; e < frame.entry_count[static_cast<std::size_t>(tile_)]; ++e) {
      const TileEntry& entry = frame.entries[begin + e];
      const WalkGaussian g = WalkGaussianOf(scene_, entry.gaussian);
      for (std::uint64_t blocks = entry.blocks; blocks != 0; blocks &= blocks - 1) {
        const int first = std::countr_zero(blocks) * lanes;
        for (int offset = first; offset < first + lanes; ++offset) {
          double& left = transmittance[static_cast<std::size_t>(offset)];
          WalkHit hit;
          if (!(left > 0.0) || !Evaluate(g, offset, &hit)) continue;
          hit.transmittance = left;
          hit.weight = hit.alpha * left;
          const double next = left - hit.weight;
          if (rule.stop_before && next <= rule.transmittance_min) {
            left = 0.0;
            continue;
          }
          visit(e, g, offset, hit);
          left = next < rule.transmittance_min ? 0.0 : next;
        }
      }
    }
  }

  // A point of the pixel's ray, `along` as in WalkHit; world axes about the reference's centre.
  Eigen::Vector3d PointAt(int offset, double along) const {
    const auto at = static_cast<std::size_t>(offset);
    return origins_[at] + along * directions_[at];
  }
  // Of the pixel's ray, world axes, of any length.
  const Eigen::Vector3d& direction(int offset) const {
    return directions_[static_cast<std::size_t>(offset)];
  }
  // Row-major index of the pixel in the image; -1 outside of it.
  std::int64_t pixel(int offset) const { return pixels_[static_cast<std::size_t>(offset)]; }

 private:
  bool Evaluate(const WalkGaussian& g, int offset, WalkHit* hit) const;

  const WalkScene& scene_;
  int tile_;
  std::array<double, kTilePixels> start_;
  std::array<std::int64_t, kTilePixels> pixels_;
  std::array<Eigen::Vector3d, kTilePixels> directions_, origins_;
};

}  // namespace gsut
