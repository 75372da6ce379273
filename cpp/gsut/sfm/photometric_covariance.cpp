// The covariance of a pose from colours: normal equations by blocks of the image.
#include "gsut/sfm/photometric_covariance.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <map>
#include <utility>

#include "gsut/base/errors.h"

namespace gsut {
namespace {

constexpr int kBlocks = 16;  // along the image's longer side
constexpr std::size_t kFewestBlocks = 32;
// Share of a block that is left out: not all, so that a direction that only this block determines
// is not divided by zero.
constexpr double kLeftOut = 0.99;
constexpr double kSingular = 1e-12;

// Which pixels (places in `pixels`) lie in each block.
std::vector<std::vector<std::size_t>> BlocksOf(const std::vector<std::uint32_t>& pixels, int width,
                                               int height) {
  for (int side = (std::max(width, height) + kBlocks - 1) / kBlocks;; side = (side + 1) / 2) {
    std::map<std::pair<int, int>, std::vector<std::size_t>> found;
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      const int pixel = static_cast<int>(pixels[i]);
      found[{pixel / width / side, pixel % width / side}].push_back(i);
    }
    if (found.size() < kFewestBlocks && side > 1) continue;
    std::vector<std::vector<std::size_t>> blocks;
    blocks.reserve(found.size());
    for (auto& [place, members] : found) blocks.push_back(std::move(members));
    return blocks;
  }
}

}  // namespace

Eigen::Matrix<double, 6, 6> PhotometricCovariance(
    const std::vector<std::uint32_t>& pixels, int width, int height, int size,
    const std::function<void(std::size_t, ColorRows*)>& rows_of) {
  const auto blocks = BlocksOf(pixels, width, height);
  std::vector<Eigen::MatrixXd> normals(blocks.size(), Eigen::MatrixXd::Zero(size, size));
  std::vector<Eigen::VectorXd> rights(blocks.size(), Eigen::VectorXd::Zero(size));
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(size, size);
  ColorRows rows;
  rows.slopes.resize(3, size);
  for (std::size_t b = 0; b < blocks.size(); ++b) {
    for (const std::size_t i : blocks[b]) {
      rows_of(i, &rows);
      normals[b] += rows.weight * rows.slopes.transpose() * rows.slopes;
      rights[b] += rows.weight * rows.slopes.transpose() * rows.residual;
    }
    normal += normals[b];
  }
  // To a diagonal of ones, so that units do not matter; Eigen solves a singular matrix in silence.
  const Eigen::VectorXd scale =
      normal.diagonal().cwiseSqrt().unaryExpr([](double d) { return d > 0.0 ? 1.0 / d : 0.0; });
  const Eigen::LDLT<Eigen::MatrixXd> factors(scale.asDiagonal() * normal * scale.asDiagonal());
  if (factors.info() != Eigen::Success || !(factors.vectorD().minCoeff() > kSingular)) {
    throw SolveError("the photograph does not determine its pose: too little of it shows texture");
  }
  // What the solution would move by without a block, to first order: (N - N_b)^-1 r_b.
  Eigen::MatrixXd squares = Eigen::MatrixXd::Zero(size, size);
  for (std::size_t b = 0; b < blocks.size(); ++b) {
    const Eigen::MatrixXd others =
        scale.asDiagonal() * (normal - kLeftOut * normals[b]) * scale.asDiagonal();
    const Eigen::VectorXd scaled = scale.asDiagonal() * rights[b];
    const Eigen::VectorXd moved = scale.asDiagonal() * others.ldlt().solve(scaled);
    squares += moved * moved.transpose();
  }
  const auto count = static_cast<double>(blocks.size());
  return ((count - 1) / count * squares).topLeftCorner<6, 6>();
}

}  // namespace gsut
