// The forward pass of one tile in the order of each pixel's own ray, for any kind of rays.
//
// Nothing is sorted. What a hit lets through of the light behind it is multiplied into the light in
// front of every other hit that lies behind it, pair by pair: for hits i and j of a pixel, at t_i
// and t_j along its ray,
//   front_i *= 1 - alpha_j where t_j < t_i, else front_j *= 1 - alpha_i.
// A lane of a vector is a pixel, so that each pixel has its own order at the price of a comparison
// and two products a pair, and colours stay one a Gaussian.
// Pairs need not be made with what lies far in front. The tile's list is sorted by the least t at
// which any ray may be nearest to the Gaussian (RayOrderKeysKernel): a hit whose t is not above
// that of the next unread Gaussian, at all pixels of the block, is in front of all that is unread.
// It leaves the list of those that wait: its light is known, it is blended, and what it lets
// through multiplies the light in front of all that is read from then on. This is exact: t of the
// hits decides, and bounds decide only how long a hit waits.

#if defined(GSUT_RASTER_RAY_ORDER_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_RAY_ORDER_INL_H_
#undef GSUT_RASTER_RAY_ORDER_INL_H_
#else
#define GSUT_RASTER_RAY_ORDER_INL_H_
#endif

#include <algorithm>
#include <limits>

#include "gsut/projection/seen-inl.h"
#include "gsut/raster/blend_tile-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// By which a key lies below where a ray may be nearest, relative to the distance: t is rounded,
// too.
inline constexpr double kKeyRounding = 1e-5;

inline constexpr float kNever = std::numeric_limits<float>::infinity();

// a x b where the mask is true, else a.
HWY_INLINE FloatVec MulWhere(FloatMask mask, FloatVec a, FloatVec b) {
  return hn::IfThenElse(mask, hn::Mul(a, b), a);
}

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

// A Gaussian that waits at one block of pixels.
struct WaitingHit {
  HWY_ALIGN float t[kLanes];      // in units of the ray; kNever: no hit here
  HWY_ALIGN float rest[kLanes];   // 1 - alpha
  HWY_ALIGN float front[kLanes];  // light that reaches it through what has been read
  float last;                     // the largest t, along a unit ray
  float color[3];
};

// Those that wait at the blocks of a tile.
class WaitingHits {
 public:
  HWY_INLINE void Clear() {
    if (hits_.empty()) hits_.resize(static_cast<std::size_t>(kBlocks) * capacity_);
    for (int& count : counts_) count = 0;
  }
  // Makes room for `more` at a block.
  HWY_INLINE void Reserve(int block, int more) {
    if (HWY_UNLIKELY(counts_[block] + more > capacity_)) Grow();
  }
  HWY_INLINE WaitingHit* Of(int block) {
    return &hits_[static_cast<std::size_t>(block) * static_cast<std::size_t>(capacity_)];
  }
  HWY_INLINE int* CountOf(int block) { return &counts_[block]; }

 private:
  // At first: most blocks have fewer. Odd, so that blocks do not share the sets of a cache.
  static constexpr int kFirstCapacity = 15;

  HWY_NOINLINE void Grow() {
    const int capacity = 2 * capacity_ + 1;
    AlignedVector<WaitingHit> hits(static_cast<std::size_t>(kBlocks) * capacity);
    for (int block = 0; block < kBlocks; ++block) {
      std::copy_n(Of(block), counts_[block], &hits[static_cast<std::size_t>(block) * capacity]);
    }
    hits_.swap(hits);
    capacity_ = capacity;
  }

  int capacity_ = kFirstCapacity;
  int counts_[kBlocks] = {};
  AlignedVector<WaitingHit> hits_;
};

// The pixels of a block while Gaussians are blended into them.
struct BlockPixels {
  FloatVec transmittance, red, green, blue;
  DepthSums depth;
  FloatMask open;

