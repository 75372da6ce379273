// What the backward pass of one tile needs of a blend in the order of each pixel's own ray.
//
// blend_backward-inl.h walks a tile's Gaussians in one order and carries T_i and B_i along. Here
// each pixel has an order of its own, so the blend is made a second time (ray_order-inl.h) and
// leaves both for each Gaussian and block: T_i is the light in front of the hit, and B_(i-1), what
// it and all behind it are worth to L, is the whole less what is in front of it,
//   B_(i-1) = B_0 - sum over j in front of i of w_j v_j.
// The sum has two parts. Hits that were settled (blended) before i was swept are in front of it at
// all pixels; their sum is one a block. For two hits that are live at the same time, the one in
// front at a pixel passes its w v on to the other when the first of the two is settled: by then the
// light in front of both is known where it counts, as nothing unswept is nearer.

#if defined(GSUT_RASTER_RAY_ORDER_BACKWARD_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_RAY_ORDER_BACKWARD_INL_H_
#undef GSUT_RASTER_RAY_ORDER_BACKWARD_INL_H_
#else
#define GSUT_RASTER_RAY_ORDER_BACKWARD_INL_H_
#endif

#include "gsut/raster/blend_backward-inl.h"
#include "gsut/raster/ray_order-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// The memory of a thread's notes, kept from tile to tile.
struct NotesMemory {
  struct OfSlot {
    HWY_ALIGN float passed[kLanes];  // sum of w_j v_j of what is known to be in front
    std::uint32_t pair, turn;        // of the tile's list; when it was swept
  };
  AlignedVector<OfSlot> slots[kBlocks];
  HWY_ALIGN float settled[kBlocks][kLanes];  // sum of w_j v_j of all that is settled
  AlignedVector<float> rows;                 // of each settled hit: T_i and B_(i-1)
  AlignedVector<std::uint32_t> row_of;       // (pairs, kBlocks)
  AlignedVector<std::uint64_t> blocks_of;    // (pairs) where there is a row
};

// Returns the calling thread's.
inline HWY_NOINLINE NotesMemory* NotesOfThread() {
  thread_local NotesMemory memory;
  return &memory;
}

// Takes T_i and B_(i-1) of each Gaussian at each block while a tile is blended.
// kNumFields: of the tile's fields, which StartBlock has filled.
template <int kNumFields>
class RayNotes {
 public:
  static constexpr bool kTakes = true;

  HWY_INLINE RayNotes(const RasterTask& task, std::uint32_t pairs, TileFields<kNumFields>* fields)
      : stop_(task.transmittance_min),
        stop_before_(task.stop_before),
        fields_(fields),
        memory_(NotesOfThread()) {
    memory_->row_of.resize(std::size_t{pairs} * kBlocks);
    memory_->blocks_of.assign(pairs, 0);
    for (int block = 0; block < kBlocks; ++block) {
      hn::Store(hn::Zero(FloatTag()), FloatTag(), memory_->settled[block]);
    }
  }

