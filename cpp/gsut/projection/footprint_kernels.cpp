// The vectorised footprints, compiled once per instruction set.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/projection/footprint_kernels.cpp"
#include "gsut/base/hwy_targets.h"

#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <cmath>

#include "gsut/projection/block-inl.h"
#include "gsut/projection/footprint_kernels.h"
#include "gsut/projection/footprint-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Stores footprints and states of the lanes from i on.
// An empty box (low above high) stands for no box, NaN for no centre; boxes grow by kBoxRounding,
// so that rounding never makes them too small.
HWY_INLINE void StoreFootprints(const BoundedFootprint<Lane>& f, LaneMask possible, std::int64_t i,
                                int count, Footprints<float>* out) {
  const FloatTag d;
  const LaneMask valid = IsFinite(f.u);
  const LaneMask whole =
      AndMask(AndMask(possible, valid), IsFinite(f.low_u + f.high_u + f.low_v + f.high_v));
  const Lane nan(static_cast<double>(__builtin_nanf(""))), rounding(kBoxRounding);
  const Lane high(1.0), low(-1.0);
  const auto store = [&](Lane value, AlignedVector<float>* array) HWY_ATTR {
    hn::StoreU(value.v, d, &(*array)[static_cast<std::size_t>(i)]);
  };
  store(Select(valid, f.u, nan), &out->u);
  store(Select(valid, f.v, nan), &out->v);
  store(Select(valid, f.cov_uu, nan), &out->cov_uu);
  store(Select(valid, f.cov_uv, nan), &out->cov_uv);
  store(Select(valid, f.cov_vv, nan), &out->cov_vv);
  store(Select(whole, f.low_u - rounding, high), &out->low_u);
  store(Select(whole, f.high_u + rounding, low), &out->high_u);
  store(Select(whole, f.low_v - rounding, high), &out->low_v);
  store(Select(whole, f.high_v + rounding, low), &out->high_v);
  const std::uint64_t is_box = MaskBits(whole.m), is_possible = MaskBits(possible.m);
  for (int k = 0; k < count; ++k) {
    const std::size_t j = static_cast<std::size_t>(i + k);
    out->status[j] = (is_box >> k) & 1        ? FootprintStatus::kBox
                     : (is_possible >> k) & 1 ? FootprintStatus::kUnknown
                                              : FootprintStatus::kNothing;
  }
}

// What is kept of a Gaussian while its points go through the lens.
struct WaitingFootprint {
  PlacedGaussian<Lane> g;  // for EWA
  Lane reach;
  LaneMask possible, has_outline;
};

// A block's points, and what is kept of its Gaussians until their pixels are there.
struct FootprintBlock : PointBlock {
  static constexpr int kGaussians = 128;
  static constexpr int kVectors = kGaussians / kLanes;
  alignas(64) float derivatives[6][kGaussians];  // of EWA, which has one point a Gaussian
  WaitingFootprint waiting[kVectors];
  double circle[kOutlinePoints][2];
};

// The points of the Gaussians from i on, `points` each, as entry v of the block.
HWY_INLINE void PutGaussians(const FootprintTask& task, std::int64_t i, int v, int points,
                             FootprintBlock* block) {
  const LensDomain& domain = task.lens.domain;
  const SeenLanes seen = LoadSeen(task.gaussians, i, task.view, task.log2_raw_min, task.max_cutoff);
  const Visibility visibility = VisibilityOf(seen, domain.max_angle);
  WaitingFootprint& waiting = block->waiting[v];
  PlacedGaussian<Lane>& g = waiting.g;
  for (int k = 0; k < 3; ++k) {
    g.mean[k] = seen.mean[k];
    g.scale[k] = seen.scale[k];
    for (int row = 0; row < 3; ++row) g.axes[k][row] = seen.axes[k][row];
  }
  waiting.reach = visibility.reach;
  waiting.possible = AndMask(AndMask(visibility.possible, seen.distance > Lane(0.0)),
                             NotMask(visibility.beyond_domain));
  const auto put = [&](int k, Lane x, Lane y, Lane z)
                       HWY_ATTR { block->Put(points * v + k, x, y, z); };
  switch (task.method) {
    case ProjectionMethod::kEwa:
      put(0, g.mean[0], g.mean[1], g.mean[2]);
      break;
    case ProjectionMethod::kSilhouette:
      waiting.has_outline =
          PutOutline<kOutlinePoints>(domain, block->circle, g, waiting.reach, put);
      break;
    case ProjectionMethod::kUnscented:
      PutUnscentedPoints(task.weights, g.mean, g.axes, g.scale, put);
      break;
  }
}

