// Hits of the Gaussians that were read at the blocks of a tile and are not blended yet, and which
// of them are next, for the order of each pixel's own ray (ray_order-inl.h).

#if defined(GSUT_RASTER_RAY_ORDER_HITS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_RAY_ORDER_HITS_INL_H_
#undef GSUT_RASTER_RAY_ORDER_HITS_INL_H_
#else
#define GSUT_RASTER_RAY_ORDER_HITS_INL_H_
#endif

#include <algorithm>
#include <limits>

#include "gsut/base/aligned_vector.h"
#include "gsut/raster/tile_math-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

inline constexpr float kNever = std::numeric_limits<float>::infinity();

// The hits of one Gaussian at a block of pixels.
struct BlockHit {
  HWY_ALIGN float t[kLanes];      // in units of the ray; kNever: no hit here
  HWY_ALIGN float rest[kLanes];   // 1 - alpha
  HWY_ALIGN float front[kLanes];  // of an open one: light that reaches it through what was swept
  float last;                     // the largest t, along a unit ray
  float color[3];
};

// Those of a block that are not blended yet: copied, so that counts stay in registers while the
// arrays are written.
struct BlockHits {
  BlockHit* slots;
  float* first;  // by slot: the least t, along a unit ray, of one that waits to be swept; or kNever
  int* open;     // slots of the open ones
  float* last;   // `last` of each
  int* free;     // slots that are free again
  int top, num_open, num_free;  // no slot from `top` on was ever taken

  HWY_INLINE int Take() { return num_free > 0 ? free[--num_free] : top++; }
  HWY_INLINE void GiveBackIf(bool is_free, int slot) {
    free[num_free] = slot;
    num_free += is_free;
  }
  HWY_INLINE void OpenIf(bool opens, int slot, float last_of_slot) {
    open[num_open] = slot;
    last[num_open] = last_of_slot;
    num_open += opens;
  }
};

// The memory of a block's.
class HitMemory {
 public:
  BlockHits hits = {};

  HWY_INLINE void Clear() { hits.top = hits.num_open = hits.num_free = 0; }
  HWY_INLINE void Reserve(int more) {
    const std::size_t needed = static_cast<std::size_t>(hits.top + more + kLanes);
    if (HWY_UNLIKELY(needed > slots_.size())) Grow(2 * needed);
  }

 private:
  HWY_NOINLINE void Grow(std::size_t size) {
    const auto grow = [&](auto* array, auto** begin) {
      array->resize(size);
      *begin = array->data();
    };
    grow(&slots_, &hits.slots);
    grow(&first_, &hits.first);
    grow(&open_, &hits.open);
    grow(&last_, &hits.last);
    grow(&free_, &hits.free);
  }

  AlignedVector<BlockHit> slots_;
  AlignedVector<float> first_, last_;
  AlignedVector<int> open_, free_;
};

// A hit that is swept next: the bits of its least t, then its slot.
using SweptHit = std::uint64_t;

// Those of a tile.
struct TileHits {
  HitMemory blocks[kBlocks];
  AlignedVector<SweptHit> swept;
};

// Returns the calling thread's. Inlined, its address would be looked up again in every loop.
inline HWY_NOINLINE TileHits* HitsOfThread() {
  thread_local TileHits hits;
  return &hits;
}

// Sorts hits that are swept next. Each of few counts those before it, which takes no branch.
HWY_INLINE void SortSwept(SweptHit* swept, int count) {
  constexpr int kFew = 128;
  if (HWY_UNLIKELY(count > kFew)) {
    std::sort(swept, swept + count);
    return;
  }
  const hn::RebindToSigned<FloatTag> d;
  HWY_ALIGN std::int32_t keys[kFew + kLanes];
  SweptHit unsorted[kFew];
  // Positive floats are ordered as whole numbers are. The last bits make all different; without
  // them a near end lies a little nearer.
  for (int i = 0; i < count; ++i) {
    unsorted[i] = swept[i] & ~(SweptHit{kFew - 1} << 32);
    keys[i] = static_cast<std::int32_t>(unsorted[i] >> 32) | i;
  }
  for (int i = count; i % kLanes != 0; ++i) keys[i] = std::numeric_limits<std::int32_t>::max();
  for (int i = 0; i < count; ++i) {
    const auto key = hn::Set(d, keys[i]);
    std::size_t before = 0;
    for (int j = 0; j < count; j += kLanes) {
      before += hn::CountTrue(d, hn::Lt(hn::Load(d, keys + j), key));
    }
    swept[before] = unsorted[i];
  }
}

// Takes the waiting hits whose least t is at most `unread` into `swept`, nearest first; returns
// their number.
HWY_INLINE int TakeSwept(float unread, BlockHits* hits, AlignedVector<SweptHit>* swept) {
  const FloatTag d;
  const FloatVec most = hn::Set(d, HWY_MIN(unread, std::numeric_limits<float>::max()));
  const std::size_t most_hits = static_cast<std::size_t>(hits->top);
  if (HWY_UNLIKELY(swept->size() < most_hits)) swept->resize(2 * most_hits);
  SweptHit* const to = swept->data();
  float* const first = hits->first;
  int count = 0;
  for (int base = 0; base < hits->top; base += kLanes) {
    std::uint64_t bits = MaskBits(hn::Le(hn::Load(d, first + base), most));
    for (; bits != 0; bits &= bits - 1) {
      const int slot = base + __builtin_ctzll(bits);
      if (slot >= hits->top) break;
      std::uint32_t key;
      __builtin_memcpy(&key, first + slot, sizeof(key));
      to[count++] = SweptHit{key} << 32 | static_cast<SweptHit>(slot);
      first[slot] = kNever;
    }
  }
  SortSwept(to, count);
  return count;
}

HWY_INLINE int SlotOf(SweptHit hit) { return static_cast<int>(hit & 0xffffffffu); }

HWY_INLINE float FirstOf(SweptHit hit) {
  const std::uint32_t bits = static_cast<std::uint32_t>(hit >> 32);
  float first;
  __builtin_memcpy(&first, &bits, sizeof(first));
  return first;
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
