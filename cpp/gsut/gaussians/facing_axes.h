// The shortest axes of Gaussians as their normals, in the place of their colours; with derivatives.
#pragma once

#include "gsut/gaussians/gaussians.h"

namespace gsut {

// Of a flat Gaussian the shortest axis is the normal of its surface. Written as harmonics of degree
// 0 (size, 3) whose colour is 0.5 + 0.5 axis, so that any renderer blends it: over a background of
// 0.5 a pixel is 0.5 + 0.5 (sum of weight x axis). The axis faces `center`; of equal scales the
// first counts. T: float or double.
template <class T>
void FacingAxes(const GaussiansView<const T>& gaussians, const double* center, T* sh);

// Adds what a gradient to these harmonics is to the quaternions (size, 4). Which axis is the
// shortest, and which way it faces, is not differentiated.
template <class T>
void FacingAxesBackward(const GaussiansView<const T>& gaussians, const double* center, const T* dsh,
                        T* dquats);

// Adds the gradient of weight x mean over the Gaussians of the shortest scale (PGSR, eq. 8) to the
// log_scales (size, 3).
template <class T>
void FlattenGradient(const GaussiansView<const T>& gaussians, double weight, T* dlog_scales);

}  // namespace gsut
