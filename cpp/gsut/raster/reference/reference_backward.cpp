// The backward pass of the scalar double renderer, ray by ray from the last Gaussian to the first.
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "gsut/base/check_arguments.h"
#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/gaussians/activations.h"
#include "gsut/gaussians/check_gaussians.h"
#include "gsut/gaussians/harmonics.h"
#include "gsut/raster/reference/blend_ray.h"
#include "gsut/raster/reference/integral.h"
#include "gsut/raster/reference/reference.h"

namespace gsut {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// Number of row bands of the backward pass: fixed, so that sums have one order on any thread count.
constexpr int kBackwardBands = 8;

// Sums over pixels of one Gaussian's gradient, in the world frame.
struct GradientSums {
  Matrix3d whiten = Matrix3d::Zero();
  Vector3d whitened = Vector3d::Zero();  // to A m, chained to mean and whiten at the end
  double strength = 0;
  double log_mean_scale = 0;  // to the logarithm of Seen::mean_scale
  Vector3d color = Vector3d::Zero();
  Eigen::VectorXd channels;
};

// Of the loss to what a pixel shows, and to its ray in the world frame.
struct ShownGradient {
  Vector3d color;
  double alpha, depth, distortion;
  Eigen::VectorXd channels;
};
struct PixelGradient {
  Vector3d ray = Vector3d::Zero(), origin = Vector3d::Zero();
};

// With w = A d, v = A (m - o), t = v.w / |w|^2 and residual r = v - t w (Passing, which has what
// triangles have in place of these):
//   D^2 = |r|^2:  dD^2/dv = 2 r,  dD^2/dw = -2 t r, and dln f/dD^2 is Profile::Slope over -2;
//   t:            dt/dv = w / |w|^2,  dt/dw = (v - 2 t w) / |w|^2.
// The blend itself is taken back to front: T_i = T_(i+1) / (1 - alpha_i), see
// raster/blend_backward-inl.h for v_i and B_i.
// Adds one pixel's gradients to the sums of what it sees; hits, transmittance: of Blend.
PixelGradient BackwardPixel(const std::vector<Seen>& seen, const Ray& ray,
                            const std::vector<Hit>& hits, double transmittance, Response response,
                            const Vector3d& background, const Channels<double>& channels,
                            const ShownGradient& from, std::vector<GradientSums>* sums) {
  using Eigen::Map;
  using Eigen::VectorXd;
  // What lies behind the current Gaussian, as seen by L: starts with the background.
  double behind = transmittance * (from.color.dot(background) - from.alpha);
  if (channels.count > 0) {
    behind +=
        transmittance * from.channels.dot(Map<const VectorXd>(channels.background, channels.count));
  }
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
    double value = from.color.dot(s.color) + from.depth * hit.t + g_distortion * apart * apart;
    if (channels.count > 0) {
      value += from.channels.dot(
          Map<const VectorXd>(channels.values + s.index * channels.count, channels.count));
      gs.channels += hit.weight * from.channels;
    }
    const double g_this_alpha = before * value - behind / (1.0 - hit.alpha);
    behind += hit.weight * value;
    after = before;
    gs.color += hit.weight * from.color;
    const double g_raw = hit.clamped ? 0.0 : g_this_alpha * AlphaSlope(response, hit.alpha);
    gs.strength += g_raw * hit.response;
    const Passing at(s, ray);
    double g_log = g_raw * s.strength * hit.response;  // dL/dln raw
    if (!s.profile.IsGaussian()) g_log *= s.profile.Slope(at.d2);
    double e = hit.weight * (from.depth + 2.0 * g_distortion * apart);  // dL/dt
    Vector3d g_w = Vector3d::Zero();
    if (response == Response::kDensity) {
      // raw holds |d| / (|w| mean_scale) P(u), u = t |w|, P the normal distribution.
      const double u = hit.t / at.Width();
      const double hazard = NormalDensity(u) / NormalCdf(u);
      e += g_log * hazard / at.Width();
      g_w = g_log * (hazard * u - 1.0) / at.w2 * at.w;
      out.ray += g_log / ray.direction.squaredNorm() * ray.direction;
      gs.log_mean_scale -= g_log;
    }
    const Vector3d g_whitened = -g_log * at.pull + e * at.t_by_v;
    g_w += g_log * hit.t * at.pull + e * at.t_by_w;
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
  gradients.opacity_logits[i] = total.strength * gaussians.StrengthSlope(s.strength);
  // A = S^-1 R^T: row k of A is column k of R divided by the scale k.
  Matrix3d g_rotation;
  for (int k = 0; k < 3; ++k) {
    const double scale = gaussians.Scale(i, k);
    const double to_log_scale = total.log_mean_scale * s.mean_scale / (3.0 * scale) -
                                total.whiten.row(k).dot(s.whiten.row(k));
    gradients.log_scales[3 * i + k] = to_log_scale * gaussians.LogScaleSlope(scale);
    g_rotation.col(k) = total.whiten.row(k).transpose() / scale;
  }
  const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> g_rotation_rows = g_rotation;
  RotationFromQuaternionBackward(gaussians.quats + 4 * i, g_rotation_rows.data(),
                                 gradients.quats + 4 * i);
}

}  // namespace