  // Goes on at another block, where pairs from first_pair on are read.
  HWY_INLINE void Turn(int block, std::uint32_t first_pair) {
    block_ = block;
    first_pair_ = first_pair;
    group_ = group_end_ = nullptr;
  }
  // Names the Gaussian of a hit that was read.
  HWY_INLINE void Name(int slot, int index) {
    auto& slots = memory_->slots[block_];
    const auto i = static_cast<std::size_t>(slot);
    if (HWY_UNLIKELY(i >= slots.size())) slots.resize(2 * i + kChunk);
    slots[i].pair = first_pair_ + static_cast<std::uint32_t>(index);
  }
  // Begins with hits that are swept together, in front of all of which is what is settled.
  HWY_INLINE void EnterGroup(BlockHit* hits, const SweptHit* begin, int count,
                             const FloatVec* front) {
    const FloatTag d;
    group_ = begin;
    group_end_ = begin + count;
    for (int i = 0; i < count; ++i) {
      auto& noted = memory_->slots[block_][static_cast<std::size_t>(SlotOf(begin[i]))];
      hn::Store(front[i], d, hits[SlotOf(begin[i])].front);
      hn::Store(hn::Load(d, memory_->settled[block_]), d, noted.passed);
      noted.turn = turn_++;
    }
  }
  // The group's next hit is settled or opened.
  HWY_INLINE void LeaveGroup() { ++group_; }
  // Settles a hit: trades with the open ones and the rest of the group, and writes its row.
  HWY_INLINE void Settle(const BlockHit* hits, int slot, const int* open, int num_open) {
    const FloatTag d;
    auto& noted = memory_->slots[block_][static_cast<std::size_t>(slot)];
    const FloatVec worth = WorthOf(hits[slot]);
    FloatVec passed = hn::Load(d, noted.passed);
    const FloatVec t = hn::Load(d, hits[slot].t);
    const auto trade = [&](int other) HWY_ATTR {
      auto& live = memory_->slots[block_][static_cast<std::size_t>(other)];
      const FloatVec t_other = hn::Load(d, hits[other].t);
      // Of two at the same place the one that was swept first is in front.
      const FloatMask is_behind = live.turn > noted.turn ? hn::Ge(t_other, t) : hn::Gt(t_other, t);
      passed = hn::Add(passed, hn::IfThenZeroElse(is_behind, WorthOf(hits[other])));
      const FloatVec gained = hn::IfThenElseZero(is_behind, worth);
      hn::Store(hn::Add(hn::Load(d, live.passed), gained), d, live.passed);
    };
    for (int p = 0; p < num_open; ++p) {
      if (open[p] != slot) trade(open[p]);
    }
    for (const SweptHit* p = group_; p != group_end_; ++p) {
      trade(SlotOf(*p));
    }
    float* const settled = memory_->settled[block_];
    hn::Store(hn::Add(hn::Load(d, settled), worth), d, settled);
    const FloatVec front = hn::Load(d, hits[slot].front);
    if (hn::AllFalse(d, Shows(front))) return;
    WriteRow(noted.pair, front, hn::Sub(fields_->Block(block_).Get(kFieldBehind), passed));
  }

  std::uint64_t BlocksOf(std::uint32_t pair) const { return memory_->blocks_of[pair]; }
  // Puts a Gaussian's light and worth at a block where BlendStep reads them.
  HWY_INLINE void Restore(std::uint32_t pair, int block, BlockFields fields) const {
    const FloatTag d;
    const std::size_t row =
        memory_->row_of[std::size_t{pair} * kBlocks + static_cast<std::size_t>(block)];
    const float* const from = memory_->rows.data() + 2 * kLanes * row;
    fields.Set(kFieldTransmittance, hn::Load(d, from));
    fields.Set(kFieldBehind, hn::Load(d, from + kLanes));
  }

 private:
  HWY_INLINE FloatMask Shows(FloatVec front) const {
    return hn::Ge(front, hn::Set(FloatTag(), stop_));
  }
  // w v of a hit, where its light is known.
  HWY_INLINE FloatVec WorthOf(const BlockHit& hit) const {
    const FloatTag d;
    const BlockFields fields = fields_->Block(block_);
    const FloatVec front = hn::Load(d, hit.front);
    const FloatVec behind = hn::Mul(front, hn::Load(d, hit.rest));
    FloatMask blends = Shows(front);
    if (HWY_UNLIKELY(stop_before_)) {
      blends = hn::And(blends, hn::Gt(behind, hn::Set(d, stop_)));
    }
    FloatVec value = hn::Mul(hn::Set(d, hit.color[0]), fields.Get(kFieldRed));
    value = hn::MulAdd(hn::Set(d, hit.color[1]), fields.Get(kFieldGreen), value);
    value = hn::MulAdd(hn::Set(d, hit.color[2]), fields.Get(kFieldBlue), value);
    return hn::IfThenElseZero(blends, hn::Mul(hn::Sub(front, behind), value));
  }
  HWY_INLINE void WriteRow(std::uint32_t pair, FloatVec front, FloatVec behind) {
    const FloatTag d;
    const std::size_t begin = 2 * kLanes * std::size_t{num_rows_};
    if (HWY_UNLIKELY(begin + 2 * kLanes > memory_->rows.size())) {
      memory_->rows.resize(2 * (begin + 2 * kLanes));
    }
    hn::Store(front, d, &memory_->rows[begin]);
    hn::Store(behind, d, &memory_->rows[begin + kLanes]);
    memory_->row_of[std::size_t{pair} * kBlocks + static_cast<std::size_t>(block_)] = num_rows_++;
    memory_->blocks_of[pair] |= std::uint64_t{1} << block_;
  }

  const float stop_;
  const bool stop_before_;
  TileFields<kNumFields>* const fields_;
  NotesMemory* const memory_;
  int block_ = 0;
  std::uint32_t first_pair_ = 0, turn_ = 0, num_rows_ = 0;
  const SweptHit* group_ = nullptr;
  const SweptHit* group_end_ = nullptr;
};

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
