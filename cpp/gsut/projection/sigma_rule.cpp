// The points and weights of each rule; all are exact for polynomials of degree 2 at least.
#include "gsut/projection/sigma_rule.h"

#include <cmath>

namespace gsut {
namespace {

// Degree 5: the whitened node sqrt(3) of the three-point Gauss-Hermite rule, weights 2/3 and 1/6.
constexpr double kHermiteMiddle = 2.0 / 3.0;
constexpr double kHermiteSide = 1.0 / 6.0;

void Add(double x, double y, double z, double mean_weight, double cov_weight, SigmaRule* rule) {
  const int i = rule->size++;
  rule->points[i][0] = x;
  rule->points[i][1] = y;
  rule->points[i][2] = z;
  rule->mean_weights[i] = mean_weight;
  rule->cov_weights[i] = cov_weight;
}

void AddAxes(double reach, double weight, SigmaRule* rule) {
  for (int axis = 0; axis < 3; ++axis) {
    for (const double side : {reach, -reach}) {
      Add(axis == 0 ? side : 0.0, axis == 1 ? side : 0.0, axis == 2 ? side : 0.0, weight, weight,
          rule);
    }
  }
}

}  // namespace

SigmaRule MakeSigmaRule(ProjectionMethod method, const UnscentedOptions& options) {
  SigmaRule rule;
  const double root3 = std::sqrt(3.0);
  switch (method) {
    case ProjectionMethod::kUnscented: {
      const UnscentedWeights weights = MakeUnscentedWeights(options);
      Add(0.0, 0.0, 0.0, weights.mean_0, weights.cov_0, &rule);
      AddAxes(weights.spread, weights.mean_i, &rule);
      break;
    }
    case ProjectionMethod::kSimplex:
      // Corners at distance sqrt(3): mean 0 and covariance I with weights 1/4.
      Add(1.0, 1.0, 1.0, 0.25, 0.25, &rule);
      Add(1.0, -1.0, -1.0, 0.25, 0.25, &rule);
      Add(-1.0, 1.0, -1.0, 0.25, 0.25, &rule);
      Add(-1.0, -1.0, 1.0, 0.25, 0.25, &rule);
      break;
    case ProjectionMethod::kCubature:
      AddAxes(root3, 1.0 / 6.0, &rule);
      break;
    case ProjectionMethod::kGaussHermite:
      for (int x = -1; x <= 1; ++x) {
        for (int y = -1; y <= 1; ++y) {
          for (int z = -1; z <= 1; ++z) {
            double weight = 1.0;
            for (const int k : {x, y, z}) weight *= k == 0 ? kHermiteMiddle : kHermiteSide;
            Add(root3 * x, root3 * y, root3 * z, weight, weight, &rule);
          }
        }
      }
      break;
    case ProjectionMethod::kEwa:
    case ProjectionMethod::kSilhouette:
      break;
  }
  return rule;
}

}  // namespace gsut
