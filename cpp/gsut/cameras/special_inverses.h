// Domains and inverses of two lenses with formulas of their own: the splined one and cahvore.
#pragma once

namespace gsut {

struct LensDomain;

// The splined lens: parameters, and its surface as a map of the plane.

// params: see models/splined_stereographic.h. Throws InputError.
void CheckSplineParams(const char* lens, const double* params, int num_params);

// Control points per unit of the stereographic plane.
double SplineDensity(const double* params);

// The domain as models/splined_stereographic.h describes it; sets edge, limits[2] and limits[3].
LensDomain SplineDomain(const double* params, double angle_limit);

// Unit ray of a pixel; false if it has none.
bool UnprojectSpline(const LensDomain& domain, const double* params, double u, double v,
                     double* ray);

// Cahvore: what its file cannot say in a closed form.

// params: as cahvore's. limits[0] is the largest angle from the optical axis, at most angle_limit;
// max_angle bounds the angle from the z axis. Throws InputError if the parameters are no lens.
LensDomain PupilChartDomain(const double* params, double angle_limit);

// Origin and unit direction of a pixel's ray; false if it has none.
bool UnprojectPupilChart(const LensDomain& domain, const double* params, double u, double v,
                         double* origin, double* ray);

}  // namespace gsut
