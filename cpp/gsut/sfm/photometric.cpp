// Photometric refinement by Ceres: colour differences as blocks of residuals, and their problem.
#include "gsut/sfm/photometric.h"

#include <ceres/ceres.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <memory>
#include <string>

#include "gsut/base/check_arguments.h"
#include "gsut/base/errors.h"
#include "gsut/sfm/ceres_settings.h"
#include "gsut/sfm/lens_parameters.h"
#include "gsut/sfm/photometric_scene.h"
#include "gsut/sfm/pose_manifold.h"

namespace gsut {
namespace {

using Eigen::Map;
using Eigen::Vector3d;
using RowMatrix3d = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using RowMatrix36 = Eigen::Matrix<double, 3, 6, Eigen::RowMajor>;

// One pixel's share of the cost, a Huber loss rho of its squared colour difference s = |r|^2:
//   rho(s) = s  for |r| <= a,   2 a |r| - a^2  beyond,   rho'(s) = min(1, a / |r|).
// Gauss-Newton on a robust loss is least squares of sqrt(rho') r with its slopes (Triggs et al.,
// "Bundle adjustment: a modern synthesis", 2000, sec. 4.3; the term in rho'' < 0 is left out, as
// Ceres does). Its squares sum to rho' s instead of rho; `excess` = rho - rho' s >= 0 is what the
// cost lacks, a constant in the linear system.
struct RobustWeight {
  double root = 1.0;  // sqrt(rho')
  double excess = 0.0;
};

RobustWeight WeighHuber(double squared, double scale) {
  if (scale <= 0.0 || squared <= scale * scale) return {};
  const double length = std::sqrt(squared);
  return {std::sqrt(scale / length), scale * length - scale * scale};
}

// gain x colour + bias - photograph at pixel i of an image.
Vector3d ColorResidual(const ImageState& state, const PhotometricImage& image, std::size_t i,
                       const double* gain) {
  Vector3d out;
  for (std::size_t c = 0; c < 3; ++c) {
    const auto seen = static_cast<double>(image.colors[3 * i + c]);
    out[static_cast<int>(c)] = gain[0] * state.colors[3 * i + c] + gain[1] - seen;
  }
  return out;
}

// The slope of the scene's colour at pixel i by the pose's tangent (centre, rotation vector).
RowMatrix36 ByPoseTangent(const ImageState& state, std::size_t i) {
  RowMatrix36 out;
  out.leftCols<3>() = Map<const RowMatrix3d>(&state.by_center[9 * i]);
  out.rightCols<3>() = Map<const RowMatrix3d>(&state.by_turn[9 * i]);
  return out;
}

// Pixels of one cost: their rows and slopes, some 50 KB, stay in the second-level cache while Ceres
// carries them into its matrix, and what it keeps per cost weighs nothing.
constexpr std::size_t kPixelsPerCost = 256;

// The weighted colour differences of a run of an image's pixels, three rows a pixel, and one last
// row: the root of their excess, whose slopes are 0. Parameters: pose block, gain block and, if
// free, the lens. The loss lies inside, because Ceres would apply its own to all pixels as one.
class ColorCost : public ceres::CostFunction {
 public:
  ColorCost(const ImageState& state, const PhotometricImage& image, std::size_t begin,
            double loss_scale, int num_lens)
      : state_(state),
        image_(image),
        begin_(begin),
        end_(std::min(begin + kPixelsPerCost, image.pixels.size())),
        loss_scale_(loss_scale),
        num_lens_(num_lens) {
    set_num_residuals(static_cast<int>(3 * (end_ - begin_) + 1));
    *mutable_parameter_block_sizes() = {7, 2};
    if (num_lens_ > 0) mutable_parameter_block_sizes()->push_back(num_lens_);
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    if (state_.failed) return false;
    const double* gain = parameters[1];
    double* by_pose = jacobians == nullptr ? nullptr : jacobians[0];
    double* by_gain = jacobians == nullptr ? nullptr : jacobians[1];
    double* by_lens = jacobians == nullptr || num_lens_ == 0 ? nullptr : jacobians[2];
    double excess = 0.0;
    for (std::size_t i = begin_; i < end_; ++i) {
      const std::size_t row = 3 * (i - begin_);
      const Vector3d residual = ColorResidual(state_, image_, i, gain);
      const RobustWeight weight = WeighHuber(residual.squaredNorm(), loss_scale_);
      excess += weight.excess;
      Map<Vector3d>{residuals + row} = weight.root * residual;
      if (by_pose != nullptr) {
        Map<Eigen::Matrix<double, 3, 7, Eigen::RowMajor>> out(by_pose + 7 * row);
        out.leftCols<6>() = weight.root * gain[0] * ByPoseTangent(state_, i);
        out.col(6).setZero();
      }
      if (by_gain != nullptr) {
        Map<Eigen::Matrix<double, 3, 2, Eigen::RowMajor>> out(by_gain + 2 * row);
        out.col(0) = weight.root * Map<const Vector3d>(&state_.colors[3 * i]);
        out.col(1).setConstant(weight.root);
      }
      if (by_lens != nullptr) {
        const auto width = static_cast<std::size_t>(num_lens_);
        const double* slopes = &state_.by_lens[3 * i * width];
        for (std::size_t k = 0; k < 3 * width; ++k) {
          by_lens[width * row + k] = weight.root * gain[0] * slopes[k];
        }
      }
    }
    const std::size_t last = 3 * (end_ - begin_);
    residuals[last] = std::sqrt(excess);
    if (by_pose != nullptr) std::fill_n(by_pose + 7 * last, 7, 0.0);
    if (by_gain != nullptr) std::fill_n(by_gain + 2 * last, 2, 0.0);
    if (by_lens != nullptr) std::fill_n(by_lens + num_lens_ * last, num_lens_, 0.0);
    return true;
  }

