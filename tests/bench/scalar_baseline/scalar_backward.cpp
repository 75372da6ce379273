// The backward pass of the scalar float renderer: pixels to lists, lists to Gaussians.
#include <algorithm>
#include <cmath>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/gaussians/activations.h"
#include "gsut/gaussians/harmonics.h"
#include "scalar_renderer.h"
#include "scalar_response.h"

namespace gsut {
namespace {

constexpr std::int64_t kGaussianGrain = 2048;

}  // namespace

void ScalarRenderer::BackwardTile(int tile, const float* dimage) {
  const Cutoffs cutoffs(settings_.rule);
  const std::uint32_t* list = list_.data() + tile_begin_[tile];
  const std::uint32_t count = tile_begin_[tile + 1] - tile_begin_[tile];
  thread_local std::vector<SplatGradient> sums;
  sums.assign(count, SplatGradient{});
  ForEachPixel(tile, [&](std::size_t p) {
    if (!valid_[p]) return;
    const float* ray = &rays_[3 * p];
    const float* g_pixel = dimage + 3 * p;
    float transmittance = transmittance_[p];  // behind the current Gaussian
    // What lies behind the current Gaussian, as L sees it.
    float behind = 0.0f;
    for (int c = 0; c < 3; ++c) {
      behind += transmittance * g_pixel[c] * static_cast<float>(settings_.background[c]);
    }
    for (std::uint32_t j = evaluated_[p]; j-- > 0;) {
      const Splat& s = splats_[list[j]];
      RayResponse hit;
      if (!EvaluateResponse(s.whiten, s.whitened, s.opacity, ray, cutoffs, &hit)) {
        continue;
      }
      SplatGradient& sum = sums[j];
      const float past = 1.0f / (1.0f - hit.alpha);
      transmittance *= past;  // before it
      const float weight = hit.alpha * transmittance;
      const float value = Dot3(g_pixel, s.color);
      const float g_alpha = transmittance * value - behind * past;
      behind += weight * value;
      for (int c = 0; c < 3; ++c) sum.color[c] += weight * g_pixel[c];
      if (hit.clamped) continue;
      sum.opacity += g_alpha * hit.response;
      // With c = A m x u: dL/dc = -alpha dL/dalpha c.
      float g_cross[3];
      for (int k = 0; k < 3; ++k) g_cross[k] = -hit.alpha * g_alpha * hit.cross[k];
      float g_whitened[3], g_unit[3];
      Cross3(hit.unit, g_cross, g_whitened);
      Cross3(g_cross, s.whitened, g_unit);
      const float along = Dot3(hit.unit, g_unit);
      for (int row = 0; row < 3; ++row) {
        sum.whitened[row] += g_whitened[row];
        const float g_w = (g_unit[row] - along * hit.unit[row]) * hit.inverse_length;
        for (int k = 0; k < 3; ++k) sum.whiten[3 * row + k] += g_w * ray[k];
      }
    }
  });
  const int x = tile % tiles_x_, y = tile / tiles_x_;
  for (std::uint32_t j = 0; j < count; ++j) {
    const Rectangle& r = rectangles_[list[j]];
    slot_gradients_[slot_begin_[list[j]] +
                    static_cast<std::uint32_t>((y - r.y0) * (r.x1 - r.x0) + x - r.x0)] = sums[j];
  }
}

void ScalarRenderer::ChainToParameters(std::int64_t i, const GaussiansView<float>& out) const {
  const std::size_t j = static_cast<std::size_t>(i);
  const int coefficients = out.sh_coefficients;
  float* g_sh = out.sh + 3 * coefficients * i;
  std::fill_n(g_sh, 3 * coefficients, 0.0f);
  if (slot_begin_[j] == slot_begin_[j + 1]) {
    std::fill_n(out.means + 3 * i, 3, 0.0f);
    std::fill_n(out.quats + 4 * i, 4, 0.0f);
    std::fill_n(out.log_scales + 3 * i, 3, 0.0f);
    out.opacity_logits[i] = 0.0f;
    return;
  }
  SplatGradient sum{};
  for (std::uint32_t slot = slot_begin_[j]; slot < slot_begin_[j + 1]; ++slot) {
    const SplatGradient& pair = slot_gradients_[slot];
    for (int k = 0; k < 9; ++k) sum.whiten[k] += pair.whiten[k];
    for (int k = 0; k < 3; ++k) sum.whitened[k] += pair.whitened[k];
    for (int k = 0; k < 3; ++k) sum.color[k] += pair.color[k];
    sum.opacity += pair.opacity;
  }
  const Splat& s = splats_[j];
  float m[3];
  for (int k = 0; k < 3; ++k) {
    m[k] = static_cast<float>(static_cast<double>(gaussians_.means[3 * i + k]) - center_[k]);
  }
  float* g_mean = out.means + 3 * i;
  for (int k = 0; k < 3; ++k) {
    g_mean[k] = s.whiten[k] * sum.whitened[0] + s.whiten[3 + k] * sum.whitened[1] +
                s.whiten[6 + k] * sum.whitened[2];
  }
  float g_rotation[9];
  for (int row = 0; row < 3; ++row) {
    float* g_row = sum.whiten + 3 * row;
    for (int k = 0; k < 3; ++k) g_row[k] += sum.whitened[row] * m[k];
    out.log_scales[3 * i + row] = -Dot3(g_row, s.whiten + 3 * row);
    const float inverse_scale = 1.0f / ScaleFromLog(gaussians_.log_scales[3 * i + row]);
    for (int k = 0; k < 3; ++k) g_rotation[3 * k + row] = g_row[k] * inverse_scale;
  }
  RotationFromQuaternionBackward(gaussians_.quats + 4 * i, g_rotation, out.quats + 4 * i);
  out.opacity_logits[i] = sum.opacity * SigmoidDerivative(s.opacity);
  const float inverse_distance = 1.0f / std::sqrt(Dot3(m, m));
  const float direction[3] = {m[0] * inverse_distance, m[1] * inverse_distance,
                              m[2] * inverse_distance};
  float g_direction[3];
  EvalHarmonicsBackward(sh_degree_, direction, gaussians_.sh + 3 * coefficients * i, s.clamped,
                        sum.color, g_sh, g_direction);
  const float along = Dot3(direction, g_direction);
  for (int k = 0; k < 3; ++k) {
    g_mean[k] += (g_direction[k] - direction[k] * along) * inverse_distance;
  }
}

void ScalarRenderer::Backward(const float* dimage, const GaussiansView<float>& gradients) {
  if (!rendered_) throw InputError("backward of the scalar renderer needs a render before it");
  if (gradients.size != gaussians_.size ||
      gradients.sh_coefficients != gaussians_.sh_coefficients) {
    throw InputError("gradients must be shaped like the rendered Gaussians");
  }
  timings_.resize(3);  // the forward stages stay
  Stopwatch watch;
  slot_gradients_.resize(list_.size());
  ParallelFor(static_cast<std::int64_t>(cones_.size()), 1, [&](std::int64_t tile, std::int64_t) {
    BackwardTile(static_cast<int>(tile), dimage);
  });
  timings_.push_back(watch.Lap("backward"));
  ParallelFor(gaussians_.size, kGaussianGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) ChainToParameters(i, gradients);
  });
  timings_.push_back(watch.Lap("gradients"));
}

}  // namespace gsut
