// The vectorised choice of a footprint's method: LensBend::At and BoundFootprintError in lanes.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/projection/footprint_choice.cpp"
#include "gsut/base/hwy_targets.h"

#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "gsut/base/lanes-inl.h"
#include "gsut/projection/footprint_choice.h"
#include "gsut/projection/footprint_error.h"
#include "gsut/projection/seen-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// What the choice looks at.
struct LooseSeen {
  Lane mean[3];  // in the camera frame
  Lane size;     // largest standard deviation over the distance
  Lane reach;    // root of the cut-off of D^2
};

HWY_INLINE LooseSeen LoadLoose(const FootprintTask& task, std::int64_t first) {
  const GaussiansView<const float>& g = task.gaussians;
  const std::int64_t available = g.size - first;
  LooseSeen out;
  Lane world[3], log_scale[3];
  LoadRows3(g.means + 3 * first, available, world);
  LoadRows3(g.log_scales + 3 * first, available, log_scale);
  const Lane logit = LoadRows1(g.opacity_logits + first, available);
  for (int k = 0; k < 3; ++k) {
    world[k] = (world[k] - Lane(task.view.center_high[k])) - Lane(task.view.center_low[k]);
  }
  for (int k = 0; k < 3; ++k) {
    const Lane row[3] = {Lane(task.view.rotation[3 * k]), Lane(task.view.rotation[3 * k + 1]),
                         Lane(task.view.rotation[3 * k + 2])};
    out.mean[k] = Dot3(row, world);
  }
  out.size = SafeExp(Max(log_scale[0], Max(log_scale[1], log_scale[2]))) / Sqrt(Dot3(world, world));
  constexpr double kTwoLn2 = 1.38629436111989061883;
  const Lane log2_opacity = -Log2(Lane(1.0) + SafeExp(-logit));
  const Lane cutoff = Lane(kTwoLn2) * (log2_opacity - Lane(task.log2_alpha_min));
  out.reach = Sqrt(Max(Min(cutoff, Lane(task.max_cutoff)), Lane(0.0)));
  return out;
}

// The bend around the mean; infinite where it is not known.
HWY_INLINE void LoadBend(const Bend* table, const LooseSeen& g, Lane sine, Lane* first,
                         Lane* second, Lane* third) {
  const Lane zero(0.0), one(1.0);
  const Lane ax = Abs(g.mean[0]), ay = Abs(g.mean[1]), az = Abs(g.mean[2]);
  const LaneMask along_x = AndMask(ax >= ay, ax >= az);
  const LaneMask along_y = AndMask(NotMask(along_x), ay >= az);
  const auto pick = [&](Lane x, Lane y, Lane z)
                        HWY_ATTR { return Select(along_x, x, Select(along_y, y, z)); };
  const Lane largest = pick(g.mean[0], g.mean[1], g.mean[2]);
  const Lane face = pick(zero, Lane(2.0), Lane(4.0)) + Select(largest < zero, one, zero);
  const Lane scale = Lane(0.5 * LensBend::kCells) / Abs(largest);
  const auto cell = [&](Lane value) HWY_ATTR {
    const Lane at = Floor(value * scale + Lane(0.5 * LensBend::kCells));
    return Min(Max(at, zero), Lane(LensBend::kCells - 1.0));
  };
  const Lane column = cell(pick(g.mean[1], g.mean[0], g.mean[0]));
  const Lane row = cell(pick(g.mean[2], g.mean[2], g.mean[1]));
  Lane level(0.0);
  for (int k = 0; k + 1 < LensBend::kLevels; ++k) {
    level += Select(sine < Lane(LensBend::kSines[k]), zero, one);
  }
  const LaneMask known = AndMask(sine < Lane(LensBend::kLargestSine), IsFinite(scale));
  const Lane cells(LensBend::kCells);
  const Lane entry = ((level * Lane(LensBend::kFaces) + face) * cells + row) * cells + column;
  const Lane index = Select(known, entry * Lane(3.0), zero);
  const float* numbers = &table->first;
  const Lane infinity(kInfinity);
  *first = Select(known, At<Lane>(numbers, index), infinity);
  *second = Select(known, At<Lane>(numbers, index + one), infinity);
  *third = Select(known, At<Lane>(numbers, index + Lane(2.0)), infinity);
}

void ChooseRange(const FootprintTask& task, const Bend* bend, float limit, std::int64_t first,
                 std::int64_t count, FootprintChoices* choices) {
  const FloatTag d;
  const Lane zero(0.0), one(1.0), most(limit);
  const Lane by_ewa_code(CodeOf(ProjectionMethod::kEwa));
  const Lane by_points_code(CodeOf(ProjectionMethod::kUnscented));
  const Lane silhouette(CodeOf(ProjectionMethod::kSilhouette));
  for (std::int64_t i = 0; i < count; i += kLanes) {
    const LooseSeen g = LoadLoose(task, first + i);
    const Lane sine = g.size * Max(g.reach, Lane(kFullReach));
    // Larger than any cap that is known: nothing to look up.
    if (MaskBits((sine < Lane(LensBend::kLargestSine)).m) == 0) {
      hn::StoreU(zero.v, d, &choices->widths[static_cast<std::size_t>(i)]);
      hn::StoreU(silhouette.v, d, &choices->codes[static_cast<std::size_t>(i)]);
      continue;
    }
    Lane bend_first, bend_second, bend_third;
    LoadBend(bend, g, sine, &bend_first, &bend_second, &bend_third);
    const Lane shrink = g.size / (one - sine);
    const Lane second = bend_second * shrink * shrink;
    const Lane ewa = Lane(0.5) * Max(g.reach * g.reach, Lane(3.0)) * second;
    const Lane center =
        Lane(kCutMoments) * second + Lane(kThirdMoments) * bend_third * shrink * shrink * shrink;
    const Lane box = ewa + (one + Lane(kSigmaReach) * g.reach) * (Lane(1.5) * second);
    const LaneMask by_ewa = ewa <= most;
    const LaneMask by_points =
        AndMask(NotMask(by_ewa),
                AndMask(center <= most, box <= Lane(kLooseBox) * g.reach * g.size * bend_first));
    const std::size_t j = static_cast<std::size_t>(i);
    hn::StoreU(Select(by_ewa, ewa, Select(by_points, box, zero)).v, d, &choices->widths[j]);
    hn::StoreU(Select(by_ewa, by_ewa_code, Select(by_points, by_points_code, silhouette)).v, d,
               &choices->codes[j]);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {
HWY_EXPORT(ChooseRange);

void ChooseFootprints(const FootprintTask& task, const Bend* bend, float limit, std::int64_t first,
                      std::int64_t count, FootprintChoices* choices) {
  constexpr std::size_t kPadding = 16;
  choices->codes.resize(static_cast<std::size_t>(count) + kPadding);
  choices->widths.resize(choices->codes.size());
  HWY_DYNAMIC_DISPATCH(ChooseRange)(task, bend, limit, first, count, choices);
}

}  // namespace gsut
#endif
