// Domain and inverse of cahvore: what its file cannot say in a closed form.
#pragma once

namespace gsut {

struct LensDomain;

// params: as cahvore's. limits[0] is the largest angle from the optical axis, at most angle_limit;
// max_angle bounds the angle from the z axis. Throws InputError if the parameters are no lens.
LensDomain PupilChartDomain(const double* params, double angle_limit);

// Origin and unit direction of a pixel's ray; false if it has none.
bool UnprojectPupilChart(const LensDomain& domain, const double* params, double u, double v,
                         double* origin, double* ray);

}  // namespace gsut
