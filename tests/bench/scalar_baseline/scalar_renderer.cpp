// The scalar float renderer: rays, tile lists, forward. Written to be read and to be fair, not to
// be fast; nothing but ./run bench uses it.
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <string>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/gaussians/activations.h"
#include "gsut/gaussians/harmonics.h"
#include "scalar_renderer.h"
#include "scalar_response.h"

namespace gsut {
namespace {

constexpr std::int64_t kGaussianGrain = 2048;
// Float rounding of the cosine of an angle between unit vectors.
constexpr float kCosineSlack = 1e-6f;

}  // namespace

void ScalarRenderer::Render(const GaussiansView<const float>& gaussians, const Camera& camera,
                            const Pose& camera_from_world, const RenderSettings& settings,
                            const UnscentedOptions& unscented, float* image, float* alpha) {
  rendered_ = false;
  gaussians_ = gaussians;
  settings_ = settings;
  center_ = camera_from_world.CenterInSource();
  sh_degree_ = std::min(settings.sh_degree, ShDegree(gaussians.sh_coefficients));
  PrepareRays(camera, camera_from_world);
  timings_.clear();
  Stopwatch watch;
  Project(gaussians, camera, camera_from_world, unscented,
          {settings.rule.alpha_min, settings.rule.response_min}, &projected_);
  timings_.push_back(watch.Lap("project"));
  MakeSplats(camera_from_world);
  MakeLists();
  timings_.push_back(watch.Lap("lists"));
  const std::size_t pixels = static_cast<std::size_t>(width_) * height_;
  transmittance_.assign(pixels, 1.0f);
  evaluated_.assign(pixels, 0u);
  blended_.assign(pixels, 0u);
  ParallelFor(static_cast<std::int64_t>(cones_.size()), 1, [&](std::int64_t tile, std::int64_t) {
    RenderTile(static_cast<int>(tile), image, alpha);
  });
  timings_.push_back(watch.Lap("forward"));
  rendered_ = true;
}

void ScalarRenderer::PrepareRays(const Camera& camera, const Pose& camera_from_world) {
  width_ = camera.width();
  height_ = camera.height();
  tiles_x_ = (width_ + kTile - 1) / kTile;
  const int tiles_y = (height_ + kTile - 1) / kTile;
  const RayTable& table = camera.Rays();
  const Eigen::Matrix3d world_from_camera = camera_from_world.rotation.transpose();
  valid_ = table.valid;
  rays_.assign(3 * valid_.size(), 0.0f);
  for (std::size_t p = 0; p < valid_.size(); ++p) {
    if (!valid_[p]) continue;
    const Eigen::Vector3d ray =
        world_from_camera * Eigen::Map<const Eigen::Vector3d>(&table.rays[3 * p]);
    for (int k = 0; k < 3; ++k) rays_[3 * p + k] = static_cast<float>(ray[k]);
  }
  cones_.assign(static_cast<std::size_t>(tiles_x_) * tiles_y, {});
  for (std::size_t tile = 0; tile < cones_.size(); ++tile) {
    const auto for_each_ray = [&](auto&& visit) {
      ForEachPixel(static_cast<int>(tile), [&](std::size_t p) {
        if (valid_[p]) visit(Eigen::Map<const Eigen::Vector3f>(&rays_[3 * p]));
      });
    };
    Eigen::Vector3f axis = Eigen::Vector3f::Zero();
    for_each_ray([&](const auto& ray) { axis += ray; });
    axis.normalize();  // stays 0 without rays
    float cosine = 2.0f;
    for_each_ray([&](const auto& ray) { cosine = std::min(cosine, axis.dot(ray)); });
    TileCone& cone = cones_[tile];
    for (int k = 0; k < 3; ++k) cone.axis[k] = axis[k];
    cone.cosine = cosine;
    cone.sine = cosine > 1.0f ? 0.0f : std::sqrt(1.0f - cosine * cosine);
  }
}

void ScalarRenderer::MakeSplats(const Pose& camera_from_world) {
  const std::size_t n = static_cast<std::size_t>(gaussians_.size);
  splats_.resize(n);
  rectangles_.resize(n);
  const BlendRule rule = settings_.rule.For(gaussians_.order);
  ParallelFor(gaussians_.size, kGaussianGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      const std::size_t j = static_cast<std::size_t>(i);
      rectangles_[j] = {};
      if (projected_.status[j] == SplatStatus::kUnseen) continue;
      Splat& s = splats_[j];
      const Eigen::Vector3d mean =
          Eigen::Map<const Eigen::Vector3f>(gaussians_.means + 3 * i).cast<double>() - center_;
      const double depth_z = camera_from_world.rotation.row(2) * mean;
      if (!(depth_z >= rule.near_z && depth_z <= rule.far_z)) continue;
      s.key = static_cast<float>(rule.order == OrderKey::kDistance ? mean.norm() : depth_z);
      const float m[3] = {static_cast<float>(mean[0]), static_cast<float>(mean[1]),
                          static_cast<float>(mean[2])};
      float r[9];
      RotationFromQuaternion(gaussians_.quats + 4 * i, r);
      for (int row = 0; row < 3; ++row) {
        const float inverse_scale = 1.0f / ScaleFromLog(gaussians_.log_scales[3 * i + row]);
        for (int k = 0; k < 3; ++k) s.whiten[3 * row + k] = r[3 * k + row] * inverse_scale;
        s.whitened[row] = Dot3(s.whiten + 3 * row, m);
      }
      s.opacity = Sigmoid(gaussians_.opacity_logits[i]);
      const float inverse_distance = 1.0f / std::sqrt(Dot3(m, m));
      const float direction[3] = {m[0] * inverse_distance, m[1] * inverse_distance,
                                  m[2] * inverse_distance};
      s.clamped = EvalHarmonics(sh_degree_, direction,
                                gaussians_.sh + 3 * gaussians_.sh_coefficients * i, s.color);
      if (std::isfinite(Dot3(s.whitened, s.whitened) + s.opacity + s.color[0] + s.color[1] +
                        s.color[2])) {
        rectangles_[j] = RectangleOf(j, m);
      }
    }
  });
}

