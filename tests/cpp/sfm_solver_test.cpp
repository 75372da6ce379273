// The linear algebra of bundle adjustment against dense matrices.
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <vector>

#include "gsut/base/isa.h"
#include "gsut/base/parallel.h"
#include "gsut/sfm/reduced_system.h"
#include "gsut/sfm/subtract_product.h"
#include "gsut/sfm/tiled_cholesky.h"
#include "synthetic_bundle.h"

namespace gsut {
namespace {

constexpr double kSolved = 1e-10;  // relative, matrices of condition 1e3 to 1e4; worst 6e-13

// Restores the number of threads.
class Threads {
 public:
  explicit Threads(int count) : before_(NumThreads()) { SetNumThreads(count); }
  ~Threads() { SetNumThreads(before_); }

 private:
  int before_;
};

// A band of tiles, its last row of tiles joined to all.
TEST(TiledCholesky, SolvesAsADenseMatrixDoes) {
  Numbers numbers(71);
  const std::vector<int> sizes = {5, 12, 7, 9, 12, 6, 3};
  const int count = static_cast<int>(sizes.size());
  std::vector<std::uint8_t> present(count * count, 0);
  for (int i = 0; i < count; ++i) {
    for (int j = 0; j <= i; ++j) present[i * count + j] = i - j < 2 || i == count - 1;
  }
  TiledCholesky matrix(sizes, present);
  EXPECT_LT(matrix.Fill(), 0.7);
  matrix.SetZero();
  Eigen::MatrixXd dense = Eigen::MatrixXd::Zero(matrix.size(), matrix.size());
  for (int i = 0, row = 0; i < count; row += sizes[i++]) {
    for (int j = 0, column = 0; j <= i; column += sizes[j++]) {
      if (!present[i * count + j]) continue;
      Eigen::Map<Eigen::MatrixXd> tile(matrix.Tile(i, j), sizes[i], sizes[j]);
      for (double& value : tile.reshaped()) value = numbers.Uniform(-1, 1);
      if (i == j) tile = (tile * tile.transpose()).eval();
      if (i == j) tile.diagonal().array() += 20.0;
      dense.block(row, column, sizes[i], sizes[j]) = tile;
      dense.block(column, row, sizes[j], sizes[i]) = tile.transpose();
    }
  }
  Eigen::VectorXd side(matrix.size());
  for (double& value : side) value = numbers.Uniform(-1, 1);
  const Eigen::VectorXd expected = dense.llt().solve(side);
  ASSERT_TRUE(matrix.Factorize());
  matrix.Solve(&side);
  EXPECT_LT((side - expected).norm(), kSolved * expected.norm());
}

// Rows of a pose, of one that moves, and of another block; columns that fill no vector.
TEST(SubtractProducts, AgreesWithDenseMatricesOnEveryInstructionSet) {
  Numbers numbers(73);
  const auto random = [&](int rows, int columns) {
    return Eigen::MatrixXd::NullaryExpr(rows, columns, [&] { return numbers.Uniform(-1, 1); });
  };
  for (const std::string& isa : AvailableIsas()) {
    SetIsa(isa);
    for (const int rows : {1, 5, 6, 8, 12}) {
      for (const int inner : {2, 3}) {
        const Eigen::MatrixXd a = random(rows, inner), m = random(inner, inner);
        const Eigen::MatrixXd wide = random(6, inner), narrow = random(1, inner);
        Eigen::MatrixXd out = random(rows + 3, 7), expected = out;
        expected.topLeftCorner(rows, 6) -= a * m * wide.transpose();
        expected.topRightCorner(rows, 1) -= 2.0 * a * m * narrow.transpose();
        const ProductTerm last = {&out(0, 6), narrow.data(), 1};
        const ProductTerm terms[] = {last, {out.data(), wide.data(), 6}, last};
        SubtractProducts(terms, out.rows(), a.data(), m.data(), rows, inner);
        EXPECT_LT((out - expected).norm(), 1e-14) << isa << ' ' << rows << ' ' << inner;
      }
    }
  }
  SetIsa("");
}

TEST(TiledCholesky, SaysWhereNothingIsDetermined) {
  TiledCholesky matrix({3, 2}, {1, 0, 1, 1});
  matrix.SetZero();
  EXPECT_FALSE(matrix.Factorize());
}

// Blocks of six and a last one of two that every observation has; neighbours see common points.
struct Walk {
  static constexpr int kBlocks = 40, kPoints = 160;
  Walk() {
    for (int point = 0; point < kPoints; ++point) {
      for (int block = 0; block < kBlocks; ++block) {
        if (std::abs(block - point / 4) > 3) continue;
        observations.push_back({point % 10 == 9 ? -1 : point, 2, {block, kBlocks}});
      }
    }
    sizes.assign(kBlocks, 6);
    sizes.push_back(2);
  }
  std::vector<ReducedSystem::Dependence> observations;
  std::vector<int> sizes;
};

void SetValues(const Walk& walk, ReducedSystem* system) {
  Numbers numbers(72);
  for (std::size_t i = 0; i < walk.observations.size(); ++i) {
    const int index = static_cast<int>(i);
    for (int k = 0; k < 16; ++k) system->ByBlocks(index)[k] = numbers.Uniform(-1, 1);
    for (double& value : system->ByPoint(index).reshaped()) value = numbers.Uniform(-1, 1);
    system->Residual(index) << numbers.Uniform(-1, 1), numbers.Uniform(-1, 1);
    if (walk.observations[i].blocks[0] == 0) {  // its second unknown stays
      system->ByBlocks(index)[1] = system->ByBlocks(index)[7] = 0.0;
    }
  }
  system->Held(0)[1] = 1;
  system->PriorWeights(3).setConstant(0.7);
  system->PriorResiduals(3).setConstant(-0.4);
}

TEST(ReducedSystem, StepIsThatOfTheWholeNormalEquations) {
  constexpr double kRadius = 50.0;
  const Walk walk;
  ReducedSystem system(walk.sizes, Walk::kBlocks, Walk::kPoints, walk.observations);
  SetValues(walk, &system);
  const int blocks = 6 * Walk::kBlocks + 2, size = blocks + 3 * Walk::kPoints;
  Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(2 * walk.observations.size() + 6, size);
  Eigen::VectorXd residuals = Eigen::VectorXd::Zero(rows.rows());
  for (std::size_t i = 0; i < walk.observations.size(); ++i) {
    const int index = static_cast<int>(i);
    const auto& observation = walk.observations[i];
    using RowMajor = Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor>;
    const double* values = system.ByBlocks(index);
    auto pair = rows.middleRows<2>(2 * index);
    pair.middleCols(6 * observation.blocks[0], 6) = Eigen::Map<const RowMajor>(values, 2, 6);
    pair.middleCols(blocks - 2, 2) = Eigen::Map<const RowMajor>(values + 12, 2, 2);
    if (observation.point >= 0) {
      pair.middleCols(blocks + 3 * observation.point, 3) = system.ByPoint(index);
    }
    residuals.segment<2>(2 * index) = system.Residual(index);
  }
  rows.bottomRows<6>().middleCols<6>(18).diagonal().setConstant(0.7);
  residuals.tail<6>().setConstant(-0.4);
  Eigen::MatrixXd normal = rows.transpose() * rows;
  const Eigen::VectorXd diagonal = normal.diagonal();
  normal.diagonal() += diagonal / kRadius;
  for (int k = 0; k < size; ++k) {
    if (diagonal[k] == 0.0) normal(k, k) = 1.0;  // the one held, and points that stay
  }
  const Eigen::VectorXd step = normal.llt().solve(-rows.transpose() * residuals);
  ASSERT_TRUE(system.Solve(kRadius));
  EXPECT_LT(system.matrix().Fill(), 1.0);
  for (int block = 0; block <= Walk::kBlocks; ++block) {
    const Eigen::VectorXd found = system.BlockStep(block);
    EXPECT_LT((found - step.segment(6 * block, found.size())).norm(), kSolved * step.norm());
  }
  for (int point = 0; point < Walk::kPoints; ++point) {
    EXPECT_LT((system.PointStep(point) - step.segment<3>(blocks + 3 * point)).norm(),
              kSolved * step.norm());
  }
  const double left = (rows * step + residuals).squaredNorm();
  EXPECT_NEAR(system.PredictedDecrease(), 0.5 * (residuals.squaredNorm() - left), kSolved * left);
  EXPECT_EQ(system.BlockStep(0)[1], 0.0);
}

// The steps of blocks and of a point, one after the other.
Eigen::VectorXd StepOf(const ReducedSystem& system) {
  Eigen::VectorXd step(6 * Walk::kBlocks + 5);
  for (int block = 0; block < Walk::kBlocks; ++block) {
    step.segment<6>(6 * block) = system.BlockStep(block);
  }
  step.tail<5>() << system.BlockStep(Walk::kBlocks), system.PointStep(7);
  return step;
}

// With motions of any kind, conjugate gradients end at the step of the factorisation.
TEST(ReducedSystem, ConjugateGradientsFindTheStepOfTheFactorisation) {
  constexpr double kNear = 2e-3;  // relative; they end at 1e-3 in the norm of the system
  const Walk walk;
  ReducedSystem direct(walk.sizes, Walk::kBlocks, Walk::kPoints, walk.observations);
  ReducedSystem system(walk.sizes, Walk::kBlocks, Walk::kPoints, walk.observations, 0.0);
  EXPECT_FALSE(direct.iterative());
  ASSERT_TRUE(system.iterative());
  Numbers numbers(73);
  for (int block = 0; block < Walk::kBlocks; ++block) {
    system.Motions(block).resize(6, 7);
    for (double& value : system.Motions(block).reshaped()) value = numbers.Uniform(-1, 1);
  }
  system.Motions(0).row(1).setZero();  // it stays
  for (ReducedSystem* each : {&direct, &system}) {
    SetValues(walk, each);
    ASSERT_TRUE(each->Solve(1e4));
  }
  const Eigen::VectorXd expected = StepOf(direct);
  EXPECT_LT((StepOf(system) - expected).norm(), kNear * expected.norm());
  EXPECT_NEAR(system.PredictedDecrease(), direct.PredictedDecrease(),
              kNear * direct.PredictedDecrease());
  EXPECT_EQ(system.BlockStep(0)[1], 0.0);
}

TEST(ReducedSystem, SameBitsOnAnyNumberOfThreads) {
  const Walk walk;
  for (const double most_work : {1e9, 0.0}) {
    std::vector<Eigen::VectorXd> steps;
    for (const int count : {1, 2, 3}) {
      const Threads threads(count);
      ReducedSystem system(walk.sizes, Walk::kBlocks, Walk::kPoints, walk.observations, most_work);
      SetValues(walk, &system);
      ASSERT_TRUE(system.Solve(1e4));
      steps.push_back(StepOf(system));
    }
    ASSERT_EQ(steps.size(), 3U);
    EXPECT_EQ(steps[0], steps[1]);
    EXPECT_EQ(steps[0], steps[2]);
  }
}

}  // namespace
}  // namespace gsut