  HWY_INLINE BlockPixels(const RasterTask& task, const Frame& frame, std::size_t o) {
    const FloatTag d;
    transmittance = hn::Load(d, &frame.transmittance[o]);
    red = hn::Load(d, &frame.color[0][o]);
    green = hn::Load(d, &frame.color[1][o]);
    blue = hn::Load(d, &frame.color[2][o]);
    depth = task.with_depth ? LoadDepth(frame, o) : DepthSums::Zero();
    open = hn::Ge(transmittance, hn::Set(d, task.transmittance_min));
  }
  HWY_INLINE void Store(const RasterTask& task, std::size_t o, Frame* frame) const {
    const FloatTag d;
    hn::Store(transmittance, d, &frame->transmittance[o]);
    hn::Store(red, d, &frame->color[0][o]);
    hn::Store(green, d, &frame->color[1][o]);
    hn::Store(blue, d, &frame->color[2][o]);
    if (task.with_depth) StoreDepth(depth, o, frame);
  }
  // Blends a hit whose light is known. It decides by itself whether its pixel had stopped before:
  // light only falls along a ray.
  HWY_INLINE void Blend(const RasterTask& task, FloatVec t, FloatVec rest, FloatVec front,
                        const FloatVec* color) {
    const FloatTag d;
    const FloatVec stop = hn::Set(d, task.transmittance_min), behind = hn::Mul(front, rest);
    FloatMask blends = hn::Ge(front, stop);
    if (HWY_UNLIKELY(task.stop_before)) {
      const FloatMask ends = hn::AndNot(hn::And(blends, hn::Gt(behind, stop)), IsHit(t));
      transmittance = hn::IfThenElse(ends, hn::Neg(hn::Abs(transmittance)), transmittance);
      blends = hn::AndNot(ends, blends);
    }
    // Without a hit rest is 1 and the weight 0.
    const FloatVec weight = hn::IfThenElseZero(blends, hn::Sub(front, behind));
    red = hn::MulAdd(weight, color[0], red);
    green = hn::MulAdd(weight, color[1], green);
    blue = hn::MulAdd(weight, color[2], blue);
    if (HWY_UNLIKELY(task.with_depth)) {
      depth.Add(weight, hn::IfThenElseZero(hn::And(blends, IsHit(t)), t));
    }
    transmittance = MulWhere(blends, transmittance, rest);
  }
  // After some were blended; returns whether all pixels have stopped.
  HWY_INLINE bool Close(const RasterTask& task) {
    const FloatTag d;
    open = hn::And(open, hn::Ge(transmittance, hn::Set(d, task.transmittance_min)));
    return hn::AllFalse(d, open);
  }

 private:
  static HWY_INLINE FloatMask IsHit(FloatVec t) { return hn::Lt(t, hn::Set(FloatTag(), kNever)); }
};

// Multiplies what hits of one group, and those that wait, let through into each other's light.
template <int kJam>
HWY_INLINE void FilterPairs(const FloatVec* t, const FloatVec* rest, FloatVec* front,
                            WaitingHit* waiting, int count) {
  const FloatTag d;
  GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
    GSUT_UNROLL for (int j = i + 1; j < kJam; ++j) {
      const FloatMask j_first = hn::Lt(t[j], t[i]);
      front[i] = MulWhere(j_first, front[i], rest[j]);
      front[j] = MulWhere(hn::Not(j_first), front[j], rest[i]);
    }
  }
  for (int p = 0; p < count; ++p) {
    const FloatVec t_p = hn::Load(d, waiting[p].t), rest_p = hn::Load(d, waiting[p].rest);
    FloatVec front_p = hn::Load(d, waiting[p].front);
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
      const FloatMask i_first = hn::Lt(t[i], t_p);
      front_p = MulWhere(i_first, front_p, rest[i]);
      front[i] = MulWhere(hn::Not(i_first), front[i], rest_p);
    }
    hn::Store(front_p, d, waiting[p].front);
  }
}

// Blends those that wait at a block whose t is nowhere above `bound`.
HWY_INLINE void Release(const RasterTask& task, float bound, WaitingHit* waiting, int* count,
                        BlockPixels* pixels) {
  const FloatTag d;
  for (int p = *count - 1; p >= 0; --p) {
    if (!(waiting[p].last <= bound)) continue;
    const WaitingHit& hit = waiting[p];
    const FloatVec color[3] = {hn::Set(d, hit.color[0]), hn::Set(d, hit.color[1]),
                               hn::Set(d, hit.color[2])};
    pixels->Blend(task, hn::Load(d, hit.t), hn::Load(d, hit.rest), hn::Load(d, hit.front), color);
    if (p != --*count) waiting[p] = waiting[*count];
  }
}

