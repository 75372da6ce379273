// The forward pass of one tile in the order of each pixel's own ray.
//
// What a hit lets through of the light behind it is multiplied into the light in front of every
// other hit that lies behind it, pair by pair: for hits i and j of a pixel, at t_i and t_j along
// its ray,
//   front_i *= 1 - alpha_j where t_j < t_i, else front_j *= 1 - alpha_i.
// A lane of a vector is a pixel, so that each pixel has its own order at the price of a comparison
// and two products a pair, and colours stay one a Gaussian.
// Pairs are made only where the order may differ from pixel to pixel. The hits of a Gaussian at a
// block of pixels span an interval of t. They are swept by the near end of it (SweepHits): one
// whose far end is not beyond the near end of the next is in front of all that follow, at every
// pixel. Its light is known, it is blended, and what it lets through multiplies the light in front
// of all that is swept from then on; until then it is open. The tile's list is sorted by the least
// t at which any ray may be nearest to a Gaussian (LineRayOrderKeysKernel), which bounds what is
// not read yet: hits beyond that wait, which costs nothing. This is exact: t of the hits decides,
// and intervals and bounds decide only which pairs are made.

#if defined(GSUT_RASTER_RAY_ORDER_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_RAY_ORDER_INL_H_
#undef GSUT_RASTER_RAY_ORDER_INL_H_
#else
#define GSUT_RASTER_RAY_ORDER_INL_H_
#endif

#include "gsut/raster/blend_tile-inl.h"
#include "gsut/raster/ray_order_hits-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// a x b where the mask is true, else a.
HWY_INLINE FloatVec MulWhere(FloatMask mask, FloatVec a, FloatVec b) {
  return hn::IfThenElse(mask, hn::Mul(a, b), a);
}

// The least lane of each of kCount vectors, a multiple of 4.
template <int kCount>
HWY_INLINE void LeastOfEach(const FloatVec* v, float* least) {
  const FloatTag d;
  const hn::Repartition<double, FloatTag> dd;
  const auto of_pairs = [&](FloatVec x, FloatVec y) HWY_ATTR {
    return hn::Min(hn::OddEven(y, x), hn::Shuffle2301(hn::OddEven(x, y)));
  };
  GSUT_UNROLL for (int i = 0; i < kCount; i += 4) {
    const auto x = hn::BitCast(dd, of_pairs(v[i], v[i + 1]));
    const auto y = hn::BitCast(dd, of_pairs(v[i + 2], v[i + 3]));
    FloatVec w = hn::Min(hn::BitCast(d, hn::OddEven(y, x)),
                         hn::BitCast(d, hn::Shuffle01(hn::OddEven(x, y))));
    if constexpr (kLanes >= 8) w = hn::Min(w, hn::SwapAdjacentBlocks(w));
#if HWY_MAX_BYTES == 64
    w = hn::Min(w, hn::ConcatLowerUpper(d, w, w));
#endif
    HWY_ALIGN float lanes[kLanes];
    hn::Store(w, d, lanes);
    __builtin_memcpy(least + i, lanes, 4 * sizeof(float));
  }
}

// The pixels of a block while Gaussians are blended into them. kLightAlone: colours and depth stay
// as an earlier blend left them.
template <bool kLightAlone>
struct BlockPixels {
  FloatVec transmittance, red, green, blue;
  DepthSums depth;
  FloatVec stop;   // least light that shows
  FloatMask open;  // has not stopped

