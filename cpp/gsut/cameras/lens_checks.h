// Input checks that lenses share.
#pragma once

namespace gsut {

// Throws InputError unless all parameters are finite, the first two (focal lengths) positive and
// the next two (principal point) within half of kMaxPixel.
void CheckFocalParams(const char* lens, const char* param_names, const double* params,
                      int num_params);

// The largest distorted radius, in focal lengths, whose pixels are surely within kMaxPixel.
double LargestDistortedRadius(const double* params);

// True if what was found for the pixel (u, v) projects to (back_u, back_v) within the tolerance
// that the contract promises. gain: pixels by which that result moves when its coordinates grow by
// their own size. False for NaN.
bool InverseConverged(double u, double v, double back_u, double back_v, double gain);

// The pixel in focal lengths from the principal point. False if it is not finite or beyond
// kMaxPixel.
bool FromPixel(const double* params, double u, double v, double* x, double* y);

}  // namespace gsut
