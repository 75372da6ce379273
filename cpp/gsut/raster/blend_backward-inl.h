// Takes gradients back through the blend of a tile, for any kind of rays.
//
// The forward pass gives a pixel, with w_i = alpha_i T_i and T_(i+1) = T_i (1 - alpha_i),
//   C = sum w_i c_i + T_end background,  depth = sum w_i x_i,
//   distortion = sum w_i (x_i - mean)^2,  mean = depth / sum w_i,
// x_i the distance to Gaussian i. To L, one unit of weight on Gaussian i adds
//   v_i = dL/dC . c_i + dL/ddepth x_i + dL/ddistortion (x_i - mean)^2:
// the mean's own change adds nothing, as sum w_i (x_i - mean) = 0. What lies behind i,
//   B_i = sum over j > i of w_j v_j + T_end dL/dT_end,
// is proportional to 1 - alpha_i, hence
//   h_i = alpha_i dL/dalpha_i = w_i v_i - alpha_i / (1 - alpha_i) B_i,
// or under extinction, where alpha = 1 - 2^-raw, h_i = raw dL/draw = ln 2 raw (T_(i+1) v_i - B_i),
//   dL/dc_i = w_i dL/dC,  dL/dx_i = w_i (dL/ddepth + 2 dL/ddistortion (x_i - mean)).
// The pass runs front to back, as the forward pass did: T_i comes out with the same bits, and B_i
// is the whole, B_0, known from the image, less what was passed. Nothing is divided by a vanishing
// T.

#if defined(GSUT_RASTER_BLEND_BACKWARD_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_BLEND_BACKWARD_INL_H_
#undef GSUT_RASTER_BLEND_BACKWARD_INL_H_
#else
#define GSUT_RASTER_BLEND_BACKWARD_INL_H_
#endif

#include "gsut/raster/pixels-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// What a backward pass has to do: constants of the build where that pays, else flags of the run.
struct BackwardFlags {
  bool with_depth;             // gradients to depth or distortion arrive
  bool with_rays;              // gradients to the rays are wanted
  bool with_error;             // ImageGradients::error arrives
  bool with_channels = false;  // ImageGradients::channels arrives
};

// What a block of pixels carries along from Gaussian to Gaussian: fields of kLanes floats. Kernels
// add fields of their own behind these.
enum PixelField {
  kFieldS,
  kFieldT,
  kFieldRed,  // dL/dred ...
  kFieldGreen,
  kFieldBlue,
  kFieldTransmittance,  // T_i
  kFieldBehind,         // B_i
  kFieldAlong,          // dL/ddepth times the ray's length
  kFieldSquare,         // dL/ddistortion times the ray's length squared
  kFieldMean,           // of the distances, which the distortion is about
  kFieldError,          // see ImageGradients::error
  kNumPixelFields
};

// The fields of one block.
class BlockFields {
 public:
  HWY_INLINE explicit BlockFields(float* values) : values_(values) {}
  HWY_INLINE FloatVec Get(int field) const {
    return hn::Load(FloatTag(), values_ + field * kLanes);
  }
  HWY_INLINE void Set(int field, FloatVec v) const {
    hn::Store(v, FloatTag(), values_ + field * kLanes);
  }

 private:
  float* values_;
};

// The fields of a tile's blocks, kNumFields each.
template <int kNumFields>
class TileFields {
 public:
  HWY_INLINE BlockFields Block(int block) {
    return BlockFields(values_ + block * kNumFields * kLanes);
  }
  // Writes the fields [first, kNumFields) to 256 floats each, swizzled as the tile grid.
  HWY_INLINE void Export(int first, float* out) {
    for (int block = 0; block < kBlocks; ++block) {
      for (int field = first; field < kNumFields; ++field) {
        hn::Store(Block(block).Get(field), FloatTag(),
                  out + (field - first) * kTilePixels + block * kLanes);
      }
    }
  }

