// Footprints of many Gaussians: in double by the scalar code, in float the kernels' put together.
#include "gsut/projection/footprint.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/base/isa.h"
#include "gsut/base/parallel.h"
#include "gsut/cameras/lens_registry.h"
#include "gsut/projection/footprint_choice.h"
#include "gsut/projection/footprint_error.h"
#include "gsut/projection/footprint_kernels.h"
#include "gsut/projection/footprint_scalar.h"
#include "gsut/projection/lens_bend.h"
#include "gsut/projection/projection_steps.h"

namespace gsut {
namespace {

constexpr std::size_t kPadding = 16;
constexpr std::int64_t kGrain = 4096;

void CheckOptions(const FootprintOptions& options) {
  if (!(options.max_error_px > 0.0) || !std::isfinite(options.max_error_px)) {
    throw InputError("max_error_px must be a positive number of pixels, found " +
                     std::to_string(options.max_error_px));
  }
}

// Chosen Gaussians of a view, one after the other.
struct PackedGaussians {
  std::vector<float> means, quats, log_scales, opacity_logits;

  void Fill(const GaussiansView<const float>& g, const std::vector<std::int64_t>& rows) {
    means.resize(3 * rows.size());
    quats.resize(4 * rows.size());
    log_scales.resize(3 * rows.size());
    opacity_logits.resize(rows.size());
    for (std::size_t k = 0; k < rows.size(); ++k) {
      std::copy_n(g.means + 3 * rows[k], 3, &means[3 * k]);
      std::copy_n(g.quats + 4 * rows[k], 4, &quats[4 * k]);
      std::copy_n(g.log_scales + 3 * rows[k], 3, &log_scales[3 * k]);
      opacity_logits[k] = g.opacity_logits[rows[k]];
    }
  }
  GaussiansView<const float> View() const {
    return {static_cast<std::int64_t>(opacity_logits.size()),
            1,
            means.data(),
            quats.data(),
            log_scales.data(),
            opacity_logits.data(),
            nullptr};
  }
};

void CopyRow(const Footprints<float>& from, std::size_t k, std::size_t j, Footprints<float>* to) {
  to->u[j] = from.u[k];
  to->v[j] = from.v[k];
  to->cov_uu[j] = from.cov_uu[k];
  to->cov_uv[j] = from.cov_uv[k];
  to->cov_vv[j] = from.cov_vv[k];
  to->low_u[j] = from.low_u[k];
  to->high_u[j] = from.high_u[k];
  to->low_v[j] = from.low_v[k];
  to->high_v[j] = from.high_v[k];
  to->status[j] = from.status[k];
  to->method[j] = from.method[k];
}

void Widen(std::size_t j, float wider, Footprints<float>* out) {
  out->low_u[j] -= wider;
  out->high_u[j] += wider;
  out->low_v[j] -= wider;
  out->high_v[j] += wider;
}

// Adaptive, for one part: each Gaussian is projected once, by the method chosen for it. Only where
// the unscented box turns out too loose, which its size does not tell beforehand, is it projected
// again.
class AdaptivePart {
 public:
  AdaptivePart(const FootprintTask& task, const Bend* bend, float max_error_px)
      : task_(task), bend_(bend), max_error_px_(max_error_px) {}

  void Run(std::int64_t begin, std::int64_t end, Footprints<float>* out) {
    ChooseFootprints(task_, bend_, max_error_px_, begin, end - begin, &choices_);
    for (const ProjectionMethod method :
         {ProjectionMethod::kEwa, ProjectionMethod::kUnscented, ProjectionMethod::kSilhouette}) {
      // Without branches: which method is next cannot be foretold.
      rows_.resize(static_cast<std::size_t>(end - begin));
      std::size_t count = 0;
      for (std::int64_t i = begin; i < end; ++i) {
        rows_[count] = i;
        count += choices_.codes[static_cast<std::size_t>(i - begin)] == CodeOf(method);
      }
      rows_.resize(count);
      Find(method, begin, end, out);
      if (method != ProjectionMethod::kSilhouette) WidenOrGiveUp(method, begin, out);
    }
  }

 private:
  // The footprints of rows_ by one method.
  void Find(ProjectionMethod method, std::int64_t begin, std::int64_t end, Footprints<float>* out) {
    if (rows_.empty()) return;
    task_.method = method;
    const std::int64_t count = static_cast<std::int64_t>(rows_.size());
    if (count == end - begin) {
      FootprintKernel(task_, begin, end, out);
      return;
    }
    packed_.Fill(task_.gaussians, rows_);
    part_.Resize(count);
    FootprintTask task = task_;
    task.gaussians = packed_.View();
    FootprintKernel(task, 0, count, &part_);
    for (std::size_t k = 0; k < rows_.size(); ++k) {
      CopyRow(part_, k, static_cast<std::size_t>(rows_[k]), out);
    }
  }

