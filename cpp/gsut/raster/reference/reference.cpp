// The scalar double renderer and its backward: formulae as in the paper of 3DGUT, section 4,
// written for one ray and one Gaussian, in world coordinates relative to the reference's centre.
#include "gsut/raster/reference/reference.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <string>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/gaussians/activations.h"
#include "gsut/gaussians/harmonics.h"

namespace gsut {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// Number of row bands of the backward pass: fixed, so that sums have one order on any thread count.
constexpr int kBackwardBands = 8;

// A Gaussian seen from one camera.
struct Seen {
  std::int64_t index = 0;
  float key = 0;       // order; rounded to float as the tiled path does
  Matrix3d whiten;     // A = S^-1 R^T, world to whitened
  Vector3d relative;   // m = mean - reference's centre
  Vector3d whitened;   // A m
  Vector3d direction;  // shaded by: from the reference to the mean, or its axis
  double opacity = 0;
  Vector3d color;
  bool clamped[3] = {false, false, false};
};

// One blended Gaussian of a pixel.
struct Hit {
  std::size_t seen;
  double alpha, response, weight, t;
  bool clamped;
};

Eigen::Matrix<double, 3, 3> Rotation(const double* quat) {
  double r[9];
  RotationFromQuaternion(quat, r);
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(r);
}

int UsedCoefficients(int sh_coefficients, int sh_degree) {
  return std::min(sh_coefficients, (sh_degree + 1) * (sh_degree + 1));
}

std::vector<Seen> SortedGaussians(const GaussiansView<const double>& g, const ViewRays& view,
                                  const RenderSettings& settings) {
  settings.rule.Check();
  const Pose& pose = view.reference;
  const Vector3d center = pose.CenterInSource();
  std::vector<Seen> seen;
  seen.reserve(static_cast<std::size_t>(g.size));
  const int used = UsedCoefficients(g.sh_coefficients, settings.sh_degree);
  for (std::int64_t i = 0; i < g.size; ++i) {
    Seen s;
    s.index = i;
    s.relative = Eigen::Map<const Vector3d>(g.means + 3 * i) - center;
    const Eigen::Map<const Eigen::VectorXd> sh(g.sh + i * g.sh_coefficients * 3,
                                               3 * g.sh_coefficients);
    // Before anything is compared: a comparison with NaN is false and would drop it silently.
    if (!(s.relative.allFinite() && sh.allFinite())) {
      throw InputError("Gaussian " + std::to_string(i) +
                       " has a mean or a harmonic that is not finite");
    }
    // Centred on the camera: no ray has its nearest point ahead, and no direction to shade it by.
    if (s.relative.isZero(0.0) && !view.is_parallel) continue;
    const double z = pose.rotation.row(2) * s.relative;
    if (!(z >= settings.rule.near_z && z <= settings.rule.far_z)) continue;
    const bool by_distance = settings.rule.order == OrderKey::kDistance && !view.is_parallel;
    s.key = static_cast<float>(by_distance ? s.relative.norm() : z);
    const Vector3d scale = Eigen::Map<const Vector3d>(g.log_scales + 3 * i).array().exp();
    s.whiten = scale.cwiseInverse().asDiagonal() * Rotation(g.quats + 4 * i).transpose();
    s.whitened = s.whiten * s.relative;
    s.opacity = Sigmoid(g.opacity_logits[i]);
    if (!(scale.allFinite() && s.whiten.allFinite() && s.whitened.allFinite() &&
          std::isfinite(s.opacity))) {
      throw InputError("Gaussian " + std::to_string(i) +
                       " has a quaternion, scale or opacity that is not finite");
    }
    s.direction = view.is_parallel ? Vector3d(pose.rotation.row(2)) : s.relative.normalized();
    double basis[kMaxShCoefficients];
    HarmonicsBasis(ShDegree(used), s.direction.x(), s.direction.y(), s.direction.z(), basis);
    for (int c = 0; c < 3; ++c) {
      double value = 0.5;
      for (int k = 0; k < used; ++k) value += basis[k] * sh[3 * k + c];
      s.clamped[c] = !(value > 0.0);
      s.color[c] = s.clamped[c] ? 0.0 : value;
    }
    seen.push_back(s);
  }
  std::stable_sort(seen.begin(), seen.end(),
                   [](const Seen& a, const Seen& b) { return a.key < b.key; });
  return seen;
}

// A pixel's ray in world axes, its origin relative to the reference's centre.
struct Ray {
  Vector3d origin, direction;
};

Ray RayOf(const ViewRays& view, std::size_t pixel) {
  const Matrix3d& rotation = view.reference.rotation;
  Ray ray{Vector3d::Zero(),
          rotation.transpose() * Eigen::Map<const Vector3d>(&view.rays[3 * pixel])};
  if (view.HasOrigins()) {
    ray.origin = rotation.transpose() * Eigen::Map<const Vector3d>(&view.origins[3 * pixel]);
  }
  return ray;
}

// Blends all Gaussians along one ray; fills hits and returns the final transmittance.
// Along o + t d the exponent |A (m - o) - t A d|^2 is least at t = v.w / |w|^2, v = A (m - o) and w
// = A d. A Gaussian whose nearest point lies behind the origin is not drawn.
double Blend(const std::vector<Seen>& seen, const Ray& ray, const BlendRule& rule,
             std::vector<Hit>* hits) {
  hits->clear();
  double transmittance = 1.0;
  for (std::size_t j = 0; j < seen.size(); ++j) {
    const Seen& s = seen[j];
    const Vector3d w = s.whiten * ray.direction;
    const Vector3d whitened = s.whitened - s.whiten * ray.origin;
    const double t = whitened.dot(w) / w.squaredNorm();
    if (!(t > 0.0)) continue;
    const Vector3d residual = whitened - t * w;
    const double response = std::exp(-0.5 * residual.squaredNorm());
    if (!(response > rule.response_min)) continue;
    const double raw = s.opacity * response;
    const bool clamped = raw > rule.alpha_max;
    const double alpha = clamped ? rule.alpha_max : raw;
    if (!(alpha >= rule.alpha_min)) continue;
    const double next = transmittance * (1.0 - alpha);
    if (rule.stop_before && next <= rule.transmittance_min) break;
    hits->push_back({j, alpha, response, alpha * transmittance, t, clamped});
    transmittance = next;
    if (!rule.stop_before && next < rule.transmittance_min) break;
  }
  return transmittance;
}

// Coverage and mean distance of a pixel, which its distortion is about.
struct MeanDistance {
  double alpha = 0, mean = 0;