  HWY_INLINE BlockPixels(const RasterTask& task, const Frame& frame, std::size_t o) {
    const FloatTag d;
    transmittance = hn::Load(d, &frame.transmittance[o]);
    stop = hn::Set(d, task.transmittance_min);
    open = hn::Ge(transmittance, stop);
    if constexpr (kLightAlone) return;
    red = hn::Load(d, &frame.color[0][o]);
    green = hn::Load(d, &frame.color[1][o]);
    blue = hn::Load(d, &frame.color[2][o]);
    depth = task.with_depth ? LoadDepth(frame, o) : DepthSums::Zero();
  }
  HWY_INLINE void Store(const RasterTask& task, std::size_t o, Frame* frame) const {
    const FloatTag d;
    hn::Store(transmittance, d, &frame->transmittance[o]);
    if constexpr (kLightAlone) return;
    hn::Store(red, d, &frame->color[0][o]);
    hn::Store(green, d, &frame->color[1][o]);
    hn::Store(blue, d, &frame->color[2][o]);
    if (task.with_depth) StoreDepth(depth, o, frame);
  }
  // Blends a hit whose light is known. It decides by itself whether its pixel had stopped before:
  // light only falls along a ray.
  HWY_INLINE void Blend(const RasterTask& task, const BlockHit& hit, FloatVec t, FloatVec rest,
                        FloatVec front) {
    const FloatTag d;
    const FloatVec behind = hn::Mul(front, rest);
    FloatMask blends = hn::Ge(front, stop);
    if (HWY_UNLIKELY(task.stop_before)) {
      const FloatMask ends = hn::AndNot(hn::And(blends, hn::Gt(behind, stop)), IsHit(t));
      transmittance = hn::IfThenElse(ends, hn::Neg(hn::Abs(transmittance)), transmittance);
      blends = hn::AndNot(ends, blends);
    }
    transmittance = MulWhere(blends, transmittance, rest);
    if constexpr (kLightAlone) return;
    // Without a hit rest is 1 and the weight 0.
    const FloatVec weight = hn::IfThenElseZero(blends, hn::Sub(front, behind));
    red = hn::MulAdd(weight, hn::Set(d, hit.color[0]), red);
    green = hn::MulAdd(weight, hn::Set(d, hit.color[1]), green);
    blue = hn::MulAdd(weight, hn::Set(d, hit.color[2]), blue);
    if (HWY_UNLIKELY(task.with_depth)) {
      depth.Add(weight, hn::IfThenElseZero(hn::And(blends, IsHit(t)), t));
    }
  }
  HWY_INLINE bool AreClosed() const {
    return hn::AllFalse(FloatTag(), hn::And(open, hn::Ge(transmittance, stop)));
  }

 private:
  static HWY_INLINE FloatMask IsHit(FloatVec t) { return hn::Lt(t, hn::Set(FloatTag(), kNever)); }
};

// What a forward pass notes of its hits: nothing. The backward pass has RayNotes.
struct NoNotes {
  static constexpr bool kTakes = false;
};

// Multiplies what hits of one group, and the open ones, let through into each other's light.
template <int kJam>
HWY_INLINE void FilterPairs(const FloatVec* t, const FloatVec* rest, FloatVec* front,
                            BlockHits* hits) {
  const FloatTag d;
  GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
    GSUT_UNROLL for (int j = i + 1; j < kJam; ++j) {
      const FloatMask j_first = hn::Lt(t[j], t[i]);
      front[i] = MulWhere(j_first, front[i], rest[j]);
      front[j] = MulWhere(hn::Not(j_first), front[j], rest[i]);
    }
  }
  const int* const open = hits->open;
  BlockHit* const slots = hits->slots;
  for (int p = 0; p < hits->num_open; ++p) {
    BlockHit& other = slots[open[p]];
    const FloatVec t_p = hn::Load(d, other.t), rest_p = hn::Load(d, other.rest);
    FloatVec front_p = hn::Load(d, other.front);
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
      const FloatMask i_first = hn::Lt(t[i], t_p);
      front_p = MulWhere(i_first, front_p, rest[i]);
      front[i] = MulWhere(hn::Not(i_first), front[i], rest_p);
    }
    hn::Store(front_p, d, other.front);
  }
}

// Blends the open ones whose t is nowhere above `bound`.
template <class Pixels, class Notes>
HWY_INLINE void Release(const RasterTask& task, float bound, BlockHits* hits, Pixels* pixels,
                        Notes* notes) {
  const FloatTag d;
  int* const open = hits->open;
  float* const last = hits->last;
  const BlockHit* const slots = hits->slots;
  int count = hits->num_open;
  for (int base = (count - 1) / kLanes * kLanes; base >= 0; base -= kLanes) {
    const FloatMask there = hn::FirstN(d, static_cast<std::size_t>(count - base));
    std::uint64_t bits =
        MaskBits(hn::And(there, hn::Le(hn::Load(d, last + base), hn::Set(d, bound))));
    for (int p = base; bits != 0; bits &= ~(std::uint64_t{1} << (p - base))) {
      p = base + 63 - __builtin_clzll(bits);
      const BlockHit& hit = slots[open[p]];
      if constexpr (Notes::kTakes) notes->ResolveHit(slots, open[p], open, count);
      pixels->Blend(task, hit, hn::Load(d, hit.t), hn::Load(d, hit.rest), hn::Load(d, hit.front));
      hits->GiveBackIf(true, open[p]);
      --count;
      open[p] = open[count];
      last[p] = last[count];
    }
  }
  hits->num_open = count;
}

