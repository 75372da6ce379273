// The scalar double renderer: formulae as in the paper of 3DGUT, section 4,
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
#include "gsut/gaussians/check_gaussians.h"
#include "gsut/gaussians/harmonics.h"
#include "gsut/raster/reference/blend_ray.h"
#include "gsut/raster/reference/integral.h"

namespace gsut {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

Eigen::Matrix<double, 3, 3> Rotation(const double* quat) {
  double r[9];
  RotationFromQuaternion(quat, r);
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(r);
}

}  // namespace

int UsedCoefficients(int sh_coefficients, int sh_degree) {
  return std::min(sh_coefficients, (sh_degree + 1) * (sh_degree + 1));
}

std::vector<Seen> SortedGaussians(const GaussiansView<const double>& g, const ViewRays& view,
                                  const RenderSettings& settings) {
  const BlendRule rule = settings.rule.For(g.order);
  CheckGaussians(g);
  CheckViewRays(view);
  settings.Check();
  if (g.is_linear && g.response != Response::kMaximum) {
    throw InputError("linear opacities are drawn by the maximum only");
  }
  if (g.primitive != Primitive::kGaussian &&
      (g.response == Response::kDensity || rule.order == OrderKey::kIntegral)) {
    throw InputError(std::string("primitive \"") + NameOf(g.primitive) +
                     "\" has no density along a ray: response \"density\" and order \"integral\" "
                     "are a Gaussian's; with it: maximum, extinction and distance, z, ray");
  }
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
    if (!(z >= rule.near_z && z <= rule.far_z)) continue;
    const bool by_distance = rule.order != OrderKey::kDepthZ && !view.is_parallel;
    s.key = static_cast<float>(by_distance ? s.relative.norm() : z);
    Vector3d scale(g.log_scales + 3 * i);
    if (!g.is_linear) scale = scale.array().exp().matrix();
    if (g.is_linear && scale.minCoeff() == 0.0) continue;  // without extent: not drawn
    s.whiten = scale.cwiseInverse().asDiagonal() * Rotation(g.quats + 4 * i).transpose();
    s.whitened = s.whiten * s.relative;
    s.mean_scale = 3.0 / scale.cwiseInverse().sum();
    s.strength = g.Strength(i);
    s.profile = Profile{g.primitive};
    if (!(scale.allFinite() && s.whiten.allFinite() && s.whitened.allFinite() &&
          std::isfinite(s.strength))) {
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

Ray RayOf(const ViewRays& view, std::size_t pixel) {
  const Matrix3d& rotation = view.reference.rotation;
  Ray ray{Vector3d::Zero(),
          rotation.transpose() * Eigen::Map<const Vector3d>(&view.rays[3 * pixel])};
  if (view.HasOrigins()) {
    ray.origin = rotation.transpose() * Eigen::Map<const Vector3d>(&view.origins[3 * pixel]);
  }
  return ray;
}

double ResponseOfLine(const Seen& s, const Ray& ray, const Passing& at, Response response) {
  if (response != Response::kDensity) return at.peak;
  return at.peak * at.Width() * ray.direction.norm() / s.mean_scale;
}

namespace {

// Whether a Gaussian is drawn, and what it takes of the ray's light. One whose nearest point lies
// behind the origin is not drawn.
bool Meet(const Seen& s, const Ray& ray, const BlendRule& rule, Response response, Hit* hit) {
  const Passing at(s, ray);
  hit->t = at.t;
  if (!(at.t > 0.0 && at.peak > rule.response_min)) return false;
  hit->response = ResponseOfLine(s, ray, at, response);
  if (response == Response::kDensity) hit->response *= NormalCdf(at.t / at.Width());
  const double alpha = AlphaOf(response, s.strength * hit->response);
  hit->clamped = alpha > rule.alpha_max;
  hit->alpha = hit->clamped ? rule.alpha_max : alpha;
  return hit->alpha >= rule.alpha_min;
}

}  // namespace

double Blend(const std::vector<Seen>& seen, const Ray& ray, const BlendRule& rule,
             Response response, std::vector<Hit>* hits) {
  hits->clear();
  if (rule.order == OrderKey::kIntegral) return Integrate(seen, ray, rule, response, hits);
  double transmittance = 1.0;
  const auto blend = [&](Hit hit) {  // whether the next one is blended
    const double next = transmittance * (1.0 - hit.alpha);
    if (rule.stop_before && next <= rule.transmittance_min) return false;
    hit.weight = hit.alpha * transmittance;
    hits->push_back(hit);
    transmittance = next;
    return rule.stop_before || !(next < rule.transmittance_min);
  };
  std::vector<Hit> met;
  Hit hit = {};
  for (hit.seen = 0; hit.seen < seen.size(); ++hit.seen) {
    if (!Meet(seen[hit.seen], ray, rule, response, &hit)) continue;
    if (rule.order == OrderKey::kRay) {
      met.push_back(hit);
    } else if (!blend(hit)) {
      break;
    }
  }
  std::stable_sort(met.begin(), met.end(), [](const Hit& a, const Hit& b) { return a.t < b.t; });
  for (const Hit& next : met) {
    if (!blend(next)) break;
  }
  return transmittance;
}

ReferenceImage RenderReference(const GaussiansView<const double>& gaussians, const ViewRays& view,
                               const RenderSettings& settings, const std::uint8_t* chosen,
                               const Channels<double>& channels) {
  channels.Check(gaussians.size);
  const BlendRule rule = settings.rule.For(gaussians.order);
  const std::vector<Seen> seen = SortedGaussians(gaussians, view, settings);
  const std::int64_t pixels = static_cast<std::int64_t>(view.width) * view.height;
  ReferenceImage out;
  out.image.assign(static_cast<std::size_t>(3 * pixels), 0.0);
  out.alpha.assign(static_cast<std::size_t>(pixels), 0.0);
  out.depth.assign(static_cast<std::size_t>(pixels), 0.0);
  out.distortion.assign(static_cast<std::size_t>(pixels), 0.0);
  out.samples.assign(static_cast<std::size_t>(pixels), 0);
  const auto num_channels = static_cast<std::size_t>(channels.count);
  out.channels.assign(static_cast<std::size_t>(pixels) * num_channels, 0.0);
  ParallelFor(pixels, view.width, [&](std::int64_t begin, std::int64_t end) {
    std::vector<Hit> hits;
    for (std::int64_t pixel = begin; pixel < end; ++pixel) {
      const std::size_t p = static_cast<std::size_t>(pixel);
      if (!view.valid[p] || (chosen != nullptr && !chosen[p])) continue;
      const double transmittance = Blend(seen, RayOf(view, p), rule, gaussians.response, &hits);
      Vector3d color = Vector3d::Zero();
      for (const Hit& hit : hits) {
        color += hit.weight * seen[hit.seen].color;
        out.depth[p] += hit.weight * hit.t;
      }
      for (std::size_t k = 0; k < num_channels; ++k) {
        double& sum = out.channels[p * num_channels + k];
        for (const Hit& hit : hits) {
          sum += hit.weight *
                 channels.values[static_cast<std::size_t>(seen[hit.seen].index) * num_channels + k];
        }
        sum += transmittance * channels.background[k];
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
                               const std::uint8_t* chosen, const Channels<double>& channels) {
  return RenderReference(gaussians, MakeViewRays(camera, motion), settings, chosen, channels);
}

}  // namespace gsut