  explicit MeanDistance(const std::vector<Hit>& hits) {
    for (const Hit& hit : hits) {
      alpha += hit.weight;
      mean += hit.weight * hit.t;
    }
    if (alpha > 0.0) mean /= alpha;
  }
  bool Counts() const { return alpha >= kDistortionAlpha; }
};

// Sums over pixels of one Gaussian's gradient, in the world frame.
struct GradientSums {
  Matrix3d whiten = Matrix3d::Zero();
  Vector3d whitened = Vector3d::Zero();  // to A m, chained to mean and whiten at the end
  double opacity = 0;
  Vector3d color = Vector3d::Zero();
};

// Of the loss to what a pixel shows, and to its ray in the world frame.
struct ShownGradient {
  Vector3d color;
  double alpha, depth, distortion;
};
struct PixelGradient {
  Vector3d ray = Vector3d::Zero(), origin = Vector3d::Zero();
};

// With w = A d, v = A (m - o), t = v.w / |w|^2 and residual r = v - t w, which is across w:
//   D^2 = |r|^2:  dD^2/dv = 2 r,  dD^2/dw = -2 t r;
//   t:            dt/dv = w / |w|^2,  dt/dw = (v - 2 t w) / |w|^2.
// The blend itself is taken back to front: T_i = T_(i+1) / (1 - alpha_i), see
// raster/blend_backward-inl.h for v_i and B_i.
// Adds one pixel's gradients to the sums of what it sees; hits, transmittance: of Blend.
PixelGradient BackwardPixel(const std::vector<Seen>& seen, const Ray& ray,
                            const std::vector<Hit>& hits, double transmittance,
                            const Vector3d& background, const ShownGradient& from,
                            std::vector<GradientSums>* sums) {
  // What lies behind the current Gaussian, as seen by L: starts with the background.
  double behind = transmittance * (from.color.dot(background) - from.alpha);
  PixelGradient out;
  const MeanDistance about(hits);
  const double g_distortion = about.Counts() ? from.distortion : 0.0;
  double after = transmittance;
  for (std::size_t h = hits.size(); h-- > 0;) {
    const Hit& hit = hits[h];
    const Seen& s = seen[hit.seen];
    GradientSums& gs = (*sums)[hit.seen];
    const double before = after / (1.0 - hit.alpha);
    // The mean is where the distortion is least: it counts as a constant.
    const double apart = hit.t - about.mean;
    const double value =
        from.color.dot(s.color) + from.depth * hit.t + g_distortion * apart * apart;
    const double g_this_alpha = before * value - behind / (1.0 - hit.alpha);
    behind += hit.weight * value;
    after = before;
    gs.color += hit.weight * from.color;
    const double g_raw = hit.clamped ? 0.0 : g_this_alpha;
    gs.opacity += g_raw * hit.response;
    const double v = -0.5 * g_raw * s.opacity * hit.response;                 // dL/dD^2
    const double e = hit.weight * (from.depth + 2.0 * g_distortion * apart);  // dL/dt
    const Vector3d w = s.whiten * ray.direction;
    const Vector3d whitened = s.whitened - s.whiten * ray.origin;
    const double w2 = w.squaredNorm();
    const Vector3d residual = whitened - hit.t * w;
    const Vector3d g_whitened = 2.0 * v * residual + (e / w2) * w;
    const Vector3d g_w = -2.0 * v * hit.t * residual + (e / w2) * (whitened - 2.0 * hit.t * w);
    gs.whitened += g_whitened;
    gs.whiten += g_w * ray.direction.transpose() - g_whitened * ray.origin.transpose();
    out.ray += s.whiten.transpose() * g_w;
    out.origin -= s.whiten.transpose() * g_whitened;
  }
  return out;
}

// From the sums over a Gaussian's pixels to its parameters; used: coefficients of the harmonics.
void WriteGradients(const Seen& s, GradientSums total, const GaussiansView<const double>& gaussians,
                    int used, bool is_parallel, const GaussiansView<double>& gradients,
                    ShadingGradient* shading) {
  const std::int64_t i = s.index;
  // v = A m: what the sum holds of v goes on to m by A^T, and to A by the outer product with m.
  total.whiten += total.whitened * s.relative.transpose();
  Vector3d g_relative = s.whiten.transpose() * total.whitened;

  // Colour: harmonics in the direction from the camera to the mean.
  const Vector3d& direction = s.direction;
  double basis[kMaxShCoefficients];
  double g_basis[kMaxShCoefficients] = {};
  HarmonicsBasis(ShDegree(used), direction.x(), direction.y(), direction.z(), basis);
  for (int c = 0; c < 3; ++c) {
    if (s.clamped[c]) continue;
    for (int k = 0; k < used; ++k) {
      gradients.sh[(i * gradients.sh_coefficients + k) * 3 + c] = basis[k] * total.color[c];
      g_basis[k] += gaussians.sh[(i * gradients.sh_coefficients + k) * 3 + c] * total.color[c];
    }
  }
  Vector3d g_direction;
  HarmonicsBasisGradient(ShDegree(used), direction.x(), direction.y(), direction.z(), g_basis,
                         g_direction.data());
  if (is_parallel) {
    shading->axis += g_direction;
  } else {
    const Vector3d by_direction =
        (g_direction - direction * direction.dot(g_direction)) / s.relative.norm();
    g_relative += by_direction;
    shading->center -= by_direction;
  }

  Eigen::Map<Vector3d>(gradients.means + 3 * i) = g_relative;
  gradients.opacity_logits[i] = total.opacity * s.opacity * (1.0 - s.opacity);
  // A = S^-1 R^T: row k of A is column k of R divided by the scale k.
  Matrix3d g_rotation;
  for (int k = 0; k < 3; ++k) {
    gradients.log_scales[3 * i + k] = -total.whiten.row(k).dot(s.whiten.row(k));
    g_rotation.col(k) =
        total.whiten.row(k).transpose() * std::exp(-gaussians.log_scales[3 * i + k]);
  }
  const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> g_rotation_rows = g_rotation;
  RotationFromQuaternionBackward(gaussians.quats + 4 * i, g_rotation_rows.data(),
                                 gradients.quats + 4 * i);
}

}  // namespace