// Blends a hit that was swept, with nothing before `bound` left to sweep, or leaves it open.
template <class Pixels>
HWY_INLINE void BlendOrOpen(const RasterTask& task, float bound, int slot, FloatVec t,
                            FloatVec rest, FloatVec front, BlockHits* hits, Pixels* pixels) {
  const FloatTag d;
  BlockHit& hit = hits->slots[slot];
  // Both, for a branch would be mispredicted: what stays open is blended as no hit.
  const FloatMask leaves = hn::Le(hn::Set(d, hit.last), hn::Set(d, bound));
  pixels->Blend(task, hit, hn::IfThenElse(leaves, t, hn::Set(d, kNever)),
                hn::IfThenElse(leaves, rest, hn::Set(d, 1.0f)), front);
  hn::Store(front, d, hit.front);
  hits->OpenIf(!(hit.last <= bound), slot, hit.last);
  hits->GiveBackIf(hit.last <= bound, slot);
}

// Reads the Gaussians of a kernel's chunk whose bits are set in todo at the block at pixel o.
template <class Kernel, class Notes>
HWY_INLINE void ReadHits(const RasterTask& task, const Kernel& kernel, std::uint64_t todo,
                         std::size_t o, FloatVec length, FloatMask open, BlockHits* hits,
                         Notes* notes) {
  constexpr int kJam = Kernel::kJam;
  const FloatTag d;
  const FloatVec alpha_limit = hn::Set(d, task.alpha_max), never = hn::Set(d, kNever);
  const auto rays = kernel.LoadPixels(o);
  float* const first = hits->first;
  BlockHit* const slots = hits->slots;
  while (todo != 0) {
    int index[kJam];
    FloatVec alpha[kJam], t[kJam], ends[2 * kJam];
    FloatMask hit[kJam];
    float least[2 * kJam];  // of t, and of -t
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
      index[i] = todo != 0 ? __builtin_ctzll(todo) : kMissing;
      todo &= todo - 1;
    }
    kernel.Respond(rays, index, open, alpha_limit, alpha, t, hit);
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
      const FloatVec along = hn::Mul(t[i], length);
      ends[i] = hn::IfThenElse(hit[i], along, never);
      ends[kJam + i] = hn::IfThenElseZero(hit[i], hn::Neg(along));
    }
    LeastOfEach<2 * kJam>(ends, least);
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
      if (hn::AllFalse(d, hit[i])) continue;
      const int slot = hits->Take();
      if constexpr (Notes::kTakes) notes->NoteGaussian(slot, index[i]);
      BlockHit& added = slots[slot];
      hn::Store(hn::IfThenElse(hit[i], t[i], never), d, added.t);
      hn::Store(hn::Sub(hn::Set(d, 1.0f), alpha[i]), d, added.rest);
      first[slot] = least[i];
      added.last = -least[kJam + i];
      for (int c = 0; c < 3; ++c) added.color[c] = hn::GetLane(kernel.Color(c, index[i]));
    }
  }
}

// Hits swept together: more share the loads of open ones, and open later.
inline constexpr int kSweepJam = kLanes >= 16 ? 6 : 4;

