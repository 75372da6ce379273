// Derivatives of chosen pixels' colours by the camera's centre and by the pixels' rays.
#include <Eigen/Core>
#include <algorithm>
#include <vector>

#include "gsut/base/check_arguments.h"
#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/gaussians/harmonics.h"
#include "gsut/raster/central/jacobian_kernel.h"
#include "gsut/raster/render.h"

namespace gsut {
namespace {

using Eigen::Map;
using Eigen::Matrix3d;
using Eigen::Vector3d;
using RowMatrix3d = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

constexpr std::int64_t kGaussianGrain = 1024;

// A colour depends on the centre o through n = (m - o) / |m - o|: dn/do = -(I - n n^T) / |m - o|.
// Derivatives of the colours of the Gaussians that the frame sees by the camera's centre (world).
void ShadingSlopes(const RasterTask& task, const Vector3d& center, const Frame& frame,
                   AlignedVector<float>* slopes) {
  const GaussiansView<const float>& g = task.gaussians;
  slopes->resize(static_cast<std::size_t>(g.size) * kShadingSlopes);
  const std::int64_t seen = static_cast<std::int64_t>(frame.order.size());
  ParallelFor(seen, kGaussianGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t j = begin; j < end; ++j) {
      const std::size_t i = frame.order[static_cast<std::size_t>(j)];
      const Vector3d away = Map<const Eigen::Vector3f>(g.means + 3 * i).cast<double>() - center;
      const double distance = away.norm();
      const Vector3d unit = away / distance;
      const Eigen::Vector3f direction = unit.cast<float>();
      const float* sh = g.sh + 3 * static_cast<std::size_t>(g.sh_coefficients) * i;
      float color[3], by_sh[3 * kMaxShCoefficients], by_direction[3];
      const unsigned clamped = EvalHarmonics(task.sh_degree, direction.data(), sh, color);
      for (int c = 0; c < 3; ++c) {
        const float one[3] = {c == 0 ? 1.0f : 0.0f, c == 1 ? 1.0f : 0.0f, c == 2 ? 1.0f : 0.0f};
        EvalHarmonicsBackward(task.sh_degree, direction.data(), sh, clamped, one, by_sh,
                              by_direction);
        const Vector3d slope = Map<const Eigen::Vector3f>(by_direction).cast<double>();
        const Vector3d by_center = -(slope - unit * unit.dot(slope)) / distance;
        Map<Eigen::Vector3f> out(slopes->data() + kShadingSlopes * i +
                                 3 * static_cast<std::size_t>(c));
        out = by_center.cast<float>();
      }
    }
  });
}

}  // namespace

void Renderer::Jacobian(std::span<const std::uint32_t> pixels, double* by_center, double* by_ray) {
  CheckKept(rendered_, "a Jacobian needs a render before it, made with keep_for_backward");
  if (lines_ != nullptr) {
    throw InputError(
        "derivatives of colours are for a lens with one centre and a global shutter, and for "
        "Gaussians by their maximum; refine the poses of other images through render_backward");
  }
  CheckArray(by_center, static_cast<std::int64_t>(pixels.size()), "by_center");
  CheckArray(by_ray, static_cast<std::int64_t>(pixels.size()), "by_ray");
  const std::size_t num_pixels = static_cast<std::size_t>(grid_->width) * grid_->height;
  // Places in `pixels`, tile by tile.
  std::vector<std::uint32_t> first(static_cast<std::size_t>(grid_->num_tiles()) + 1, 0);
  const auto tile_of = [&](std::uint32_t pixel) {
    const int x = static_cast<int>(pixel) % grid_->width,
              y = static_cast<int>(pixel) / grid_->width;
    return static_cast<std::size_t>(y / kTileSize * grid_->tiles_x + x / kTileSize);
  };
  for (const std::uint32_t pixel : pixels) {
    if (pixel >= num_pixels) throw InputError("a chosen pixel lies outside the image");
    ++first[tile_of(pixel) + 1];
  }
  for (std::size_t tile = 1; tile < first.size(); ++tile) first[tile] += first[tile - 1];
  std::vector<std::uint32_t> places(pixels.size()), next(first.begin(), first.end() - 1);
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    places[next[tile_of(pixels[i])]++] = static_cast<std::uint32_t>(i);
  }
  // Tile by tile: only the blocks that hold a chosen pixel are walked, then each pixel's slopes by
  // its line's numbers are turned into those by the camera's centre and by its unit ray.
  const Matrix3d rotation = reference_.rotation;
  const bool shaded = task_.sh_degree > 0;
  if (shaded) ShadingSlopes(task_, reference_.CenterInSource(), frame_, &shading_slopes_);
  ParallelFor(grid_->num_tiles(), 1, [&](std::int64_t tile, std::int64_t) {
    const std::uint32_t begin = first[static_cast<std::size_t>(tile)];
    const std::uint32_t end = first[static_cast<std::size_t>(tile) + 1];
    if (begin == end) return;
    const auto offset_of = [&](std::uint32_t place) {
      const int pixel = static_cast<int>(pixels[places[place]]);
      return grid_->PixelOffset(pixel % grid_->width % kTileSize, pixel / grid_->width % kTileSize);
    };
    std::uint64_t wanted = 0;
    for (std::uint32_t k = begin; k < end; ++k) {
      wanted |= std::uint64_t{1} << (offset_of(k) / grid_->lanes);
    }
    alignas(64) float slopes[TileSlopes::kSize * kTilePixels];
    JacobianKernel(task_, *grid_, static_cast<int>(tile), frame_,
                   shaded ? shading_slopes_.data() : nullptr, wanted, slopes);
    const float* bundle = grid_->bundles[static_cast<std::size_t>(tile)].values;
    Vector3d axes[3];
    for (int k = 0; k < 3; ++k) {
      axes[k] = Map<const Eigen::Vector3f>(bundle + RayBundle::kFrame + 3 * k).cast<double>();
    }
    const auto& [d, e1, e2] = axes;
    for (std::uint32_t k = begin; k < end; ++k) {
      const std::size_t o = static_cast<std::size_t>(offset_of(k));
      const std::size_t i = static_cast<std::size_t>(tile) * kTilePixels + o;
      const double s = static_cast<double>(grid_->s[i]), t = static_cast<double>(grid_->t[i]);
      const double length = static_cast<double>(grid_->length[i]);
      const auto value = [&](int f) { return static_cast<double>(slopes[f * kTilePixels + o]); };
      Map<RowMatrix3d> center(by_center + 9 * places[k]), ray(by_ray + 9 * places[k]);
      for (int c = 0; c < 3; ++c) {
        const double by_a = value(TileSlopes::ByLine(c, 0)), by_b = value(TileSlopes::ByLine(c, 1));
        const double by_s = value(TileSlopes::ByLine(c, 2)), by_t = value(TileSlopes::ByLine(c, 3));
        // A shift along the line is none.
        const Vector3d by_origin = by_a * e1 + by_b * e2 - (s * by_a + t * by_b) * d;
        center.row(c) = rotation.transpose() * by_origin;
        if (shaded) {
          for (int j = 0; j < 3; ++j) center(c, j) += value(TileSlopes::kShading + 3 * c + j);
        }
        // s = d.E1 / d.D and t = d.E2 / d.D for the unit ray d, where 1 / d.D is the length.
        ray.row(c) = length * (by_s * (e1 - s * d) + by_t * (e2 - t * d));
      }
    }
  });
}

}  // namespace gsut
