// A merged Gaussian under construction, and what it would cost to merge two.
#pragma once

#include <vector>

#include "gsut/optimize/compact.h"
#include "gsut/optimize/moments.h"

namespace gsut {

struct Cluster {
  Moments moments;          // weight: how much it is seen
  double opacity = 0.0;     // in (0, 1)
  double transparency = 1;  // product of the members' 1 - opacity
  double density = 1.0;     // weight of a unit of opacity x shadow area, averaged by weight
  std::vector<double> sh;   // averaged by weight, 3 K
  bool merged = false;
};

// weight < 0: opacity times shadow area.
Cluster ClusterOf(const GaussiansView<const float>& gaussians, std::int64_t row, double weight,
                  const double* origin);

// Both as one: moments, colour, opacity.
Cluster Merge(const Cluster& a, const Cluster& b, bool with_sh = true);

// In units of weight x squared colour: the loss of colour, w_a w_b / (w_a + w_b) times the squared
// difference of the colours averaged over directions, plus the weighted cost of shape.
double CostOfMerging(const Cluster& a, const Cluster& b, const MergeOptions& options);

}  // namespace gsut