 private:
  const ImageState& state_;
  const PhotometricImage& image_;
  std::size_t begin_, end_;
  double loss_scale_;
  int num_lens_;
};

void Check(const std::vector<Camera>& cameras, const std::vector<PhotometricImage>& images,
           const PhotometricRefinementOptions& options) {
  if (images.empty()) throw InputError("there is no image to refine");
  for (const PhotometricImage& image : images) {
    if (image.camera < 0 || image.camera >= static_cast<int>(cameras.size())) {
      throw InputError("an image names camera " + std::to_string(image.camera) + " of " +
                       std::to_string(cameras.size()));
    }
    const Camera& camera = cameras[static_cast<std::size_t>(image.camera)];
    const std::size_t size = static_cast<std::size_t>(camera.width()) * camera.height();
    if (image.pixels.empty() || image.colors.size() != 3 * image.pixels.size() ||
        *std::max_element(image.pixels.begin(), image.pixels.end()) >= size) {
      throw InputError("an image has no pixels, or pixels outside it, or not one colour a pixel");
    }
    if (!camera.IsCentral()) {
      throw InputError("photometric refinement needs a lens with one centre, found " +
                       camera.model());
    }
  }
  CheckLensFlags(cameras, options.lens_free);
}

// Over all channels of all pixels, without the loss.
double Rms(const SceneEvaluation& evaluation, const std::vector<PhotometricImage>& images) {
  double sum = 0.0;
  std::size_t count = 0;
  for (std::size_t i = 0; i < images.size(); ++i) {
    const ImageState& state = evaluation.states[i];
    if (state.failed) continue;
    for (std::size_t k = 0; k < state.colors.size(); ++k) {
      const double difference = state.gain[0] * state.colors[k] + state.gain[1] -
                                static_cast<double>(images[i].colors[k]);
      sum += difference * difference;
    }
    count += state.colors.size();
  }
  return std::sqrt(sum / static_cast<double>(std::max<std::size_t>(1, count)));
}

// The problem as Ceres takes it, and what it must find alive until it is solved.
class ColorProblem {
 public:
  ColorProblem(SceneEvaluation* evaluation, const std::vector<Camera>& cameras,
               const std::vector<PhotometricImage>& images,
               const PhotometricRefinementOptions& options)
      : problem_(MakeOptions(evaluation)) {
    for (std::size_t i = 0; i < images.size(); ++i) {
      AddImage(evaluation, cameras, images[i], options, &evaluation->states[i]);
    }
    for (std::size_t c = 0; c < cameras.size(); ++c) {
      double* lens = evaluation->lenses[c].data();
      if (!problem_.HasParameterBlock(lens)) continue;
      // A group of its own: within a group Ceres orders blocks by their addresses.
      ordering_->AddElementToGroup(lens, 2 + static_cast<int>(c));
      HoldLensParameters(options.lens_free[c], lens, &problem_, &lens_manifolds_);
      any_lens_ = true;
    }
  }

