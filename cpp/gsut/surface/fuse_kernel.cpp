// Compiled once per instruction set.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/surface/fuse_kernel.cpp"
#include "gsut/base/hwy_targets.h"

#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "gsut/base/isa.h"
#include "gsut/surface/fuse_kernel.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
const hn::CappedTag<float, 16> d;
const hn::RebindToSigned<decltype(d)> di;
using Vec = hn::Vec<decltype(d)>;
using Int = hn::Vec<decltype(di)>;
using Mask = hn::Mask<decltype(d)>;

struct Samples {
  Vec inverse, cosine, weight;  // of the depth; 0: none
  Mask counts;
};

HWY_INLINE Int ToIndex(Mask has, Vec x) { return hn::ConvertTo(di, hn::IfThenElseZero(has, x)); }

// DepthView::Sample, lane by lane; cosine and weight only if counts(inverse) holds for any.
template <class Counts>
HWY_INLINE Samples SampleAt(const DepthPixels& pixels, Vec u, Vec v, Counts&& counts) {
  const Vec zero = hn::Zero(d), half = hn::Set(d, 0.5f), one = hn::Set(d, 1.0f);
  const Vec width = hn::Set(d, static_cast<float>(pixels.width));
  const Vec height = hn::Set(d, static_cast<float>(pixels.height));
  const Int stride = hn::Set(di, pixels.width);
  const Int fields = hn::Set(di, DepthPixels::kFields);
  // NaN is outside.
  const Mask inside = hn::And(hn::And(hn::Ge(u, zero), hn::Ge(v, zero)),
                              hn::And(hn::Lt(u, width), hn::Lt(v, height)));
  const Vec left = hn::Sub(u, half), up = hn::Sub(v, half);
  const Mask between =
      hn::And(hn::And(inside, hn::And(hn::Ge(left, zero), hn::Ge(up, zero))),
              hn::And(hn::Lt(left, hn::Sub(width, one)), hn::Lt(up, hn::Sub(height, one))));
  const Int x = ToIndex(between, left), y = ToIndex(between, up);
  const Int corner = hn::Mul(fields, hn::Add(x, hn::Mul(y, stride)));
  const Int right = hn::Set(di, DepthPixels::kFields);
  const Int below = hn::Mul(stride, fields);
  const Vec a = hn::Sub(left, hn::ConvertTo(d, x)), b = hn::Sub(up, hn::ConvertTo(d, y));
  // An image of one row or column has no pixel beside or below: no lane is `between` then.
  const bool wide = pixels.width > 1 && pixels.height > 1;
  const Int beside = wide ? right : hn::Zero(di), beneath = wide ? below : hn::Zero(di);
  Vec four[4];
  const auto gather = [&](int field) HWY_ATTR {
    const float* base = pixels.values + field;
    four[0] = hn::GatherIndex(d, base, corner);
    four[1] = hn::GatherIndex(d, base, hn::Add(corner, beside));
    four[2] = hn::GatherIndex(d, base, hn::Add(corner, beneath));
    four[3] = hn::GatherIndex(d, base, hn::Add(corner, hn::Add(beside, beneath)));
  };
  // Bilinear, along the row above and the one below, then between them.
  const auto mixed = [&]() HWY_ATTR {
    const Vec above = hn::MulAdd(a, hn::Sub(four[1], four[0]), four[0]);
    const Vec under = hn::MulAdd(a, hn::Sub(four[3], four[2]), four[2]);
    return hn::MulAdd(b, hn::Sub(under, above), above);
  };
  gather(0);
  // One surface: the four inverse depths differ by less than kSameSurface. Else the nearest pixel.
  const Vec least = hn::Min(hn::Min(four[0], four[1]), hn::Min(four[2], four[3]));
  const Vec most = hn::Max(hn::Max(four[0], four[1]), hn::Max(four[2], four[3]));
  const Mask smooth = hn::And(between, hn::Lt(most, hn::Mul(hn::Set(d, kSameSurface), least)));
  Samples out = {hn::IfThenElseZero(smooth, mixed()), zero, zero, smooth};
  const Mask single = hn::AndNot(smooth, inside);
  const bool any_single = !hn::AllFalse(d, single);
  const float* base = pixels.values;
  Int nearest = hn::Zero(di);
  if (any_single) {
    nearest = hn::Mul(fields, hn::Add(ToIndex(inside, u), hn::Mul(ToIndex(inside, v), stride)));
    out.inverse = hn::IfThenElse(single, hn::GatherIndex(d, base, nearest), out.inverse);
  }
  out.counts = counts(out.inverse);
  if (hn::AllFalse(d, out.counts)) return out;
  gather(1);
  out.cosine = mixed();
  gather(2);
  out.weight = mixed();
  if (!any_single) return out;
  out.cosine = hn::IfThenElse(single, hn::GatherIndex(d, base + 1, nearest), out.cosine);
  out.weight = hn::IfThenElse(single, hn::GatherIndex(d, base + 2, nearest), out.weight);
  return out;
}

