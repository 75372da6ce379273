// Seeded Gaussians that a camera sees, in float and double alike, and a small camera of each lens.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "gsut/base/rng.h"
#include "gsut/cameras/camera.h"
#include "gsut/gaussians/gaussians.h"
#include "gsut/geometry/pose.h"

namespace gsut::testing_scenes {

// Arrays that own what a GaussiansView points to.
template <class T>
struct OwnedGaussians {
  std::vector<T> means, quats, log_scales, opacity_logits, sh;
  int sh_coefficients = 1;

  explicit OwnedGaussians(std::int64_t n, int coefficients = 1)
      : means(static_cast<std::size_t>(3 * n)),
        quats(static_cast<std::size_t>(4 * n)),
        log_scales(static_cast<std::size_t>(3 * n)),
        opacity_logits(static_cast<std::size_t>(n)),
        sh(static_cast<std::size_t>(3 * coefficients * n)),
        sh_coefficients(coefficients) {}

  std::int64_t size() const { return static_cast<std::int64_t>(opacity_logits.size()); }
  GaussiansView<const T> View() const {
    return {size(),       sh_coefficients,   means.data(),
            quats.data(), log_scales.data(), opacity_logits.data(),
            sh.data()};
  }
  GaussiansView<T> MutableView() {
    return {size(),       sh_coefficients,   means.data(),
            quats.data(), log_scales.data(), opacity_logits.data(),
            sh.data()};
  }
};

// The same numbers in double.
inline OwnedGaussians<double> ToDouble(const OwnedGaussians<float>& g) {
  OwnedGaussians<double> out(g.size(), g.sh_coefficients);
  std::copy(g.means.begin(), g.means.end(), out.means.begin());
  std::copy(g.quats.begin(), g.quats.end(), out.quats.begin());
  std::copy(g.log_scales.begin(), g.log_scales.end(), out.log_scales.begin());
  std::copy(g.opacity_logits.begin(), g.opacity_logits.end(), out.opacity_logits.begin());
  std::copy(g.sh.begin(), g.sh.end(), out.sh.begin());
  return out;
}

// What the Gaussians of a scene look like; sizes are standard deviations over the distance.
struct SceneKind {
  const char* name;
  double nearest, farthest;
  double smallest, largest;
  double aspect;         // standard deviation of the logarithm of each axis about the size
  double opacity_logit;  // mean; standard deviation 1.5
};

// Numbers of one stream, one after the other.
class Draws {
 public:
  Draws(std::uint64_t seed, std::uint64_t stream) : rng_(seed, stream) {}
  double Uniform(double low, double high) { return low + (high - low) * rng_.Uniform(next_++); }
  double LogUniform(double low, double high) {
    return std::exp(Uniform(std::log(low), std::log(high)));
  }
  double Normal() { return rng_.Normals(next_++)[0]; }
  std::int64_t Index(std::int64_t count) {
    return static_cast<std::int64_t>(Uniform(0.0, 1.0) * static_cast<double>(count));
  }

 private:
  Rng rng_;
  std::uint64_t next_ = 0;
};

inline Pose RandomPose(Draws* draws) {
  Eigen::Matrix<double, 6, 1> xi;
  for (int k = 0; k < 3; ++k) xi[k] = draws->Normal();
  for (int k = 3; k < 6; ++k) xi[k] = draws->Uniform(-2.0, 2.0);
  return ExpPose(xi);
}

// Means on rays of the camera's valid pixels, moved a little.
inline OwnedGaussians<float> GaussiansInView(const Camera& camera, const Pose& camera_from_world,
                                             std::int64_t n, const SceneKind& kind, Draws* draws) {
  const RayTable& table = camera.Rays();
  std::vector<std::size_t> pixels;
  for (std::size_t p = 0; p < table.valid.size(); ++p) {
    if (table.valid[p]) pixels.push_back(p);
  }
  OwnedGaussians<float> g(n);
  for (std::int64_t i = 0; i < n; ++i) {
    const std::size_t row = static_cast<std::size_t>(i);
    const std::size_t pixel =
        pixels[static_cast<std::size_t>(draws->Index(static_cast<std::int64_t>(pixels.size())))];
    Eigen::Vector3d ray = Eigen::Map<const Eigen::Vector3d>(&table.rays[3 * pixel]);
    for (int k = 0; k < 3; ++k) ray[k] += 0.02 * draws->Normal();
    const double distance = draws->LogUniform(kind.nearest, kind.farthest);
    const double size = distance * draws->LogUniform(kind.smallest, kind.largest);
    const Eigen::Vector3d mean =
        camera_from_world.rotation.transpose() * (ray * distance - camera_from_world.translation);
    for (std::size_t k = 0; k < 3; ++k) {
      g.means[3 * row + k] = static_cast<float>(mean[static_cast<int>(k)]);
      g.log_scales[3 * row + k] =
          static_cast<float>(std::log(size) + kind.aspect * draws->Normal());
      g.sh[3 * row + k] = static_cast<float>(0.5 + 0.3 * draws->Normal());
    }
    for (std::size_t k = 0; k < 4; ++k) {
      g.quats[4 * row + k] = static_cast<float>(draws->Normal());
    }
    g.opacity_logits[row] = static_cast<float>(kind.opacity_logit + 1.5 * draws->Normal());
  }
  return g;
}

// A lens of the build, shrunk to `width` pixels (three times that for panoramas, whose tiles would
// span more than a hemisphere).
struct NamedCamera {
  std::string name;
  Camera camera;
};

inline std::vector<NamedCamera> EveryLens(int width) {
  constexpr double kPanoramaCosine = -0.4;
  std::vector<NamedCamera> cameras;
  for (const std::string& name : LensNames()) {
    int number = 0;
    for (const LensExample& example : LensExamples(LensFromName(name))) {
      const Camera whole(name, {example.params, example.params + example.num_params}, example.width,
                         example.height);
      if (!whole.IsCentral()) continue;  // rendered by lines: tests/python/render/test_lines.py
      const auto shrunk = [&](int columns) {
        return whole.Resized(columns, std::max(1, columns * example.height / example.width));
      };
      Camera camera = shrunk(width);
      const RayTable& rays = camera.Rays();
      double lowest = 1.0;
      for (std::size_t p = 0; p < rays.valid.size(); ++p) {
        if (rays.valid[p]) lowest = std::min(lowest, rays.rays[3 * p + 2]);
      }
      if (lowest < kPanoramaCosine) camera = shrunk(3 * width);
      cameras.push_back({name + "[" + std::to_string(number++) + "]", camera});
    }
  }
  return cameras;
}

}  // namespace gsut::testing_scenes