// Reads the Gaussians of a chunk whose bits are set in `todo` at the block at pixel o. bounds[j]:
// of Gaussian j; beyond: of what follows the chunk. Returns whether the block's pixels have
// stopped.
template <class Kernel>
HWY_INLINE bool BlendBlockAlongRays(const RasterTask& task, const TileGrid& grid,
                                    const Kernel& kernel, std::uint64_t todo, int block,
                                    std::size_t o, const float* bounds, float beyond, Frame* frame,
                                    WaitingHits* hits) {
  constexpr int kJam = Kernel::kJam;
  const FloatTag d;
  const FloatVec alpha_limit = hn::Set(d, task.alpha_max);
  const FloatVec length = hn::Load(d, &grid.length[o]);
  const auto rays = kernel.LoadPixels(o);
  BlockPixels pixels(task, *frame, o);
  int* const count = hits->CountOf(block);
  bool all_closed = false;
  while (todo != 0 && !all_closed) {
    int index[kJam];
    FloatVec alpha[kJam], t[kJam], rest[kJam], front[kJam];
    FloatMask hit[kJam];
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
      index[i] = todo != 0 ? __builtin_ctzll(todo) : kMissing;
      todo &= todo - 1;
    }
    kernel.Respond(rays, index, pixels.open, alpha_limit, alpha, t, hit);
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
      t[i] = hn::IfThenElse(hit[i], t[i], hn::Set(d, kNever));
      rest[i] = hn::Sub(hn::Set(d, 1.0f), alpha[i]);
      front[i] = pixels.transmittance;
    }
    hits->Reserve(block, kJam);
    WaitingHit* const waiting = hits->Of(block);
    FilterPairs<kJam>(t, rest, front, waiting, *count);
    const float bound = todo != 0 ? bounds[__builtin_ctzll(todo)] : beyond;
    Release(task, bound, waiting, count, &pixels);
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
      const FloatVec color[3] = {kernel.Color(0, index[i]), kernel.Color(1, index[i]),
                                 kernel.Color(2, index[i])};
      const FloatVec along = hn::IfThenElseZero(hit[i], hn::Mul(t[i], length));
      if (HWY_LIKELY(hn::AllTrue(d, hn::Le(along, hn::Set(d, bound))))) {
        pixels.Blend(task, t[i], rest[i], front[i], color);
      } else if (!hn::AllFalse(d, hit[i])) {
        WaitingHit& added = waiting[(*count)++];
        hn::Store(t[i], d, added.t);
        hn::Store(rest[i], d, added.rest);
        hn::Store(front[i], d, added.front);
        added.last = hn::GetLane(hn::MaxOfLanes(d, along));
        for (int c = 0; c < 3; ++c) added.color[c] = hn::GetLane(color[c]);
      }
    }
    all_closed = pixels.Close(task);
  }
  // What waits and is blended is in front of all that is unread, or its pixel has stopped.
  if (all_closed) Release(task, kNever, hits->Of(block), count, &pixels);
  pixels.Store(task, o, frame);
  return all_closed;
}

// Returns the calling thread's list. Inlined, its address would be looked up again in every loop.
inline HWY_NOINLINE WaitingHits* HitsOfThread() {
  thread_local WaitingHits hits;
  return &hits;
}

// Blends all Gaussians of a tile. closest: bounds are along rays that may start this much nearer.
template <class Kernel>
HWY_INLINE void BlendTileAlongRays(const RasterTask& task, const TileGrid& grid, int tile,
                                   float closest, Kernel& kernel, Frame* frame) {
  WaitingHits* const hits = HitsOfThread();
  hits->Clear();
  const std::size_t pixel0 = static_cast<std::size_t>(tile) * kTilePixels;
  ClearTile(task.with_depth, grid, pixel0, frame);
  const std::uint32_t begin = frame->tile_begin[tile];
  const std::uint32_t end = frame->tile_begin[tile + 1];
  std::uint64_t alive = frame->alive[tile];
  std::uint64_t gaussians_of[kBlocks];
  float bounds[kChunk + 1];
  const auto bound_of = [&](std::uint32_t pair) HWY_ATTR {
    return pair < end ? frame->order_key[frame->pairs[pair].gaussian] - closest : kNever;
  };
  for (std::uint32_t chunk = begin; chunk < end && alive != 0; chunk += kChunk) {
    const TilePair* pairs = &frame->pairs[chunk];
    const int available = static_cast<int>(end - chunk);
    const int count = HWY_MIN(available, kChunk);
    std::uint64_t blocks_of[kChunk] = {};
    kernel.Fill(pairs, count, available, blocks_of);
    for (int j = 0; j < count; ++j) blocks_of[j] &= alive;
    for (int j = 0; j <= count; ++j) bounds[j] = bound_of(chunk + static_cast<std::uint32_t>(j));
    TransposeMasks(blocks_of, gaussians_of);
    for (std::uint64_t rest = alive; rest != 0; rest &= rest - 1) {
      const int block = __builtin_ctzll(rest);
      if (gaussians_of[block] == 0) continue;
      const std::size_t o = pixel0 + static_cast<std::size_t>(block) * kLanes;
      if (BlendBlockAlongRays(task, grid, kernel, gaussians_of[block], block, o, bounds,
                              bounds[count], frame, hits)) {
        alive &= ~(std::uint64_t{1} << block);
      }
    }
  }
  for (std::uint64_t rest = alive; rest != 0; rest &= rest - 1) {
    const int block = __builtin_ctzll(rest);
    if (*hits->CountOf(block) == 0) continue;
    const std::size_t o = pixel0 + static_cast<std::size_t>(block) * kLanes;
    BlockPixels pixels(task, *frame, o);
    Release(task, kNever, hits->Of(block), hits->CountOf(block), &pixels);
    pixels.Store(task, o, frame);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