ReferenceImage RenderReference(const GaussiansView<const double>& gaussians, const ViewRays& view,
                               const RenderSettings& settings, const std::uint8_t* chosen) {
  const std::vector<Seen> seen = SortedGaussians(gaussians, view, settings);
  const std::int64_t pixels = static_cast<std::int64_t>(view.width) * view.height;
  ReferenceImage out;
  out.image.assign(static_cast<std::size_t>(3 * pixels), 0.0);
  out.alpha.assign(static_cast<std::size_t>(pixels), 0.0);
  out.depth.assign(static_cast<std::size_t>(pixels), 0.0);
  out.distortion.assign(static_cast<std::size_t>(pixels), 0.0);
  out.samples.assign(static_cast<std::size_t>(pixels), 0);
  ParallelFor(pixels, view.width, [&](std::int64_t begin, std::int64_t end) {
    std::vector<Hit> hits;
    for (std::int64_t pixel = begin; pixel < end; ++pixel) {
      const std::size_t p = static_cast<std::size_t>(pixel);
      if (!view.valid[p] || (chosen != nullptr && !chosen[p])) continue;
      const double transmittance = Blend(seen, RayOf(view, p), settings.rule, &hits);
      Vector3d color = Vector3d::Zero();
      for (const Hit& hit : hits) {
        color += hit.weight * seen[hit.seen].color;
        out.depth[p] += hit.weight * hit.t;
      }
      for (int c = 0; c < 3; ++c) {
        out.image[3 * p + c] = color[c] + transmittance * settings.background[c];
      }
      const MeanDistance about(hits);
      for (std::size_t h = 0; about.Counts() && h < hits.size(); ++h) {
        const double apart = hits[h].t - about.mean;
        out.distortion[p] += hits[h].weight * apart * apart;
      }
      out.alpha[p] = 1.0 - transmittance;
      out.samples[p] = static_cast<int>(hits.size());
    }
  });
  return out;
}

