// Between the tiles' swizzled pixels and row-major images, with the background blended in.

#if defined(GSUT_RASTER_PIXELS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_PIXELS_INL_H_
#undef GSUT_RASTER_PIXELS_INL_H_
#else
#define GSUT_RASTER_PIXELS_INL_H_
#endif

#include "gsut/raster/blend-inl.h"
#include "gsut/raster/task.h"
#include "gsut/raster/tile_math-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Calls visit(offset in the tile, pixel index, count) for each run of up to 4 pixels of the tile
// that lies inside the image: 4 neighbours in a row are 4 neighbours in a block.
template <class Visit>
HWY_INLINE void ForEachRun(const TileGrid& grid, int tile, Visit&& visit) {
  const int x0 = (tile % grid.tiles_x) * kTileSize;
  const int y0 = (tile / grid.tiles_x) * kTileSize;
  const int rows = HWY_MIN(kTileSize, grid.height - y0);
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < kTileSize; column += kBlockWidth) {
      const int count = HWY_MIN(kBlockWidth, grid.width - x0 - column);
      if (count <= 0) break;
      visit(grid.PixelOffset(column, row),
            static_cast<std::size_t>(y0 + row) * grid.width + x0 + column, count);
    }
  }
}

// C = sum of w_i c_i + T background and alpha = T_0 - T, where T_0 is 0 for a pixel without a ray.
// The sign of a stored T marks a pixel that stopped early. Distances are blended in units of the
// ray D + s E1 + t E2, whose length turns them into those along a unit ray.
HWY_INLINE void WritePixels(const TileGrid& grid, int tile, const Frame& frame,
                            const float* background, bool with_depth, float* image, float* alpha,
                            float* depth, float* distortion) {
  const Float4 d;
  const std::size_t pixel0 = static_cast<std::size_t>(tile) * kTilePixels;
  ForEachRun(grid, tile, [&](int offset, std::size_t pixel, int count) HWY_ATTR {
    const std::size_t o = pixel0 + static_cast<std::size_t>(offset);
    const auto left = hn::Abs(hn::Load(d, &frame.transmittance[o]));
    const auto opaque = hn::Sub(hn::Load(d, &grid.start[o]), left);
    const auto red = hn::MulAdd(left, hn::Set(d, background[0]), hn::Load(d, &frame.color[0][o]));
    const auto green = hn::MulAdd(left, hn::Set(d, background[1]), hn::Load(d, &frame.color[1][o]));
    const auto blue = hn::MulAdd(left, hn::Set(d, background[2]), hn::Load(d, &frame.color[2][o]));
    const auto far = with_depth
                         ? hn::Mul(hn::Load(d, &frame.depth[o]), hn::Load(d, &grid.length[o]))
                         : hn::Zero(d);
    if (count == kBlockWidth) {
      hn::StoreInterleaved3(red, green, blue, d, image + 3 * pixel);
      if (alpha != nullptr) hn::StoreU(opaque, d, alpha + pixel);
      if (depth != nullptr) hn::StoreU(far, d, depth + pixel);
      return;
    }
    HWY_ALIGN float rgb[12], one[4], other[4];
    hn::StoreInterleaved3(red, green, blue, d, rgb);
    hn::Store(opaque, d, one);
    hn::Store(far, d, other);
    for (int i = 0; i < 3 * count; ++i) image[3 * pixel + i] = rgb[i];
    for (int i = 0; i < count; ++i) {
      if (alpha != nullptr) alpha[pixel + i] = one[i];
      if (depth != nullptr) depth[pixel + i] = other[i];
    }
  });
  if (distortion == nullptr) return;
  HWY_ALIGN float values[kTilePixels];
  const FloatTag whole;
  for (int o = 0; o < kTilePixels; o += kLanes) {
    const std::size_t at = pixel0 + static_cast<std::size_t>(o);
    const FloatVec length = hn::Load(whole, &grid.length[at]);
    const FloatVec value = DepthOfBlock(grid, frame, at).distortion;
    hn::Store(hn::Mul(hn::Mul(length, length), value), whole, values + o);
  }
  ForEachRun(grid, tile, [&](int offset, std::size_t pixel, int count) HWY_ATTR {
    for (int i = 0; i < count; ++i) distortion[pixel + i] = values[offset + i];
  });
}

