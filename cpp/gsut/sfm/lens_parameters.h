// Which parameters of lenses a solver may change.
#pragma once

#include <ceres/manifold.h>
#include <ceres/problem.h>

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <vector>

#include "gsut/cameras/camera.h"

namespace gsut {

// A parameter's flag: 0 held, 1 free by itself; those of one larger flag change by the same amount
// (the focal lengths of square pixels), and one of flag 3 by that of flag 2 and an amount of its
// own (of pixels that are nearly square).
inline constexpr std::uint8_t kLensFree = 1;
inline constexpr std::uint8_t kLensTied = 2;
inline constexpr std::uint8_t kLensNear = 3;

// lens_free[c]: one flag a parameter of camera c, or none if it is held; empty: all are held.
// Throws InputError if it does not fit the cameras.
void CheckLensFlags(const std::vector<Camera>& cameras,
                    const std::vector<std::vector<std::uint8_t>>& lens_free);

// How the parameters of a lens change by what a solver changes: one column for each parameter that
// has an amount of its own and each group of tied ones.
Eigen::MatrixXd FreeLensColumns(const std::vector<std::uint8_t>& free);

// Indices of the parameters that have a flag.
std::vector<int> FreeLensParams(const std::vector<std::uint8_t>& free);

// Holds the parameters of a lens that have no flag, and ties those of one flag. manifolds: keeps
// what the problem points to.
void HoldLensParameters(const std::vector<std::uint8_t>& free, double* lens,
                        ceres::Problem* problem,
                        std::vector<std::unique_ptr<ceres::Manifold>>* manifolds);

}  // namespace gsut