void RenderReferenceBackward(const GaussiansView<const double>& gaussians, const ViewRays& view,
                             const RenderSettings& settings, const ReferenceGradients& to_image,
                             const GaussiansView<double>& gradients, RayGradients* ray_gradients,
                             ShadingGradient* shading, const std::uint8_t* chosen) {
  const BlendRule rule = settings.rule.For(gaussians.order);
  if (rule.order == OrderKey::kIntegral) {
    throw InputError("order \"integral\" has no gradient; with one: distance, z, ray");
  }
  CheckGiven(to_image.image, "gradient to the image");
  CheckGradients(gradients, gaussians);
  CheckGiven(ray_gradients, "rays");
  CheckGiven(shading, "shading");
  to_image.channels.Check(gaussians.size);
  if (to_image.channels.count > 0) {
    CheckGiven(to_image.channel_image, "gradient to the channels' image");
    CheckArray(to_image.to_channels, gaussians.size, "gradient to the channels");
  }
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
    const Channels<double>& channels = to_image.channels;
    for (GradientSums& of_one : sum) of_one.channels.setZero(channels.count);
    std::vector<Hit> hits;
    const int row_begin = static_cast<int>(height * band / kBackwardBands);
    const int row_end = static_cast<int>(height * (band + 1) / kBackwardBands);
    for (int row = row_begin; row < row_end; ++row) {
      for (int column = 0; column < width; ++column) {
        const std::size_t p = static_cast<std::size_t>(row) * width + column;
        if (!view.valid[p] || (chosen != nullptr && !chosen[p])) continue;
        const Ray ray = RayOf(view, p);
        const double transmittance = Blend(seen, ray, rule, gaussians.response, &hits);
        const auto to = [p](const double* gradient) { return gradient ? gradient[p] : 0.0; };
        ShownGradient shown = {Eigen::Map<const Vector3d>(to_image.image + 3 * p),
                               to(to_image.alpha),
                               to(to_image.depth),
                               to(to_image.distortion),
                               {}};
        if (channels.count > 0) {
          shown.channels = Eigen::Map<const Eigen::VectorXd>(
              to_image.channel_image + p * static_cast<std::size_t>(channels.count),
              channels.count);
        }
        const PixelGradient g = BackwardPixel(seen, ray, hits, transmittance, gaussians.response,
                                              background, channels, shown, &sum);
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
  const int num_channels = to_image.channels.count;
  std::fill_n(to_image.to_channels, num_channels * n, 0.0);
  const int used = UsedCoefficients(k_all, settings.sh_degree);
  *shading = ShadingGradient();
  for (std::size_t j = 0; j < seen.size(); ++j) {
    GradientSums total;
    Eigen::Map<Eigen::VectorXd> to_channels(to_image.to_channels + seen[j].index * num_channels,
                                            num_channels);
    for (const std::vector<GradientSums>& sum : sums) {
      total.whiten += sum[j].whiten;
      total.whitened += sum[j].whitened;
      total.strength += sum[j].strength;
      total.log_mean_scale += sum[j].log_mean_scale;
      total.color += sum[j].color;
      to_channels += sum[j].channels;
    }
    WriteGradients(seen[j], total, gaussians, used, view.is_parallel, gradients, shading);
  }
}

void RenderReferenceBackward(const GaussiansView<const double>& gaussians, const Camera& camera,
                             const CameraMotion& motion, const RenderSettings& settings,
                             const ReferenceGradients& to_image,
                             const GaussiansView<double>& gradients, double* dpose,
                             RayGradients* rays, const std::uint8_t* chosen) {
  CheckGiven(dpose, "dpose");
  const ViewRays view = MakeViewRays(camera, motion);
  RayGradients of_view;
  if (rays == nullptr) rays = &of_view;
  ShadingGradient shading;
  RenderReferenceBackward(gaussians, view, settings, to_image, gradients, rays, &shading, chosen);
  ChainToPoses(view, camera, motion, *rays, shading, dpose);
}

}  // namespace gsut
