// How well the colours of a photograph determine its pose.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

namespace gsut {

// What one pixel says at the solution: slopes (3 colours, parameters) and what is left, with the
// weight of a robust loss. The pose's six parameters come first.
struct ColorRows {
  Eigen::Matrix<double, 3, Eigen::Dynamic> slopes;
  Eigen::Vector3d residual = Eigen::Vector3d::Zero();
  double weight = 1.0;
};

// Covariance of a pose by leaving out one block of the image after the other (the jackknife, CR3 of
// Bell and McCaffrey, "Bias reduction in standard errors for linear regression with multi-stage
// samples", 2002): pixels of a block may err together, and where few blocks determine the
// pose, residuals are smaller than errors, as each block has bent the pose towards itself. Blocks
// are a sixteenth of the image's longer side, or are halved until 32 of them have pixels.
//
// pixels: row-major indices in an image of width x height; size: number of parameters; rows_of:
// writes the rows of the i-th pixel, whose slopes have the shape (3, size). Throws SolveError where
// the pixels do not determine the parameters.
Eigen::Matrix<double, 6, 6> PhotometricCovariance(
    const std::vector<std::uint32_t>& pixels, int width, int height, int size,
    const std::function<void(std::size_t, ColorRows*)>& rows_of);

}  // namespace gsut
