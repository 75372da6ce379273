// Order keys of a frame that is blended in the order of each pixel's own ray: the least distance at
// which any ray may be nearest to a Gaussian.

#if defined(GSUT_RASTER_RAY_ORDER_KEYS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_RAY_ORDER_KEYS_INL_H_
#undef GSUT_RASTER_RAY_ORDER_KEYS_INL_H_
#else
#define GSUT_RASTER_RAY_ORDER_KEYS_INL_H_
#endif

#include "gsut/projection/seen-inl.h"
#include "gsut/raster/frame.h"
#include "gsut/raster/task.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// By which a key lies below where a ray may be nearest, relative to the distance: t is rounded,
// too.
inline constexpr double kKeyRounding = 1e-5;

// How a Gaussian spreads along a direction n: n'Sn of its covariance S, and 1 / n'S^-1 n.
struct Spread {
  Lane variance, least;

  HWY_INLINE Spread(const SeenLanes& g, const Lane* n) {
    Lane squares(0.0), inverse(0.0);
    for (int k = 0; k < 3; ++k) {
      const Lane along = Dot3(g.axes[k], n);
      const Lane scaled = g.scale[k] * along, whitened = along / g.scale[k];
      squares += scaled * scaled;
      inverse += whitened * whitened;
    }
    variance = squares;
    least = Lane(1.0) / inverse;
  }
};

// Writes the order keys of the Gaussians [begin, end), begin a multiple of 16: key_of each, which
// are at most where any ray may be nearest to it.
template <class KeyOf>
HWY_INLINE void WriteKeys(const RasterTask& task, std::int64_t begin, std::int64_t end,
                          Frame* frame, KeyOf&& key_of) {
  for (std::int64_t i = begin; i < end; i += kLanes) {
    const SeenLanes g = LoadSeen(task.gaussians, i, task.view, task.log2_raw_min, task.max_cutoff);
    const Lane key = key_of(g) - Lane(kKeyRounding) * g.distance;
    hn::StoreU(key.v, FloatTag(), &frame->order_key[static_cast<std::size_t>(i)]);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
