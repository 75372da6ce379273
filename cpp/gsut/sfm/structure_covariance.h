// Covariances of the poses of a structure that was found without them.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "gsut/geometry/pose.h"
#include "gsut/sfm/bearing.h"

namespace gsut {

// What a structure of global shutters is, without its residuals.
struct FoundStructure {
  std::vector<Pose> camera_from_world;  // one an image
  std::vector<Eigen::Vector3d> points;
  std::vector<std::array<std::int32_t, 3>> observations;  // point, image, feature
  int initial_first = -1, initial_second = -1;
  double loss_pixels = 0.0;  // as in Structure
};

// Returns those that EstimatePoses would have returned with the structure, to the same bits: see
// Structure::covariances; NaN where something is not determined.
// Args: bearings: of the features of each image; observations in the order of points.
// Throws InputError for an index out of range.
std::vector<Eigen::Matrix<double, 6, 6>> StructureCovariances(
    std::span<const std::vector<Bearing>* const> bearings, const FoundStructure& structure);

}  // namespace gsut
