// Holds the parameters of lenses that a solver may not change.
#include "gsut/sfm/lens_parameters.h"

#include <Eigen/Core>
#include <algorithm>
#include <map>
#include <vector>

#include "gsut/base/errors.h"

namespace gsut {
namespace {

using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// A parameter block that only moves along the columns of a matrix.
class LinearManifold : public ceres::Manifold {
 public:
  explicit LinearManifold(Matrix columns)
      : columns_(std::move(columns)),
        inverse_(columns_.completeOrthogonalDecomposition().pseudoInverse()) {}

  int AmbientSize() const override { return static_cast<int>(columns_.rows()); }
  int TangentSize() const override { return static_cast<int>(columns_.cols()); }

  // Linear, so the derivative of Plus by delta is the matrix itself, at any x.
  bool Plus(const double* x, const double* delta, double* sum) const override {
    Vector(sum, columns_.rows()) =
        Vector(x, columns_.rows()) + columns_ * Vector(delta, columns_.cols());
    return true;
  }
  bool PlusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<Matrix>(jacobian, columns_.rows(), columns_.cols()) = columns_;
    return true;
  }
  bool Minus(const double* y, const double* x, double* difference) const override {
    Vector(difference, columns_.cols()) =
        inverse_ * (Vector(y, columns_.rows()) - Vector(x, columns_.rows()));
    return true;
  }
  bool MinusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<Matrix>(jacobian, columns_.cols(), columns_.rows()) = inverse_;
    return true;
  }

 private:
  static Eigen::Map<Eigen::VectorXd> Vector(double* data, Eigen::Index size) {
    return {data, size};
  }
  static Eigen::Map<const Eigen::VectorXd> Vector(const double* data, Eigen::Index size) {
    return {data, size};
  }

  Matrix columns_, inverse_;
};

}  // namespace

void CheckLensFlags(const std::vector<Camera>& cameras,
                    const std::vector<std::vector<std::uint8_t>>& lens_free) {
  if (lens_free.empty()) return;
  bool fits = lens_free.size() == cameras.size();
  for (std::size_t c = 0; fits && c < cameras.size(); ++c) {
    fits = lens_free[c].empty() || static_cast<int>(lens_free[c].size()) == cameras[c].num_params();
  }
  // One flag a parameter, or none for a lens that stays.
  if (!fits) throw InputError("lens_free must have one flag a parameter of each camera");
}

// params = start + columns * unknowns: one column a free parameter, and one column of several ones
// for parameters with the same flag above kLensFree, which so move together; kLensNear is in both.
Eigen::MatrixXd FreeLensColumns(const std::vector<std::uint8_t>& free) {
  std::vector<std::vector<int>> columns;
  std::map<int, std::size_t> column_of_group;
  for (std::size_t k = 0; k < free.size(); ++k) {
    if (!free[k]) continue;
    const auto tied = column_of_group.find(kLensTied);
    if (free[k] == kLensNear && tied != column_of_group.end()) {
      columns[tied->second].push_back(static_cast<int>(k));
    }
    // Flag 1 makes a column of its own, hence a key that no other parameter has.
    const auto [group, added] = column_of_group.try_emplace(
        free[k] == kLensFree ? -1 - static_cast<int>(k) : free[k], columns.size());
    if (added) columns.emplace_back();
    columns[group->second].push_back(static_cast<int>(k));
  }
  Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(free.size()),
                                                 static_cast<Eigen::Index>(columns.size()));
  for (std::size_t column = 0; column < columns.size(); ++column) {
    for (const int k : columns[column]) matrix(k, static_cast<Eigen::Index>(column)) = 1.0;
  }
  return matrix;
}

std::vector<int> FreeLensParams(const std::vector<std::uint8_t>& free) {
  std::vector<int> params;
  for (std::size_t k = 0; k < free.size(); ++k) {
    if (free[k]) params.push_back(static_cast<int>(k));
  }
  return params;
}

// Ceres' own subset manifold holds parameters but cannot tie several to one unknown.
void HoldLensParameters(const std::vector<std::uint8_t>& free, double* lens,
                        ceres::Problem* problem,
                        std::vector<std::unique_ptr<ceres::Manifold>>* manifolds) {
  Matrix columns = FreeLensColumns(free);
  // All parameters free by themselves need no manifold.
  if (columns.cols() == 0) {
    problem->SetParameterBlockConstant(lens);
  } else if (columns.cols() < columns.rows()) {
    manifolds->push_back(std::make_unique<LinearManifold>(std::move(columns)));
    problem->SetManifold(lens, manifolds->back().get());
  }
}

}  // namespace gsut
