// Notes T_i and B_(i-1) of a blend in the order of each pixel's own ray, for the backward pass.
//
// blend_backward-inl.h walks a tile's Gaussians in one order and carries T_i and B_i along. Here
// each pixel has an order of its own, so the blend is made a second time (ray_order-inl.h) and
// leaves both for each Gaussian and block: T_i is the light in front of the hit, and B_(i-1), what
// it and all behind it contribute to L, is the whole less what is in front of it,
//   B_(i-1) = B_0 - sum over j in front of i of w_j v_j.
// Hits are resolved (blended) by the far ends of their intervals, so that most that are resolved
// before i are in front of it at all pixels: their sum is one a block. Of two that are open at the
// same time the one that is resolved later may be in front at some pixels. There, and only then,
// each one's w v is added to or taken from the other's sum when the first of them is resolved: by
// then the light in front of both is known where it counts, as nothing unswept is nearer.

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
  // By slot: sum of w_j v_j in front of it, less what is resolved before; its place in the tile's
  // list; its number in the order of the sweep.
  AlignedVector<float> passed[kBlocks];
  AlignedVector<std::uint32_t> pairs[kBlocks], sweep_order[kBlocks];
  AlignedVector<int> overlapping;             // slots whose order differs from pixel to pixel
  HWY_ALIGN float resolved[kBlocks][kLanes];  // sum of w_j v_j of all that is resolved
  AlignedVector<float> rows;                  // of each resolved hit: T_i and B_(i-1)
  AlignedVector<std::uint32_t> row_of;        // (pairs, kBlocks)
  AlignedVector<std::uint64_t> blocks_of;     // (pairs) where there is a row
  AlignedVector<TileEntry> entries;           // of the pairs that have one
  AlignedVector<std::uint32_t> pair_of;       // of each entry
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

  HWY_INLINE RayNotes(bool with_depth, const RasterTask& task, std::uint32_t pairs,
                      TileFields<kNumFields>* fields, NotesMemory* memory)
      : with_depth_(with_depth),
        stop_(task.transmittance_min),
        stop_before_(task.stop_before),
        fields_(fields),
        memory_(memory) {
    memory_->row_of.resize(std::size_t{pairs} * kBlocks);
    memory_->blocks_of.assign(pairs, 0);
    for (int block = 0; block < kBlocks; ++block) {
      hn::Store(hn::Zero(FloatTag()), FloatTag(), memory_->resolved[block]);
    }
  }

  // Moves to another block, where pairs from first_pair on are read.
  HWY_INLINE void MoveToBlock(int block, std::uint32_t first_pair) {
    block_ = block;
    first_pair_ = first_pair;
    group_size_ = 0;
  }
  // Notes the Gaussian of a hit that was read.
  HWY_INLINE void NoteGaussian(int slot, int index) {
    const auto i = static_cast<std::size_t>(slot);
    if (HWY_UNLIKELY(i >= memory_->pairs[block_].size())) Grow(2 * i + kChunk);
    memory_->pairs[block_][i] = first_pair_ + static_cast<std::uint32_t>(index);
  }
  // Starts a group of hits that are swept together.
  HWY_INLINE void StartGroup(BlockHit* hits, const SweptHit* begin, int count,
                             const FloatVec* front) {
    const FloatTag d;
    group_size_ = count;
    for (int i = 0; i < count; ++i) {
      const auto slot = static_cast<std::size_t>(SlotOf(begin[i]));
      group_[i] = SlotOf(begin[i]);
      hn::Store(front[i], d, hits[slot].front);
      hn::Store(hn::Zero(d), d, &memory_->passed[block_][slot * kLanes]);
      memory_->sweep_order[block_][slot] = num_swept_++;
    }
  }
  // Resolves those of the group whose t is nowhere above `bound`; others will be open.
  HWY_INLINE void FinishGroup(const BlockHit* hits, float bound, const int* open, int num_open) {
    for (int i = 0; i < group_size_;) {
      const int slot = group_[i];
      if (!(hits[slot].last <= bound)) {
        ++i;
        continue;
      }
      group_[i] = group_[--group_size_];
      ResolveHit(hits, slot, open, num_open);
    }
    group_size_ = 0;
  }
  // Resolves a hit: orders it among the open ones and the rest of the group at each pixel, and
  // writes its row. One function, as it is called from many places.
  HWY_NOINLINE void ResolveHit(const BlockHit* hits, int slot, const int* open, int num_open) {
    const FloatTag d;
    float* const passed_of = memory_->passed[block_].data();
    int* const overlapping = memory_->overlapping.data();
    int num_overlapping = 0;
    // Nothing is in front where there is no hit.
    FloatVec t = hn::Load(d, hits[slot].t);
    t = hn::IfThenElse(hn::Lt(t, hn::Set(d, kNever)), t, hn::Set(d, -kNever));
    const auto add_if_overlapping = [&](int other) HWY_ATTR {
      overlapping[num_overlapping] = other;
      num_overlapping += !hn::AllFalse(d, hn::Le(hn::Load(d, hits[other].t), t));
    };
    for (int p = 0; p < num_open; ++p) add_if_overlapping(open[p]);
    for (int i = 0; i < group_size_; ++i) add_if_overlapping(group_[i]);
    const FloatVec contribution = ContributionOf(hits[slot]);
    FloatVec passed = hn::Load(d, passed_of + slot * kLanes);
    const std::uint32_t* const order = memory_->sweep_order[block_].data();
    for (int k = 0; k < num_overlapping; ++k) {
      const int other = overlapping[k];
      if (other == slot) continue;
      // Of two at the same place the one that was swept first is in front.
      const FloatVec t_other = hn::Load(d, hits[other].t);
      const FloatMask is_front =
          order[other] < order[slot] ? hn::Le(t_other, t) : hn::Lt(t_other, t);
      passed = hn::Add(passed, hn::IfThenElseZero(is_front, ContributionOf(hits[other])));
      float* const of_other = passed_of + other * kLanes;
      hn::Store(hn::Sub(hn::Load(d, of_other), hn::IfThenElseZero(is_front, contribution)), d,
                of_other);
    }
    float* const resolved = memory_->resolved[block_];
    const FloatVec before = hn::Load(d, resolved);
    hn::Store(hn::Add(before, contribution), d, resolved);
    const FloatVec front = hn::Load(d, hits[slot].front);
    if (hn::AllFalse(d, Shows(front))) return;
    passed = hn::Add(before, passed);
    WriteRow(memory_->pairs[block_][static_cast<std::size_t>(slot)], front,
             hn::Sub(fields_->Block(block_).Get(kFieldBehind), passed));
  }

 private:
  HWY_INLINE FloatMask Shows(FloatVec front) const {
    return hn::Ge(front, hn::Set(FloatTag(), stop_));
  }
  HWY_NOINLINE void Grow(std::size_t slots) {
    memory_->passed[block_].resize(slots * kLanes);
    memory_->pairs[block_].resize(slots);
    memory_->sweep_order[block_].resize(slots);
    memory_->overlapping.resize(HWY_MAX(memory_->overlapping.size(), slots));
  }
  // w v of a hit, where its light is known.
  HWY_INLINE FloatVec ContributionOf(const BlockHit& hit) const {
    const FloatTag d;
    const FloatVec front = hn::Load(d, hit.front);
    const FloatVec behind = hn::Mul(front, hn::Load(d, hit.rest));
    FloatMask blends = Shows(front);
    if (HWY_UNLIKELY(stop_before_)) {
      blends = hn::And(blends, hn::Gt(behind, hn::Set(d, stop_)));
    }
    const BlockFields fields = fields_->Block(block_);
    FloatVec value = hn::Mul(hn::Set(d, hit.color[0]), fields.Get(kFieldRed));
    value = hn::MulAdd(hn::Set(d, hit.color[1]), fields.Get(kFieldGreen), value);
    value = hn::MulAdd(hn::Set(d, hit.color[2]), fields.Get(kFieldBlue), value);
    if (HWY_UNLIKELY(with_depth_)) {
      const FloatVec t = hn::Load(d, hit.t);
      const FloatVec distance = hn::IfThenElseZero(hn::Lt(t, hn::Set(d, kNever)), t);
      const FloatVec apart = hn::Sub(distance, fields.Get(kFieldMean));
      const FloatVec pull = hn::Mul(fields.Get(kFieldSquare), apart);
      value = hn::MulAdd(distance, fields.Get(kFieldAlong), hn::MulAdd(pull, apart, value));
    }
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

  const bool with_depth_;
  const float stop_;
  const bool stop_before_;
  TileFields<kNumFields>* const fields_;
  NotesMemory* const memory_;
  int block_ = 0;
  std::uint32_t first_pair_ = 0, num_swept_ = 0, num_rows_ = 0;
  int group_size_ = 0;
  int group_[kSweepJam];  // slots of hits that are swept together and not resolved
};

