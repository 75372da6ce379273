// The splined lens' parameters, and its surface as a map of the plane.
#pragma once

namespace gsut {

struct LensDomain;

// params: see models/splined_stereographic.h. Throws InputError.
void CheckSplineParams(const char* lens, const double* params, int num_params);

// Control points per unit of the stereographic plane.
double SplineDensity(const double* params);

// The domain as models/splined_stereographic.h describes it; sets edge, limits[2] and limits[3].
LensDomain SplineDomain(const double* params, double angle_limit);

// Unit ray of a pixel; false if it has none.
bool UnprojectSpline(const LensDomain& domain, const double* params, double u, double v,
                     double* ray);

}  // namespace gsut
