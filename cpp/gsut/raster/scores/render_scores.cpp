// How much each Gaussian counts in the last frame: significance, winners of pixels, Fisher
// matrices, and what a photograph says of it.
#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <vector>

#include "gsut/base/check_arguments.h"
#include "gsut/base/errors.h"
#include "gsut/gaussians/harmonics.h"
#include "gsut/raster/render.h"
#include "gsut/raster/scores/add_over_tiles.h"
#include "gsut/raster/scores/tile_walk.h"

namespace gsut {
namespace {

using Eigen::Map;
using Eigen::Vector3d;

// The colour of a Gaussian as drawn and its derivative to the mean, world axes, a column a channel.
struct ShadedColor {
  Vector3d color = Vector3d::Zero();
  Eigen::Matrix3d dcolor_dmean = Eigen::Matrix3d::Zero();
};

ShadedColor ColorOf(const WalkScene& scene, const RasterTask& task, std::int64_t index,
                    bool is_parallel) {
  const GaussiansView<const float>& g = scene.gaussians;
  const Vector3d relative = Map<const Eigen::Vector3f>(g.means + 3 * index).cast<double>() -
                            scene.camera_from_world.CenterInSource();
  const Vector3d direction = is_parallel ? Vector3d(scene.camera_from_world.rotation.row(2))
                                         : Vector3d(relative.normalized());
  double sh[3 * kMaxShCoefficients], dsh[3 * kMaxShCoefficients];
  const int sh_degree = task.sh_degree;
  const float* row = g.sh + 3 * g.sh_coefficients * index;
  for (int k = 0; k < 3 * NumShCoefficients(sh_degree); ++k) sh[k] = static_cast<double>(row[k]);
  ShadedColor out;
  const unsigned clamped = EvalHarmonics(sh_degree, direction.data(), sh, out.color.data());
  if (is_parallel || sh_degree == 0) return out;
  for (int c = 0; c < 3; ++c) {
    double one[3] = {0.0, 0.0, 0.0}, dl_ddirection[3];
    one[c] = 1.0;
    EvalHarmonicsBackward(sh_degree, direction.data(), sh, clamped, one, dsh, dl_ddirection);
    const Map<const Vector3d> to(dl_ddirection);
    out.dcolor_dmean.col(c) = (to - direction * direction.dot(to)) / relative.norm();
  }
  return out;
}

// Of a tile: the colours of its entries, and the whole colour of each pixel, from which a walk
// takes off what it passes: what lies behind is the rest.
struct TileColors {
  std::vector<ShadedColor> entries;
  std::array<Vector3d, kTilePixels> whole;
};

TileColors ColorsOf(const WalkScene& scene, const RasterTask& task, const Vector3d& background,
                    int tile, bool is_parallel, TileWalk* walk) {
  TileColors out;
  out.whole.fill(background);
  out.entries.resize(scene.frame->entry_count[static_cast<std::size_t>(tile)]);
  for (std::size_t e = 0; e < out.entries.size(); ++e) {
    const std::size_t entry = scene.frame->tile_begin[static_cast<std::size_t>(tile)] + e;
    out.entries[e] = ColorOf(scene, task, scene.frame->entries[entry].gaussian, is_parallel);
  }
  walk->Run([&](std::uint32_t e, const WalkGaussian&, int offset, const WalkHit& hit) {
    out.whole[static_cast<std::size_t>(offset)] += hit.weight * (out.entries[e].color - background);
  });
  return out;
}

}  // namespace

WalkScene Renderer::LastScene() const {
  CheckKept(rendered_, "scores need a render before them, made with keep_for_backward");
  const TileGrid* tiles = lines_ != nullptr ? &lines_->tiles : grid_.get();
  return {task_.gaussians, &frame_, tiles, lines_.get(), reference_, rule_};
}

// Tiles run in parallel, but their sums are added to the Gaussians in the order of the tiles, see
// AddOverTiles; a pixel belongs to one tile, so that winners need no such care.
void Renderer::AddSignificance(const std::uint8_t* chosen, double* significance,
                               std::int32_t* winner, float* point) const {
  const WalkScene scene = LastScene();
  CheckArray(significance, scene.gaussians.size, "significance");
  CheckGiven(winner, "winner");
  CheckGiven(point, "point");
  const std::int64_t pixels = std::int64_t{scene.tiles->width} * scene.tiles->height;
  std::fill_n(winner, pixels, -1);
  std::fill_n(point, 3 * pixels, 0.0f);
  const Vector3d center = scene.camera_from_world.CenterInSource();
  const auto tile = [&](int number, double* sums) {
    TileWalk walk(scene, number, chosen);
    std::array<double, kTilePixels> most{};
    walk.Run([&](std::uint32_t e, const WalkGaussian& g, int offset, const WalkHit& hit) {
      sums[e] += scene.gaussians.Opacity(g.index) * hit.transmittance;
      double& best = most[static_cast<std::size_t>(offset)];
      if (!(hit.weight > best)) return;
      best = hit.weight;
      winner[walk.pixel(offset)] = static_cast<std::int32_t>(g.index);
      Map<Eigen::Vector3f>(point + 3 * walk.pixel(offset)) =
          (center + walk.PointAt(offset, hit.along)).cast<float>();
    });
  };
  AddOverTiles(frame_, scene.tiles->num_tiles(), 1, tile, significance);
}

// One Gaussian at a time, as if the others were known. With T the light left in front of it and
// `behind` the colour from behind it, C = ... + T alpha c + behind, and as `behind` is proportional
// to 1 - alpha, dC/dalpha = T c - behind / (1 - alpha). The walk takes what it passes off the whole
// colour, so that what lies behind needs no second list.
void Renderer::AddFisher(const std::uint8_t* chosen, double* fisher) const {
  const WalkScene scene = LastScene();
  CheckArray(fisher, scene.gaussians.size, "fisher");
  const bool is_parallel = lines_ != nullptr && lines_->is_parallel;
  const Map<const Vector3d> background(background_);
  const auto tile = [&](int number, double* sums) {
    TileWalk walk(scene, number, chosen);
    TileColors shaded = ColorsOf(scene, task_, background, number, is_parallel, &walk);
    const auto& colors = shaded.entries;
    auto& rest = shaded.whole;
    walk.Run([&](std::uint32_t e, const WalkGaussian& g, int offset, const WalkHit& hit) {
      Vector3d& behind = rest[static_cast<std::size_t>(offset)];
      const Vector3d& color = colors[e].color;
      behind -= hit.weight * color;
      const Vector3d dcolor_dalpha = hit.transmittance * color - behind / (1.0 - hit.alpha);
      // raw = strength exp(-D^2 / 2); with p the pull, D^2 changes with the mean by 2 A^T p, with
      // scale k by -2 p_k r_k / s_k (the nearest point is stationary).
      const double factor = -hit.slope;
      const Vector3d by_mean = factor * (g.whiten.transpose() * hit.pull);
      const Vector3d by_scale =
          -factor * hit.pull.cwiseProduct(hit.residual).cwiseQuotient(g.scale);
      for (int c = 0; c < 3; ++c) {
        Eigen::Matrix<double, 6, 1> j;
        j.head<3>() = dcolor_dalpha[c] * by_mean + hit.weight * colors[e].dcolor_dmean.col(c);
        j.tail<3>() = dcolor_dalpha[c] * by_scale;
        double* sum = sums + std::size_t{kFisherSums} * e;
        for (int row = 0; row < 6; ++row) {
          for (int column = row; column < 6; ++column) *sum++ += j[row] * j[column];
        }
      }
    });
  };
  AddOverTiles(frame_, scene.tiles->num_tiles(), kFisherSums, tile, fisher);
}

// Without the Gaussian, what is behind shines through it by 1 / (1 - alpha), and its own colour is
// missing: the pixel changes by d = behind alpha / (1 - alpha) - w c. Its squared error r^2 becomes
// (r + d)^2, which is more by d (2 r + d).
void Renderer::AddSupport(const float* photograph, const std::uint8_t* chosen,
                          double* support) const {
  const WalkScene scene = LastScene();
  CheckGiven(photograph, "photograph");
  CheckArray(support, scene.gaussians.size, "support");
  const bool is_parallel = lines_ != nullptr && lines_->is_parallel;
  const Map<const Vector3d> background(background_);
  const auto tile = [&](int number, double* sums) {
    TileWalk walk(scene, number, chosen);
    TileColors shaded = ColorsOf(scene, task_, background, number, is_parallel, &walk);
    const auto& colors = shaded.entries;
    auto& rest = shaded.whole;
    const std::array<Vector3d, kTilePixels> whole = rest;
    walk.Run([&](std::uint32_t e, const WalkGaussian&, int offset, const WalkHit& hit) {
      Vector3d& behind = rest[static_cast<std::size_t>(offset)];
      const Vector3d own = hit.weight * colors[e].color;
      behind -= own;
      const Vector3d change = behind * (hit.alpha / (1.0 - hit.alpha)) - own;  // without it
      const Vector3d residual =
          whole[static_cast<std::size_t>(offset)] -
          Map<const Eigen::Vector3f>(photograph + 3 * walk.pixel(offset)).cast<double>();
      double* sum = sums + std::size_t{kSupportSums} * e;
      sum[0] += change.dot(2.0 * residual + change);
      sum[1] += hit.weight;
    });
  };
  AddOverTiles(frame_, scene.tiles->num_tiles(), kSupportSums, tile, support);
}

}  // namespace gsut