 private:
  HWY_ALIGN float values_[kBlocks * kNumFields * kLanes];
};

// Starts a block at its first Gaussian: T_0, B_0 and the gradients to its pixels.
HWY_INLINE void StartBlock(BackwardFlags flags, const TileGrid& grid, const Frame& frame,
                           const PixelGradients& gradients, std::size_t pixel0, int block,
                           BlockFields fields) {
  const FloatTag d;
  const int at = block * kLanes;  // in the tile
  const std::size_t o = pixel0 + static_cast<std::size_t>(at);
  fields.Set(kFieldS, hn::Load(d, &grid.s[o]));
  fields.Set(kFieldT, hn::Load(d, &grid.t[o]));
  FloatVec behind = hn::Mul(hn::Abs(hn::Load(d, &frame.transmittance[o])),
                            hn::Load(d, gradients.final_transmittance + at));
  for (int c = 0; c < 3; ++c) {
    const FloatVec to_color = hn::Load(d, gradients.color[c] + at);
    fields.Set(kFieldRed + c, to_color);
    behind = hn::MulAdd(to_color, hn::Load(d, &frame.color[c][o]), behind);
  }
  if (flags.with_depth) {
    const FloatVec along = hn::Load(d, gradients.depth + at);
    fields.Set(kFieldAlong, along);
    behind = hn::MulAdd(along, hn::Load(d, &frame.depth[o]), behind);
    const FloatVec square = hn::Load(d, gradients.distortion + at);
    const DepthOfBlock depth(grid, frame, o);
    fields.Set(kFieldSquare, square);
    fields.Set(kFieldMean, depth.mean);
    behind = hn::MulAdd(square, depth.distortion, behind);
  }
  if (flags.with_error) fields.Set(kFieldError, hn::Load(d, gradients.error + at));
  if (flags.with_channels) behind = hn::Add(behind, hn::Load(d, gradients.channels + at));
  fields.Set(kFieldTransmittance, hn::Load(d, &grid.start[o]));
  fields.Set(kFieldBehind, behind);
}

// What the blend passes on to one Gaussian's response.
struct ResponseGradient {
  // raw dL/draw, which is alpha dL/dalpha, or under extinction the factor of ln 2 raw in it; 0
  // where alpha is clamped or nothing is drawn.
  FloatVec h;
  FloatVec to_distance;  // dL/dx; 0 without flags.with_depth
};

// The rule's alpha_max and transmittance_min, and the response.
struct BlendLimits {
  FloatVec alpha_max, stop;
  bool stop_before, is_extinction;
  HWY_INLINE explicit BlendLimits(const RasterTask& task)
      : alpha_max(hn::Set(FloatTag(), task.alpha_max)),
        stop(hn::Set(FloatTag(), task.transmittance_min)),
        stop_before(task.stop_before),
        is_extinction(task.is_extinction) {}
};

// One Gaussian's share of a block's pixels, and the light that it leaves.
struct BlendStep {
  FloatVec alpha, weight;  // 0 where it is not blended
  FloatVec left;           // negative: stopped before it, see Frame::transmittance
};

HWY_INLINE BlendStep StepBlend(const BlendLimits& limits, FloatVec alpha, FloatVec transmittance) {
  const FloatTag d;
  alpha = hn::IfThenElseZero(hn::Ge(transmittance, limits.stop), alpha);
  FloatVec weight = hn::Mul(alpha, transmittance);
  FloatVec left = hn::Sub(transmittance, weight);
  if (HWY_UNLIKELY(limits.stop_before)) {
    const FloatMask ends = hn::And(hn::Gt(alpha, hn::Zero(d)), hn::Le(left, limits.stop));
    left = hn::IfThenElse(ends, hn::Neg(transmittance), left);
    weight = hn::IfThenZeroElse(ends, weight);
    alpha = hn::IfThenZeroElse(ends, alpha);
  }
  return {alpha, weight, left};
}