// The pairs of a tile that is blended along its rays: each has T and B of its own at each block.
// As KeptPairs; blend(notes): blends the tile once more.
template <class Blend>
class RayPairs {
 public:
  const TileEntry* entries = nullptr;
  std::uint32_t count;

  HWY_INLINE RayPairs(const RasterTask& task, const Frame& frame, int tile, const Blend& blend)
      : count(frame.tile_begin[tile + 1] - frame.tile_begin[tile]),
        task_(task),
        pairs_(frame.pairs.data() + frame.tile_begin[tile]),
        blend_(blend),
        memory_(NotesOfThread()) {}

  template <int kNumFields>
  HWY_INLINE void Start(BackwardFlags flags, TileFields<kNumFields>* fields) {
    RayNotes<kNumFields> notes(flags.with_depth, task_, count, fields, memory_);
    blend_(&notes);
    memory_->entries.clear();
    memory_->pair_of.clear();
    for (std::uint32_t pair = 0; pair < count; ++pair) {
      const std::uint64_t blocks = memory_->blocks_of[pair];
      if (blocks == 0) continue;
      memory_->entries.push_back({pairs_[pair].gaussian, pairs_[pair].slot, blocks});
      memory_->pair_of.push_back(pair);
    }
    entries = memory_->entries.data();
    count = static_cast<std::uint32_t>(memory_->entries.size());
  }
  HWY_INLINE void Restore(std::uint32_t e, int block, BlockFields fields) const {
    const FloatTag d;
    const std::size_t place = std::size_t{memory_->pair_of[e]} * kBlocks;
    const std::size_t row = memory_->row_of[place + static_cast<std::size_t>(block)];
    const float* const from = memory_->rows.data() + 2 * kLanes * row;
    fields.Set(kFieldTransmittance, hn::Load(d, from));
    fields.Set(kFieldBehind, hn::Load(d, from + kLanes));
  }

 private:
  const RasterTask& task_;
  const TilePair* const pairs_;
  const Blend& blend_;
  NotesMemory* const memory_;
};

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