ScalarRenderer::Rectangle ScalarRenderer::RectangleOf(std::size_t j, const float* mean) const {
  const int tiles_y = static_cast<int>(cones_.size()) / tiles_x_;
  const float u = projected_.u[j], v = projected_.v[j];
  if (std::isfinite(u)) {
    // Pixel centres within the centre +- extents.
    const auto first = [](float low) { return std::max(0.0f, std::ceil(low - 0.5f)); };
    const auto last = [](float high, int size) {
      return std::min(static_cast<float>(size - 1), std::floor(high - 0.5f));
    };
    const float reach_u = widen_ * projected_.extent_u[j];
    const float reach_v = widen_ * projected_.extent_v[j];
    const float x0 = first(u - reach_u), x1 = last(u + reach_u, width_);
    const float y0 = first(v - reach_v), y1 = last(v + reach_v, height_);
    if (!(x0 <= x1 && y0 <= y1)) return {};
    return {static_cast<int>(x0) / kTile, static_cast<int>(x1) / kTile + 1,
            static_cast<int>(y0) / kTile, static_cast<int>(y1) / kTile + 1};
  }
  // Sigma points without a pixel: the tiles whose cone meets the cone of the cut-off sphere.
  Rectangle r = {tiles_x_, 0, tiles_y, 0};
  const float sine = projected_.sine[j];
  const float cosine = std::sqrt(1.0f - sine * sine);
  const float inverse_distance = 1.0f / std::sqrt(Dot3(mean, mean));
  for (int y = 0; y < tiles_y; ++y) {
    for (int x = 0; x < tiles_x_; ++x) {
      const TileCone& cone = cones_[static_cast<std::size_t>(y) * tiles_x_ + x];
      if (cone.cosine > 1.0f) continue;
      const float limit = cosine * cone.cosine - sine * cone.sine;  // cosine of the sum of angles
      const bool surrounds = sine >= 1.0f;  // the camera is inside of the sphere
      if (!surrounds && Dot3(cone.axis, mean) * inverse_distance < limit - kCosineSlack) continue;
      r.x0 = std::min(r.x0, x);
      r.x1 = std::max(r.x1, x + 1);
      r.y0 = std::min(r.y0, y);
      r.y1 = std::max(r.y1, y + 1);
    }
  }
  return r;
}