// Sweeps the hits of a block that are not beyond what is unread. Returns whether nothing shows from
// there on.
template <int kJam, class Pixels, class Notes>
HWY_INLINE bool SweepHits(const RasterTask& task, float unread, BlockHits* hits,
                          AlignedVector<SweptHit>* swept, Pixels* pixels, Notes* notes) {
  const FloatTag d;
  const int end = TakeSwept(unread, hits, swept);
  const SweptHit* const next = swept->data();
  const BlockHit* const slots = hits->slots;
  float bound = end > 0 ? FirstOf(next[0]) : unread;
  Release(task, bound, hits, pixels, notes);
  bool closed = pixels->AreClosed();
  for (int k = 0; k < end && !closed; k += kJam) {
    FloatVec t[kJam], rest[kJam], front[kJam];
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
      t[i] = hn::Set(d, kNever);
      rest[i] = hn::Set(d, 1.0f);
      front[i] = pixels->transmittance;
      if (k + i < end) {
        t[i] = hn::Load(d, slots[SlotOf(next[k + i])].t);
        rest[i] = hn::Load(d, slots[SlotOf(next[k + i])].rest);
      }
    }
    FilterPairs<kJam>(t, rest, front, hits);
    if constexpr (Notes::kTakes) {
      notes->StartGroup(hits->slots, next + k, HWY_MIN(end - k, kJam), front);
    }
    bound = k + kJam < end ? FirstOf(next[k + kJam]) : unread;
    Release(task, bound, hits, pixels, notes);
    if constexpr (Notes::kTakes) {
      notes->FinishGroup(hits->slots, bound, hits->open, hits->num_open);
    }
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
      if (k + i >= end) break;
      BlendOrOpen(task, bound, SlotOf(next[k + i]), t[i], rest[i], front[i], hits, pixels);
    }
    closed = pixels->AreClosed();
  }
  // What is open is in front of all that is not swept, or its pixel has stopped.
  if (closed) Release(task, kNever, hits, pixels, notes);
  return closed;
}

// Blends all Gaussians of a tile. closest: bounds are along rays that may start this much nearer.
// notes: NoNotes or RayNotes.
template <class Kernel, class Notes>
HWY_INLINE void BlendTileAlongRays(const RasterTask& task, const TileGrid& grid, int tile,
                                   float closest, Kernel& kernel, Frame* frame, Notes* notes) {
  const FloatTag d;
  TileHits* const hits = HitsOfThread();
  for (HitMemory& each : hits->blocks) each.Clear();
  const std::size_t pixel0 = static_cast<std::size_t>(tile) * kTilePixels;
  if constexpr (Notes::kTakes) {
    ClearLight(grid, pixel0, frame);
  } else {
    ClearTile(task.with_depth, grid, pixel0, frame);
  }
  const std::uint32_t begin = frame->tile_begin[tile];
  const std::uint32_t end = frame->tile_begin[tile + 1];
  std::uint64_t alive = frame->alive[tile];
  std::uint64_t blocks_of[kChunk], gaussians_of[kBlocks];
  const auto bound_of = [&](std::uint32_t pair) HWY_ATTR {
    return pair < end ? frame->order_key[frame->pairs[pair].gaussian] - closest : kNever;
  };
  for (std::uint32_t chunk = begin; chunk < end && alive != 0; chunk += kChunk) {
    const int available = static_cast<int>(end - chunk);
    const int count = HWY_MIN(available, kChunk);
    kernel.Fill(&frame->pairs[chunk], count, available, blocks_of);
    for (int j = 0; j < count; ++j) blocks_of[j] &= alive;
    for (int j = count; j < kChunk; ++j) blocks_of[j] = 0;
    TransposeMasks(blocks_of, gaussians_of);
    const float unread = bound_of(chunk + kChunk);
    for (std::uint64_t rest = alive; rest != 0; rest &= rest - 1) {
      const int block = __builtin_ctzll(rest);
      const std::size_t o = pixel0 + static_cast<std::size_t>(block) * kLanes;
      const FloatVec length = hn::Load(d, &grid.length[o]);
      BlockPixels<Notes::kTakes> pixels(task, *frame, o);
      HitMemory* const memory = &hits->blocks[block];
      memory->Reserve(kChunk);
      BlockHits of_block = memory->hits;
      if constexpr (Notes::kTakes) notes->MoveToBlock(block, chunk - begin);
      ReadHits(task, kernel, gaussians_of[block], o, length, pixels.open, &of_block, notes);
      if (SweepHits<kSweepJam>(task, unread, &of_block, &hits->swept, &pixels, notes)) {
        alive &= ~(std::uint64_t{1} << block);
      }
      memory->hits = of_block;
      pixels.Store(task, o, frame);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