// The footprints of entry v of the block.
HWY_INLINE BoundedFootprint<Lane> GetFootprints(const FootprintTask& task, int v, int points,
                                                const FootprintBlock& block) {
  const LensDomain& domain = task.lens.domain;
  const WaitingFootprint& waiting = block.waiting[v];
  const auto get = [&](int k, Lane* pu, Lane* pv) HWY_ATTR { block.Get(points * v + k, pu, pv); };
  switch (task.method) {
    case ProjectionMethod::kEwa: {
      Lane u, v_, derivatives[6];
      get(0, &u, &v_);
      for (int k = 0; k < 6; ++k) {
        derivatives[k].v = hn::Load(FloatTag(), block.derivatives[k] + v * kLanes);
      }
      return EwaFootprint(waiting.g, waiting.reach, u, v_, derivatives, derivatives + 3);
    }
    case ProjectionMethod::kSilhouette:
      return OutlineFootprint<kOutlinePoints>(domain, block.circle, waiting.reach,
                                              waiting.has_outline, get);
    case ProjectionMethod::kUnscented:
      break;
  }
  return BoundUnscented(domain, task.weights, waiting.reach, get);
}

// Blocks of as many Gaussians as their points fit into the first-level cache: put all points,
// project them in one call of the lens' kernel, read all footprints. The lens is chosen once a
// call, so that no method is compiled once a lens.
void FootprintRange(const FootprintTask& task, std::int64_t begin, std::int64_t end,
                    Footprints<float>* out) {
  const bool by_ewa = task.method == ProjectionMethod::kEwa;
  const int points = by_ewa                                         ? 1
                     : task.method == ProjectionMethod::kSilhouette ? kOutlinePoints
                                                                    : kUnscentedPoints;
  const int most_vectors =
      HWY_MIN(FootprintBlock::kVectors, PointBlock::kPoints / (points * kLanes));
  FootprintBlock block;
  for (int k = 0; k < kOutlinePoints; ++k) {
    block.circle[k][0] = std::cos(2.0 * kPi * k / kOutlinePoints);
    block.circle[k][1] = std::sin(2.0 * kPi * k / kOutlinePoints);
  }
  LensBatch batch = block.Batch();
  for (int k = 0; k < 3; ++k) {
    batch.du[k] = block.derivatives[k];
    batch.dv[k] = block.derivatives[3 + k];
  }
  for (std::int64_t first = begin; first < end; first += most_vectors * kLanes) {
    int vectors = 0;
    for (std::int64_t i = first; i < end && vectors < most_vectors; i += kLanes, ++vectors) {
      PutGaussians(task, i, vectors, points, &block);
    }
    (by_ewa ? ProjectPointsJacobian : ProjectPoints)(task.lens, points * kLanes * vectors, batch);
    for (int v = 0; v < vectors; ++v) {
      const std::int64_t i = first + v * kLanes;
      const int count = static_cast<int>(HWY_MIN(end - i, static_cast<std::int64_t>(kLanes)));
      StoreFootprints(GetFootprints(task, v, points, block), block.waiting[v].possible, i, count,
                      out);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {
HWY_EXPORT(FootprintRange);

void FootprintKernel(const FootprintTask& task, std::int64_t begin, std::int64_t end,
                     Footprints<float>* footprints) {
  HWY_DYNAMIC_DISPATCH(FootprintRange)(task, begin, end, footprints);
}

}  // namespace gsut
#endif