  // Throws SolveError with the solver's message if it fails.
  ceres::Solver::Summary Solve(const PhotometricRefinementOptions& options) {
    ceres::Solver::Options solver;
    // A lens couples all images: their poses are eliminated first (a Schur complement a pose).
    solver.linear_solver_type = any_lens_ ? ceres::DENSE_SCHUR : ceres::DENSE_NORMAL_CHOLESKY;
    if (any_lens_) solver.linear_solver_ordering = ordering_;
    solver.max_num_iterations = options.max_iterations + kMostRejected;
    StopAfter stop(options.max_iterations);
    StopWhenInterrupted interrupted;
    solver.callbacks = {&stop, &interrupted};
    solver.function_tolerance = options.function_tolerance;
    solver.logging_type = ceres::SILENT;
    const QuietSolver quiet;
    ceres::Solver::Summary summary;
    ceres::Solve(solver, &problem_, &summary);
    CheckInterrupt();
    if (!summary.IsSolutionUsable()) {
      throw SolveError("photometric refinement failed: " + summary.message);
    }
    return summary;
  }

 private:
  static ceres::Problem::Options MakeOptions(SceneEvaluation* evaluation) {
    ceres::Problem::Options options;
    options.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    options.evaluation_callback = evaluation;
    return options;
  }

  void AddImage(SceneEvaluation* evaluation, const std::vector<Camera>& cameras,
                const PhotometricImage& image, const PhotometricRefinementOptions& options,
                ImageState* state) {
    const auto camera = static_cast<std::size_t>(image.camera);
    const bool lens_free = evaluation->LensIsFree(image.camera);
    const int num_lens = lens_free ? cameras[camera].num_params() : 0;
    double* pose = state->pose.data();
    double* gain = state->gain.data();
    std::vector<double*> blocks = {pose, gain};
    if (lens_free) blocks.push_back(evaluation->lenses[camera].data());
    for (std::size_t begin = 0; begin < image.pixels.size(); begin += kPixelsPerCost) {
      problem_.AddResidualBlock(new ColorCost(*state, image, begin, options.loss_scale, num_lens),
                                nullptr, blocks);
    }
    problem_.SetManifold(pose, &manifold_);
    if (!options.with_gain) problem_.SetParameterBlockConstant(gain);
    ordering_->AddElementToGroup(pose, 0);
    ordering_->AddElementToGroup(gain, 1);
  }

  PoseManifold manifold_;
  std::vector<std::unique_ptr<ceres::Manifold>> lens_manifolds_;
  std::shared_ptr<ceres::ParameterBlockOrdering> ordering_ =
      std::make_shared<ceres::ParameterBlockOrdering>();
  bool any_lens_ = false;
  ceres::Problem problem_;
};

}  // namespace

PhotometricSummary RefinePhotometric(SceneColors* scene, std::vector<Camera>* cameras,
                                     std::vector<PhotometricImage>* images,
                                     const PhotometricRefinementOptions& options) {
  CheckGiven(scene, "scene");
  CheckGiven(cameras, "cameras");
  CheckGiven(images, "images");
  Check(*cameras, *images, options);
  SceneEvaluation evaluation(scene, *cameras, *images, options);
  evaluation.PrepareForEvaluation(true, true);
  for (const ImageState& state : evaluation.states) {
    if (state.failed) throw InputError("a chosen pixel has no ray");
  }
  PhotometricSummary summary;
  summary.rms_before = Rms(evaluation, *images);
  const ceres::Solver::Summary solved =
      ColorProblem(&evaluation, *cameras, *images, options).Solve(options);
  // Ceres may have evaluated a rejected step last: states go back to the solution.
  evaluation.PrepareForEvaluation(false, true);
  summary.rms_after = Rms(evaluation, *images);
  summary.iterations = static_cast<int>(solved.iterations.size()) - 1;
  summary.evaluations = evaluation.num_evaluations;
  summary.converged = solved.termination_type == ceres::CONVERGENCE;
  for (std::size_t i = 0; i < images->size(); ++i) {
    PhotometricImage& image = (*images)[i];
    const ImageState& state = evaluation.states[i];
    image.camera_from_world = FromBlock(state.pose);
    image.gain = state.gain[0];
    image.bias = state.gain[1];
  }
  std::vector<Camera> refined;
  refined.reserve(cameras->size());
  for (std::size_t c = 0; c < cameras->size(); ++c) {
    refined.push_back(evaluation.MakeLens(static_cast<int>(c)));
  }
  *cameras = std::move(refined);
  return summary;
}

}  // namespace gsut
