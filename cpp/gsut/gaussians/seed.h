// The first Gaussians of a scene, from a point cloud.
#pragma once

#include <cstdint>

#include "gsut/gaussians/gaussians.h"

namespace gsut {

// Defaults: the recipe measured for a CPU's budget; 3DGS uses 1 and 0.1, MCMC 0.1 and 0.5.
struct SeedOptions {
  // Standard deviation along the surface / mean distance to the three nearest neighbours.
  double scale_factor = 0.7;
  double opacity = 0.5;
  // Distances are not taken below this part of the median positive one, so that a point with
  // duplicates is not invisible. Where no distance is positive, 1 world unit is the distance.
  double min_relative_distance = 0.01;
  double least_thickness = 0.2;  // standard deviation across the surface / along it, at least
};

// Fills `out` (out.size rows, all five arrays) with Gaussians at `points` (out.size, 3) that lie in
// the planes of their neighbours: the third axis is the normal, and as much shorter than the other
// two as these points' distances from the plane are. Colours (out.size, 3) in [0, 1] become the
// constant harmonic, higher harmonics 0. Throws InputError if a point or colour is not finite
// (naming its row) or an option is out of range.
void SeedFromPoints(const double* points, const double* colors, const SeedOptions& options,
                    const GaussiansView<float>& out);

}  // namespace gsut
