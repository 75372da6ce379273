// Point cloud to Gaussians.
#include "gsut/gaussians/seed.h"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <string>
#include <vector>

#include "gsut/base/check_arguments.h"
#include "gsut/base/errors.h"
#include "gsut/gaussians/activations.h"
#include "gsut/gaussians/check_gaussians.h"
#include "gsut/gaussians/harmonics.h"
#include "gsut/gaussians/seed_neighbors.h"

namespace gsut {
namespace {

// Farthest coordinate in any unit, whose square is finite: neighbours are compared by squares.
constexpr double kFarthest = 1e12;

void CheckFinite(const double* values, std::int64_t rows, const char* name) {
  for (std::int64_t i = 0; i < 3 * rows; ++i) {
    if (!(std::abs(values[i]) <= kFarthest)) {
      std::ostringstream found;
      found << values[i];
      throw InputError(std::string(name) + " row " + std::to_string(i / 3) + " holds " +
                       found.str() + "; remove rows that are not finite, or farther than 1e12");
    }
  }
}

// The median over points that have a distance: duplicates have none.
double MedianPositive(const std::vector<Neighborhood>& neighborhoods) {
  std::vector<double> distances;
  for (const Neighborhood& each : neighborhoods) {
    if (each.distance > 0.0) distances.push_back(each.distance);
  }
  if (distances.empty()) return 0.0;
  const auto middle = distances.begin() + static_cast<std::ptrdiff_t>(distances.size() / 2);
  std::nth_element(distances.begin(), middle, distances.end());
  return *middle;
}

}  // namespace

void SeedFromPoints(const double* points, const double* colors, const SeedOptions& options,
                    const GaussiansView<float>& out) {
  if (!(options.scale_factor > 0.0) || !std::isfinite(options.scale_factor)) {
    throw InputError("scale_factor is " + std::to_string(options.scale_factor) +
                     "; give a positive number");
  }
  if (!(options.opacity > 0.0 && options.opacity < 1.0)) {
    throw InputError("opacity is " + std::to_string(options.opacity) +
                     "; give a value between 0 and 1, both excluded");
  }
  CheckGaussians(out.AsConst());
  CheckArray(points, out.size, "points");
  CheckArray(colors, out.size, "colors");
  CheckFinite(points, out.size, "points");
  CheckFinite(colors, out.size, "colors");
  // Sizes follow the points' density: thin where they lie in a plane, and at least a share of the
  // median, so that duplicates do not become Gaussians of no size.
  const std::vector<Neighborhood> neighborhoods = FindNeighborhoods(points, out.size);
  const double median = MedianPositive(neighborhoods);
  const double smallest = median > 0.0 ? options.min_relative_distance * median : 1.0;
  const auto logit = static_cast<float>(Logit(options.opacity));
  const std::int64_t sh_width = 3 * std::int64_t{out.sh_coefficients};
  for (std::int64_t row = 0; row < out.size; ++row) {
    const Neighborhood& around = neighborhoods[static_cast<std::size_t>(row)];
    const double along = options.scale_factor * std::max(around.distance, smallest);
    const double across = along * std::max(options.least_thickness, around.thickness);
    // A colour is 0.5 + c0 sh; harmonics above degree 0 begin at 0.
    std::fill_n(out.sh + row * sh_width, sh_width, 0.0f);
    for (int i = 0; i < 3; ++i) {
      out.means[3 * row + i] = static_cast<float>(points[3 * row + i]);
      out.log_scales[3 * row + i] = static_cast<float>(std::log(i < 2 ? along : across));
      out.sh[row * sh_width + i] =
          static_cast<float>((colors[3 * row + i] - kShColorOffset) / kSh0);
    }
    const Eigen::Quaterniond& turn = around.frame;
    const double quat[4] = {turn.w(), turn.x(), turn.y(), turn.z()};
    std::copy_n(quat, 4, out.quats + 4 * row);
    out.opacity_logits[row] = logit;
  }
}

}  // namespace gsut