void ScalarRenderer::MakeLists() {
  std::vector<std::uint32_t> order;
  slot_begin_.assign(rectangles_.size() + 1, 0u);
  std::uint64_t slots = 0;
  for (std::size_t j = 0; j < rectangles_.size(); ++j) {
    slot_begin_[j] = static_cast<std::uint32_t>(slots);
    if (rectangles_[j].Area() == 0) continue;
    slots += static_cast<std::uint64_t>(rectangles_[j].Area());
    order.push_back(static_cast<std::uint32_t>(j));
  }
  slot_begin_.back() = static_cast<std::uint32_t>(slots);
  if (slots >= (std::uint64_t{1} << 32)) {
    throw InputError("the scalar renderer has " + std::to_string(slots) +
                     " (tile, Gaussian) pairs, more than 4294967295: render a smaller image");
  }
  std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
    return splats_[a].key != splats_[b].key ? splats_[a].key < splats_[b].key : a < b;
  });
  const auto for_each_pair = [&](auto&& visit) {
    for (const std::uint32_t j : order) {
      const Rectangle& r = rectangles_[j];
      for (int y = r.y0; y < r.y1; ++y) {
        for (int x = r.x0; x < r.x1; ++x) visit(static_cast<std::size_t>(y) * tiles_x_ + x, j);
      }
    }
  };
  tile_begin_.assign(cones_.size() + 1, 0u);
  for_each_pair([&](std::size_t tile, std::uint32_t) { ++tile_begin_[tile + 1]; });
  std::partial_sum(tile_begin_.begin(), tile_begin_.end(), tile_begin_.begin());
  list_.resize(slots);
  std::vector<std::uint32_t> place = tile_begin_;
  for_each_pair([&](std::size_t tile, std::uint32_t j) { list_[place[tile]++] = j; });
}

void ScalarRenderer::RenderTile(int tile, float* image, float* alpha) {
  const BlendRule& rule = settings_.rule;
  const Cutoffs cutoffs(rule);
  const float stop = static_cast<float>(rule.transmittance_min);
  const std::uint32_t* list = list_.data() + tile_begin_[tile];
  const std::uint32_t count = tile_begin_[tile + 1] - tile_begin_[tile];
  ForEachPixel(tile, [&](std::size_t p) {
    float* out = image + 3 * p;
    alpha[p] = out[0] = out[1] = out[2] = 0.0f;
    if (!valid_[p]) return;
    const float* ray = &rays_[3 * p];
    float transmittance = 1.0f;
    float color[3] = {0.0f, 0.0f, 0.0f};
    std::uint32_t evaluated = 0, blended = 0;
    for (std::uint32_t j = 0; j < count; ++j) {
      const Splat& s = splats_[list[j]];
      RayResponse hit;
      if (!EvaluateResponse(s.whiten, s.whitened, s.opacity, ray, cutoffs, &hit)) {
        continue;
      }
      const float next = transmittance * (1.0f - hit.alpha);
      if (rule.stop_before && next <= stop) break;
      const float weight = hit.alpha * transmittance;
      for (int c = 0; c < 3; ++c) color[c] += weight * s.color[c];
      transmittance = next;
      evaluated = j + 1;
      ++blended;
      if (!rule.stop_before && next < stop) break;
    }
    for (int c = 0; c < 3; ++c) {
      out[c] = color[c] + transmittance * static_cast<float>(settings_.background[c]);
    }
    alpha[p] = 1.0f - transmittance;
    transmittance_[p] = transmittance;
    evaluated_[p] = evaluated;
    blended_[p] = blended;
  });
}

std::int64_t ScalarRenderer::num_blended() const {
  return std::accumulate(blended_.begin(), blended_.end(), std::int64_t{0});
}

std::int64_t ScalarRenderer::num_evaluated() const {
  return std::accumulate(evaluated_.begin(), evaluated_.end(), std::int64_t{0});
}

}  // namespace gsut