// Gradients of L to the image's pixels of one tile, swizzled as the tile grid.
struct PixelGradients {
  const float* color[3];
  const float* depth;                // to depth, times the ray's length
  const float* distortion;           // to distortion, times the length squared
  const float* final_transmittance;  // to the transmittance that is left
  const float* error;                // no gradient: ImageGradients::error
  const float* channels = nullptr;   // sum over the channels of dL/dC_d C_d
};

// Reads them into buffer[7 * 256], which the result points into. Pixels outside the image are 0.
HWY_INLINE PixelGradients ReadPixelGradients(const TileGrid& grid, int tile,
                                             const ImageGradients& gradients,
                                             const float* background, float* buffer) {
  const Float4 d;
  const std::size_t pixel0 = static_cast<std::size_t>(tile) * kTilePixels;
  const int x0 = (tile % grid.tiles_x) * kTileSize;
  const int y0 = (tile / grid.tiles_x) * kTileSize;
  if (x0 + kTileSize > grid.width || y0 + kTileSize > grid.height) {
    __builtin_memset(buffer, 0, sizeof(float) * 7 * kTilePixels);
  }
  ForEachRun(grid, tile, [&](int offset, std::size_t pixel, int count) HWY_ATTR {
    HWY_ALIGN float rgb[12] = {}, one[4] = {}, other[4] = {}, square[4] = {}, charge[4] = {};
    const float* color = gradients.image + 3 * pixel;
    const float* alpha = gradients.alpha == nullptr ? nullptr : gradients.alpha + pixel;
    const float* depth = gradients.depth == nullptr ? nullptr : gradients.depth + pixel;
    const float* distortion =
        gradients.distortion == nullptr ? nullptr : gradients.distortion + pixel;
    const float* error = gradients.error == nullptr ? nullptr : gradients.error + pixel;
    if (count < kBlockWidth) {
      for (int i = 0; i < 3 * count; ++i) rgb[i] = color[i];
      color = rgb;
      for (int i = 0; i < count; ++i) {
        if (alpha != nullptr) one[i] = alpha[i];
        if (depth != nullptr) other[i] = depth[i];
        if (distortion != nullptr) square[i] = distortion[i];
        if (error != nullptr) charge[i] = error[i];
      }
      if (alpha != nullptr) alpha = one;
      if (depth != nullptr) depth = other;
      if (distortion != nullptr) distortion = square;
      if (error != nullptr) error = charge;
    }
    hn::Vec<Float4> red, green, blue;
    hn::LoadInterleaved3(d, color, red, green, blue);
    // T_end adds background to the colour and takes as much from alpha: dL/dT_end = dL/dC .
    // background - dL/dalpha.
    auto final_t = hn::MulAdd(
        red, hn::Set(d, background[0]),
        hn::MulAdd(green, hn::Set(d, background[1]), hn::Mul(blue, hn::Set(d, background[2]))));
    if (alpha != nullptr) final_t = hn::Sub(final_t, hn::LoadU(d, alpha));
    float* out = buffer + offset;
    hn::Store(red, d, out);
    hn::Store(green, d, out + kTilePixels);
    hn::Store(blue, d, out + 2 * kTilePixels);
    hn::Store(final_t, d, out + 3 * kTilePixels);
    if (error != nullptr) hn::Store(hn::LoadU(d, error), d, out + 6 * kTilePixels);
    if (!gradients.HasDepth()) return;
    const auto length = hn::Load(d, &grid.length[pixel0 + static_cast<std::size_t>(offset)]);
    const auto along = depth == nullptr ? hn::Zero(d) : hn::LoadU(d, depth);
    const auto apart = distortion == nullptr ? hn::Zero(d) : hn::LoadU(d, distortion);
    hn::Store(hn::Mul(along, length), d, out + 4 * kTilePixels);
    hn::Store(hn::Mul(apart, hn::Mul(length, length)), d, out + 5 * kTilePixels);
  });
  return {{buffer, buffer + kTilePixels, buffer + 2 * kTilePixels},
          buffer + 4 * kTilePixels,
          buffer + 5 * kTilePixels,
          buffer + 3 * kTilePixels,
          buffer + 6 * kTilePixels};
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