// Whether all points lie farther than what the view sees at their pixels, by more than `slack`. A
// lane where u or v is no number has no say.
bool Behind(const DepthPixels& pixels, int count, const float* u, const float* v,
            const float* distance, float slack) {
  const Vec zero = hn::Zero(d), one = hn::Set(d, 1.0f);
  for (int i = 0; i < count; i += static_cast<int>(hn::Lanes(d))) {
    const Vec at_u = hn::Load(d, u + i), at_v = hn::Load(d, v + i);
    const Mask asked = hn::And(hn::IsFinite(at_u), hn::IsFinite(at_v));
    const auto none = [&](Vec) HWY_ATTR { return hn::Lt(zero, zero); };
    const Vec inverse = SampleAt(pixels, at_u, at_v, none).inverse;
    const Mask has = hn::Gt(inverse, zero);
    const Vec depth = hn::Div(one, hn::IfThenElse(has, inverse, one));
    const Vec limit = hn::MulAdd(hn::Set(d, kWellBehind), depth, hn::Set(d, slack));
    const Mask behind = hn::And(has, hn::Gt(hn::Load(d, distance + i), limit));
    if (!hn::AllFalse(d, hn::AndNot(behind, asked))) return false;
  }
  return true;
}

// Adds (depth - distance) cosine / voxel size, the distance to the plane that is seen, to each
// voxel, cut off at the truncation. The weight, cosine / distance^2, is what a pixel is worth as a
// sample of the surface; it fades to 0 behind the surface, and is free_weight of that far before
// it.
void Add(const DepthPixels& pixels, float truncation, float free_weight, int count,
         const SeenVoxels& voxels) {
  const Vec zero = hn::Zero(d), one = hn::Set(d, 1.0f), far = hn::Set(d, truncation);
  for (int i = 0; i < count; i += static_cast<int>(hn::Lanes(d))) {
    const Vec size = hn::Load(d, voxels.size + i);
    const Vec distance = hn::Load(d, voxels.distance + i);
    Vec before = zero;  // voxels from here to the surface, along the ray
    const auto counting = [&](Vec inverse) HWY_ATTR {
      const Mask has = hn::And(hn::Gt(size, zero), hn::Gt(inverse, zero));
      const Vec depth = hn::Div(one, hn::IfThenElse(has, inverse, one));
      const Vec per_voxel = hn::Div(one, hn::IfThenElse(has, size, one));
      before = hn::Mul(hn::Sub(depth, distance), per_voxel);
      // Behind a surface seen at a slant its plane soon says nothing.
      return hn::And(has, hn::Gt(before, hn::Set(d, -kSlant * truncation)));
    };
    const Samples seen =
        SampleAt(pixels, hn::Load(d, voxels.u + i), hn::Load(d, voxels.v + i), counting);
    if (hn::AllFalse(d, seen.counts)) continue;
    const Vec in_voxels = hn::Mul(before, seen.cosine);
    const Mask counts = hn::And(seen.counts, hn::Gt(in_voxels, hn::Neg(far)));
    Vec weight = hn::Div(hn::Mul(seen.weight, seen.cosine), hn::Mul(distance, distance));
    const Vec fading = hn::Mul(hn::Add(far, in_voxels), hn::Set(d, 1.0f / (truncation - 1.0f)));
    weight = hn::Mul(weight, hn::Min(fading, one));
    weight =
        hn::IfThenElse(hn::Gt(in_voxels, far), hn::Mul(weight, hn::Set(d, free_weight)), weight);
    weight = hn::IfThenElseZero(counts, weight);
    const Vec kept = hn::IfThenElseZero(counts, hn::Min(in_voxels, far));
    hn::Store(hn::MulAdd(weight, kept, hn::Load(d, voxels.sum + i)), d, voxels.sum + i);
    hn::Store(hn::Add(weight, hn::Load(d, voxels.weight + i)), d, voxels.weight + i);
  }
}

}  // namespace
// NOLINTNEXTLINE(google-readability-namespace-comments)
}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {
HWY_EXPORT(Add);
HWY_EXPORT(Behind);

bool AllBehind(const DepthPixels& pixels, int count, const float* u, const float* v,
               const float* distance, float slack) {
  return HWY_DYNAMIC_DISPATCH(Behind)(pixels, count, u, v, distance, slack);
}

void AddDepths(const DepthPixels& pixels, float truncation, float free_weight, int count,
               const SeenVoxels& voxels) {
  HWY_DYNAMIC_DISPATCH(Add)(pixels, truncation, free_weight, count, voxels);
}

}  // namespace gsut
#endif
