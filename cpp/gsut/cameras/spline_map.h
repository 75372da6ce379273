// The splined lens' parameters, and its surface as a map of the plane.
#pragma once

#include "gsut/cameras/plane_map.h"

namespace gsut {

// params: see models/splined_stereographic.h. Throws InputError.
void CheckSplineParams(const char* lens, const double* params, int num_params);

// Control points per unit of the stereographic plane.
double SplineDensity(const double* params);

// (x, y) -> (x', y'); params must outlive it.
PlaneMap SplineMap(const double* params);

}  // namespace gsut