// Steps over one Gaussian at one block: adds to the sums of its colour and error, updates T and B,
// and returns the gradients to its alpha and distance. alpha: at most limits.alpha_max, where it
// counts as clamped; 0 without a hit. distance: finite, also without a hit. pair: with
// flags.with_channels kLanes floats, what the Gaussian's channels add to v_i, which become its
// blend weights.
HWY_INLINE ResponseGradient StepOver(BackwardFlags flags, const BlendLimits& limits,
                                     const FloatVec* color, FloatVec alpha, FloatVec distance,
                                     BlockFields fields, FloatVec* sums, float* pair) {
  const FloatTag d;
  const FloatMask is_free = hn::Lt(alpha, limits.alpha_max);
  const BlendStep step = StepBlend(limits, alpha, fields.Get(kFieldTransmittance));
  const FloatVec weight = step.weight;
  fields.Set(kFieldTransmittance, step.left);
  // Gradients to the colour, and v.
  const FloatVec red = fields.Get(kFieldRed);
  const FloatVec green = fields.Get(kFieldGreen);
  const FloatVec blue = fields.Get(kFieldBlue);
  sums[slot::kColor] = hn::MulAdd(weight, red, sums[slot::kColor]);
  sums[slot::kColor + 1] = hn::MulAdd(weight, green, sums[slot::kColor + 1]);
  sums[slot::kColor + 2] = hn::MulAdd(weight, blue, sums[slot::kColor + 2]);
  if (flags.with_error) {
    sums[slot::kError] = hn::MulAdd(weight, fields.Get(kFieldError), sums[slot::kError]);
  }
  FloatVec value = hn::MulAdd(color[0], red, hn::MulAdd(color[1], green, hn::Mul(color[2], blue)));
  if (flags.with_channels) {
    value = hn::Add(value, hn::Load(d, pair));
    hn::Store(weight, d, pair);
  }
  FloatVec to_distance = hn::Zero(d);
  if (flags.with_depth) {
    const FloatVec along = fields.Get(kFieldAlong);
    const FloatVec apart = hn::Sub(distance, fields.Get(kFieldMean));
    const FloatVec pull = hn::Mul(fields.Get(kFieldSquare), apart);
    value = hn::MulAdd(distance, along, hn::MulAdd(pull, apart, value));
    to_distance = hn::Mul(weight, hn::Add(along, hn::Add(pull, pull)));
  }
  // B and h.
  const FloatVec here = hn::Mul(weight, value);
  const FloatVec behind = hn::Sub(fields.Get(kFieldBehind), here);
  fields.Set(kFieldBehind, behind);
  if (HWY_UNLIKELY(limits.is_extinction)) {
    const FloatMask is_drawn = hn::And(is_free, hn::Gt(step.alpha, hn::Zero(d)));
    return {hn::IfThenElseZero(is_drawn, hn::MulSub(step.left, value, behind)), to_distance};
  }
  const FloatVec past = FastReciprocal(hn::Sub(hn::Set(d, 1.0f), step.alpha));
  const FloatVec h =
      hn::IfThenElseZero(is_free, hn::NegMulAdd(hn::Mul(step.alpha, past), behind, here));
  return {h, to_distance};
}

// The pairs of a tile as the forward pass kept them, in an order of all its pixels: T and B are
// carried from one to the next.
struct KeptPairs {
  const TileEntry* entries;
  std::uint32_t count;

  HWY_INLINE KeptPairs(const Frame& frame, int tile)
      : entries(frame.entries.data() + frame.tile_begin[tile]), count(frame.entry_count[tile]) {}
  // Reads the tile's fields once they are started, and completes entries and count.
  template <int kNumFields>
  HWY_INLINE void Start(BackwardFlags, TileFields<kNumFields>*) {}
  // Puts T and B in front of entry e at a block into its fields.
  HWY_INLINE void Restore(std::uint32_t, int, BlockFields) const {}
};

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
