// Domain of the polynomial fisheye of OCamCalib, and the start of its inverse.
#pragma once

namespace gsut {

struct LensDomain;

// params: see models/ocam.h. limits[0..2] hold the odd polynomial of the angle from which the lens'
// Newton steps start; the domain ends where they no longer find rho to rounding.
LensDomain OcamDomain(const double* params, int num_params, double angle_limit);

}  // namespace gsut