  void WidenOrGiveUp(ProjectionMethod method, std::int64_t begin, Footprints<float>* out) {
    for (const std::int64_t i : rows_) {
      const std::size_t j = static_cast<std::size_t>(i), k = static_cast<std::size_t>(i - begin);
      if (out->status[j] == FootprintStatus::kNothing) continue;
      const float half =
          0.5f * std::max(out->high_u[j] - out->low_u[j], out->high_v[j] - out->low_v[j]);
      const float width = choices_.widths[k];
      const bool loose = method == ProjectionMethod::kUnscented &&
                         !(width <= static_cast<float>(kLooseBox) * half);
      if (out->status[j] == FootprintStatus::kBox && !loose) {
        Widen(j, width, out);
      } else {
        choices_.codes[k] = CodeOf(ProjectionMethod::kSilhouette);
      }
    }
  }

  FootprintTask task_;
  const Bend* bend_;
  float max_error_px_;
  std::vector<std::int64_t> rows_;
  FootprintChoices choices_;
  PackedGaussians packed_;
  Footprints<float> part_;
};

}  // namespace

template <class T>
void Footprints<T>::Resize(std::int64_t n) {
  size = n;
  const std::size_t padded = static_cast<std::size_t>(n) + kPadding;
  for (AlignedVector<T>* array :
       {&u, &v, &cov_uu, &cov_uv, &cov_vv, &low_u, &high_u, &low_v, &high_v}) {
    array->resize(padded);
  }
  status.resize(padded);
  method.resize(padded);
}

template struct Footprints<float>;
template struct Footprints<double>;

void FindFootprintsReference(const GaussiansView<const double>& gaussians, const Camera& camera,
                             const Pose& camera_from_world, const FootprintOptions& options,
                             Footprints<double>* footprints) {
  CheckOptions(options);
  const ScalarFootprints scalar(camera, camera_from_world, options);
  footprints->Resize(gaussians.size);
  ParallelFor(gaussians.size, 64, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      StoreFootprint(scalar.Find(gaussians, i), 0.0, static_cast<std::size_t>(i), footprints);
    }
  });
}

void FindFootprints(const GaussiansView<const float>& gaussians, const Camera& camera,
                    const Pose& camera_from_world, const FootprintOptions& options,
                    Footprints<float>* footprints) {
  CheckOptions(options);
  ActiveIsa();  // applies GSUT_ISA before the first kernel runs
  const bool adaptive = options.method == ProjectionMethod::kAdaptive;
  const bool bounds = adaptive || options.method == ProjectionMethod::kSilhouette;
  FootprintTask task;
  std::vector<float> table;
  DescribeCamera(gaussians, camera, camera_from_world, options.rule, "projected", &table, &task);
  task.method = options.method;
  const SigmaRule rule = MakeSigmaRule(adaptive ? ProjectionMethod::kUnscented : options.method,
                                       adaptive ? UnscentedOptions() : options.unscented);
  task.rule = &rule;
  FootprintOptions exact = options;
  if (camera.IsCentral()) exact.method = ProjectionMethod::kSilhouette;
  const ScalarFootprints scalar(camera, camera_from_world, exact);
  const std::shared_ptr<const LensBend> bend = adaptive ? BendOf(camera) : nullptr;
  footprints->Resize(gaussians.size);
  ParallelFor(gaussians.size, kGrain, [&](std::int64_t begin, std::int64_t end) {
    if (bounds && !camera.IsCentral()) {
      for (std::int64_t i = begin; i < end; ++i) {
        StoreFootprint(scalar.Find(gaussians, i), kBoxRounding, static_cast<std::size_t>(i),
                       footprints);
      }
      return;
    }
    if (adaptive) {
      AdaptivePart(task, bend->table(), static_cast<float>(options.max_error_px))
          .Run(begin, end, footprints);
    } else {
      FootprintKernel(task, begin, end, footprints);
    }
    if (!bounds) return;
    for (std::int64_t i = begin; i < end; ++i) {
      const std::size_t j = static_cast<std::size_t>(i);
      if (footprints->status[j] != FootprintStatus::kUnknown) continue;
      StoreFootprint(scalar.Find(gaussians, i), kBoxRounding, j, footprints);
    }
  });
}

}  // namespace gsut