ReferenceImage RenderReference(const GaussiansView<const double>& gaussians, const Camera& camera,
                               const CameraMotion& motion, const RenderSettings& settings,
                               const std::uint8_t* chosen) {
  return RenderReference(gaussians, MakeViewRays(camera, motion), settings, chosen);
}

void RenderReferenceBackward(const GaussiansView<const double>& gaussians, const ViewRays& view,
                             const RenderSettings& settings, const ReferenceGradients& to_image,
                             const GaussiansView<double>& gradients, RayGradients* ray_gradients,
                             ShadingGradient* shading, const std::uint8_t* chosen) {
  const std::vector<Seen> seen = SortedGaussians(gaussians, view, settings);
  const int height = view.height;
  const int width = view.width;
  const Matrix3d& rotation = view.reference.rotation;
  const Vector3d background(settings.background[0], settings.background[1], settings.background[2]);
  ray_gradients->origins.assign(3 * view.valid.size(), 0.0);
  ray_gradients->rays.assign(3 * view.valid.size(), 0.0);

  std::vector<std::vector<GradientSums>> sums(kBackwardBands);
  ParallelFor(kBackwardBands, 1, [&](std::int64_t band, std::int64_t) {
    std::vector<GradientSums>& sum = sums[static_cast<std::size_t>(band)];
    sum.resize(seen.size());
    std::vector<Hit> hits;
    const int row_begin = static_cast<int>(height * band / kBackwardBands);
    const int row_end = static_cast<int>(height * (band + 1) / kBackwardBands);
    for (int row = row_begin; row < row_end; ++row) {
      for (int column = 0; column < width; ++column) {
        const std::size_t p = static_cast<std::size_t>(row) * width + column;
        if (!view.valid[p] || (chosen != nullptr && !chosen[p])) continue;
        const Ray ray = RayOf(view, p);
        const double transmittance = Blend(seen, ray, settings.rule, &hits);
        const auto to = [p](const double* gradient) { return gradient ? gradient[p] : 0.0; };
        const ShownGradient shown = {Eigen::Map<const Vector3d>(to_image.image + 3 * p),
                                     to(to_image.alpha), to(to_image.depth),
                                     to(to_image.distortion)};
        const PixelGradient g =
            BackwardPixel(seen, ray, hits, transmittance, background, shown, &sum);
        Eigen::Map<Vector3d>(&ray_gradients->rays[3 * p]) = rotation * g.ray;
        Eigen::Map<Vector3d>(&ray_gradients->origins[3 * p]) = rotation * g.origin;
      }
    }
  });

  const std::int64_t n = gradients.size;
  const int k_all = gradients.sh_coefficients;
  std::fill_n(gradients.means, 3 * n, 0.0);
  std::fill_n(gradients.quats, 4 * n, 0.0);
  std::fill_n(gradients.log_scales, 3 * n, 0.0);
  std::fill_n(gradients.opacity_logits, n, 0.0);
  std::fill_n(gradients.sh, 3 * k_all * n, 0.0);
  const int used = UsedCoefficients(k_all, settings.sh_degree);
  *shading = ShadingGradient();
  for (std::size_t j = 0; j < seen.size(); ++j) {
    GradientSums total;
    for (const std::vector<GradientSums>& sum : sums) {
      total.whiten += sum[j].whiten;
      total.whitened += sum[j].whitened;
      total.opacity += sum[j].opacity;
      total.color += sum[j].color;
    }
    WriteGradients(seen[j], total, gaussians, used, view.is_parallel, gradients, shading);
  }
}

void RenderReferenceBackward(const GaussiansView<const double>& gaussians, const Camera& camera,
                             const CameraMotion& motion, const RenderSettings& settings,
                             const ReferenceGradients& to_image,
                             const GaussiansView<double>& gradients, double* dpose,
                             RayGradients* rays, const std::uint8_t* chosen) {
  const ViewRays view = MakeViewRays(camera, motion);
  RayGradients of_view;
  if (rays == nullptr) rays = &of_view;
  ShadingGradient shading;
  RenderReferenceBackward(gaussians, view, settings, to_image, gradients, rays, &shading, chosen);
  ChainToPoses(view, camera, motion, *rays, shading, dpose);
}

}  // namespace gsut
