// Clusters of Gaussians: merging, and the two costs of it.
#include "gsut/optimize/cluster.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "gsut/gaussians/activations.h"

namespace gsut {
namespace {

// Opacities that clusters compute with: the logit of the largest is 9.2.
constexpr double kLeastOpacity = 1e-6;
constexpr double kMostOpacity = 1.0 - 1e-4;
// Added to covariances before they are compared, of their largest variance: surfaces have no
// thickness to speak of, and shifts across it are not seen from where they are seen.
constexpr double kThickness = 0.05 * 0.05;
// Keeps a variance that is 0 from dividing by zero; it is nothing beside any other.
constexpr double kNotZero = 1e-300;
// sum over coefficients of the harmonics' squared difference / 4 pi = its mean over directions.
constexpr double kInverseSphere = 0.25 / std::numbers::pi;

// A Gaussian bump in the plane: amplitude, place, covariance.
struct Bump {
  double amplitude;
  double x, y, xx, xy, yy;
};

// The integral of a product of Gaussians N(x; a, A) N(x; b, B) is a Gaussian of their distance with
// covariance A + B; for bumps of height 1 instead of area 1, times 2 pi sqrt(|A| |B| / |A + B|).
// Integral over the plane of the product of two.
double Product(const Bump& a, const Bump& b) {
  const double xx = a.xx + b.xx, xy = a.xy + b.xy, yy = a.yy + b.yy;
  const double determinant = xx * yy - xy * xy;
  const double dx = a.x - b.x, dy = a.y - b.y;
  const double square = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / determinant;
  const double areas = (a.xx * a.yy - a.xy * a.xy) * (b.xx * b.yy - b.xy * b.xy);
  return a.amplitude * b.amplitude * 2.0 * std::numbers::pi * std::sqrt(areas / determinant) *
         std::exp(-0.5 * square);
}

// The product of two is a bump again; with a minus, for what overlaps in a blend of the two.
Bump MinusOverlap(const Bump& a, const Bump& b) {
  const double xx = a.xx + b.xx, xy = a.xy + b.xy, yy = a.yy + b.yy;
  const double determinant = xx * yy - xy * xy;
  const double dx = b.x - a.x, dy = b.y - a.y;
  // (A + B)^-1 (b - a), and C = A (A + B)^-1 B.
  const double ux = (yy * dx - xy * dy) / determinant;
  const double uy = (xx * dy - xy * dx) / determinant;
  const double bxx = (yy * b.xx - xy * b.xy) / determinant;
  const double bxy = (yy * b.xy - xy * b.yy) / determinant;
  const double byx = (xx * b.xy - xy * b.xx) / determinant;
  const double byy = (xx * b.yy - xy * b.xy) / determinant;
  return {-a.amplitude * b.amplitude * std::exp(-0.5 * (dx * ux + dy * uy)),
          a.x + a.xx * ux + a.xy * uy,
          a.y + a.xy * ux + a.yy * uy,
          a.xx * bxx + a.xy * byx,
          a.xx * bxy + a.xy * byy,
          a.xy * bxy + a.yy * byy};
}

// What a picture loses by a merge: along a direction two Gaussians blend to the opacity
//   a + b - a b   (1 - (1 - a)(1 - b), whichever is in front),
// and the merged one shows m. The integral of (a + b - ab - m)^2 over the picture expands into ten
// products of bumps, each closed. Depth within the pair does not matter, their colours count apart.
// Squared difference of the two blended and the merged field, over the two's own squares; seen
// along the three axes of the merged Gaussian.
double FieldDifference(const Cluster& a, const Cluster& b, const Cluster& merged) {
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver;
  solver.computeDirect(merged.moments.covariance);
  const Eigen::Matrix3d& axes = solver.eigenvectors();
  const double floor = kThickness * std::max(solver.eigenvalues()[2], 0.0) + kNotZero;
  const Cluster* all[3] = {&a, &b, &merged};
  Eigen::Matrix3d covariance[3];
  Eigen::Vector3d mean[3];
  for (int i = 0; i < 3; ++i) {
    covariance[i] = axes.transpose() * all[i]->moments.covariance * axes;
    covariance[i].diagonal().array() += floor;
    mean[i] = axes.transpose() * (all[i]->moments.mean - merged.moments.mean);
  }
  double difference = 0.0, own = 0.0;
  for (int along = 0; along < 3; ++along) {
    const int x = (along + 1) % 3, y = (along + 2) % 3;
    Bump bump[4];  // a, b, what they share, and the merged with a minus
    for (int i = 0; i < 3; ++i) {
      bump[i == 2 ? 3 : i] = {i == 2 ? -all[i]->opacity : all[i]->opacity,
                              mean[i][x],
                              mean[i][y],
                              covariance[i](x, x),
                              covariance[i](x, y),
                              covariance[i](y, y)};
    }
    bump[2] = MinusOverlap(bump[0], bump[1]);
    for (int i = 0; i < 4; ++i) {
      const double square = Product(bump[i], bump[i]);
      difference += square;
      if (i < 2) own += square;
      for (int k = 0; k < i; ++k) difference += 2.0 * Product(bump[i], bump[k]);
    }
  }
  return own > 0.0 ? std::max(difference / own, 0.0) : 0.0;
}

}  // namespace

Cluster ClusterOf(const GaussiansView<const float>& gaussians, std::int64_t row, double weight,
                  const double* origin) {
  Cluster out;
  for (int k = 0; k < 3; ++k) {
    out.moments.mean[k] = static_cast<double>(gaussians.means[3 * row + k]) - origin[k];
  }
  out.moments.covariance = CovarianceOf(gaussians, row);
  out.opacity = std::clamp(Sigmoid(static_cast<double>(gaussians.opacity_logits[row])),
                           kLeastOpacity, kMostOpacity);
  out.transparency = 1.0 - out.opacity;
  const float* s = gaussians.log_scales + 3 * row;
  // Mass: opacity times the projected area, which is how much a Gaussian hides on average.
  const double area =
      ShadowArea(ScaleFromLog(static_cast<double>(s[0])), ScaleFromLog(static_cast<double>(s[1])),
                 ScaleFromLog(static_cast<double>(s[2])));
  const double mass = out.opacity * area;
  out.moments.weight = weight < 0.0 ? mass : weight;
  out.density = mass > 0.0 ? out.moments.weight / mass : 0.0;
  const int count = 3 * gaussians.sh_coefficients;
  out.sh.assign(gaussians.sh + count * row, gaussians.sh + count * (row + 1));
  return out;
}

Cluster Merge(const Cluster& a, const Cluster& b, bool with_sh) {
  Cluster out;
  out.merged = true;
  out.moments = MergeMoments(a.moments, b.moments);
  const double weight = out.moments.weight;
  const double share = weight > 0.0 ? b.moments.weight / weight : 0.5;
  out.transparency = a.transparency * b.transparency;
  out.density = (1.0 - share) * a.density + share * b.density;
  // The merged Gaussian hides as much as both: mass over its own area is its opacity. It is no more
  // opaque than both in front of each other.
  const double area = ShadowArea(out.moments.covariance);
  const double kept = out.density * area > 0.0 ? weight / (out.density * area)
                                               : (1.0 - share) * a.opacity + share * b.opacity;
  out.opacity = std::clamp(std::min(kept, 1.0 - out.transparency), kLeastOpacity, kMostOpacity);
  if (with_sh) {
    out.sh.resize(a.sh.size());
    for (std::size_t k = 0; k < a.sh.size(); ++k) {
      out.sh[k] = (1.0 - share) * a.sh[k] + share * b.sh[k];
    }
  }
  return out;
}

double CostOfMerging(const Cluster& a, const Cluster& b, const MergeOptions& options) {
  const double weight_a = a.moments.weight, weight_b = b.moments.weight;
  const double weight = weight_a + weight_b;
  if (!(weight > 0.0)) return 0.0;
  // Colour: the weighted variance of two values, w_a w_b / (w_a + w_b) |difference|^2.
  double square = 0.0;
  for (std::size_t k = 0; k < a.sh.size(); ++k) {
    const double difference = a.sh[k] - b.sh[k];
    square += difference * difference;
  }
  double cost = weight_a * (weight_b / weight) * kInverseSphere * square;
  // Shape: relative to what both show, so times how much they are seen. Colours are not needed
  // here, and leaving them out of the trial merge saves most of its time.
  if (options.field_weight > 0.0) {
    cost += options.field_weight * weight * FieldDifference(a, b, Merge(a, b, false));
  }
  return cost;
}

}  // namespace gsut
