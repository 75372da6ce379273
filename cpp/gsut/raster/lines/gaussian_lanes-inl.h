// Gaussians of lines from their records, one a lane or one in all.

#if defined(GSUT_RASTER_LINES_GAUSSIAN_LANES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_LINES_GAUSSIAN_LANES_INL_H_
#undef GSUT_RASTER_LINES_GAUSSIAN_LANES_INL_H_
#else
#define GSUT_RASTER_LINES_GAUSSIAN_LANES_INL_H_
#endif

#include "gsut/base/lanes-inl.h"
#include "gsut/projection/seen-inl.h"
#include "gsut/raster/task.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Layout of a record where lines have no common origin; 16 floats as `record`.
namespace line_record {
inline constexpr int kMean = 0;    // 3 floats, reference frame
inline constexpr int kWhiten = 3;  // M by rows: 9 floats
inline constexpr int kLog2Strength = 12;
inline constexpr int kColor = 13;  // 3 floats
}  // namespace line_record

struct GaussianLanes {
  Lane mean[3], whiten[3][3];
  Lane variance[3];     // along its axes
  Lane inverse_volume;  // 1 / (s1 s2 s3), as the norms of M's rows
  Lane log2_strength, cutoff, k, inverse_k;
};

// load(k): float k of the records.
template <class Load>
HWY_INLINE GaussianLanes LoadGaussians(const RasterTask& task, Load&& load) {
  GaussianLanes g;
  g.inverse_volume = Lane(1.0);
  for (int k = 0; k < 3; ++k) {
    g.mean[k] = load(line_record::kMean + k);
    for (int j = 0; j < 3; ++j) g.whiten[k][j] = load(line_record::kWhiten + 3 * k + j);
    const Lane square = Dot3(g.whiten[k], g.whiten[k]);
    g.variance[k] = Lane(1.0) / square;
    g.inverse_volume *= Sqrt(square);
  }
  g.log2_strength = load(line_record::kLog2Strength);
  constexpr double kTwoLn2 = 1.38629436111989061883;
  g.cutoff =
      Min(Lane(kTwoLn2) * (g.log2_strength - Lane(task.log2_raw_min)), Lane(task.max_cutoff));
  if (HWY_UNLIKELY(IsFlat(task.gaussians.primitive))) g.cutoff = TriangleCutoff(g.cutoff);
  g.k = Sqrt(g.cutoff);
  g.inverse_k = Lane(1.0) / g.k;
  return g;
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
