// Finds a camera's pose again by the gradient of an image to it, through a fisheye lens.
#include <gsut/cameras/camera.h>
#include <gsut/geometry/pose.h>
#include <gsut/raster/render.h>

#include <cmath>
#include <cstdio>
#include <random>
#include <vector>

using Vector6 = Eigen::Matrix<double, 6, 1>;  // (shift, turn), as ExpPose takes it

int main() {
  constexpr int kCount = 400, kWidth = 96, kHeight = 96, kSteps = 300;
  std::mt19937 random(1);
  std::uniform_real_distribution<float> between(-1.0f, 1.0f);
  std::vector<float> means, quats, log_scales(3 * kCount, std::log(0.15f)),
      opacity_logits(kCount, 1.0f), sh;
  for (int i = 0; i < kCount; ++i) {
    for (const float shift : {0.0f, 0.0f, 3.0f}) means.push_back(2.0f * between(random) + shift);
    for (int k = 0; k < 4; ++k) quats.push_back(between(random));
    for (int k = 0; k < 3; ++k) sh.push_back(2.0f * between(random));
  }
  const gsut::GaussiansView<const float> scene = {
      kCount, 1, means.data(), quats.data(), log_scales.data(), opacity_logits.data(), sh.data()};
  // Where the gradients go: arrays like the Gaussians'.
  std::vector<float> dmeans(3 * kCount), dquats(4 * kCount), dscales(3 * kCount), dlogits(kCount),
      dsh(3 * kCount);
  std::vector<std::uint8_t> touched(kCount);
  gsut::GradientRows rows;
  rows.rows = {kCount, 1, dmeans.data(), dquats.data(), dscales.data(), dlogits.data(), dsh.data()};
  rows.touched = touched.data();

  const gsut::Camera camera("kannala_brandt", {45, 45, 48, 48, 0.05, -0.01, 0, 0}, kWidth, kHeight);
  std::vector<float> photograph(3 * kWidth * kHeight), image(photograph.size()),
      dimage(image.size());
  gsut::Renderer renderer;
  const auto render = [&](const gsut::Pose& camera_from_world, std::vector<float>* out) {
    gsut::RenderJob job{camera, camera_from_world};
    job.image = out->data();
    renderer.Render(scene, job);
  };
  render(gsut::Pose(), &photograph);

  Vector6 error;
  error << 0.03, -0.02, 0.02, 0.01, 0.015, -0.01;
  gsut::Pose pose = gsut::ExpPose(error);
  Vector6 mean = Vector6::Zero(), square = Vector6::Zero();  // Adam
  for (int step = 1; step <= kSteps; ++step) {
    render(pose, &image);
    for (std::size_t i = 0; i < image.size(); ++i) dimage[i] = image[i] - photograph[i];
    Vector6 gradient;
    renderer.Backward({dimage.data()}, rows, gradient.data());
    mean = 0.9 * mean + 0.1 * gradient;
    square = 0.99 * square + 0.01 * gradient.cwiseAbs2();
    const double rate = 2e-3 * (1.0 - step / (kSteps + 1.0)) / (1.0 - std::pow(0.9, step));
    const double scale = std::sqrt(1.0 - std::pow(0.99, step));
    pose = gsut::ExpPose(-rate * scale * mean.cwiseQuotient(square.cwiseSqrt())) * pose;
  }
  std::printf("centre off by %.5f at first, by %.5f after %d steps\n",
              gsut::ExpPose(error).CenterInSource().norm(), pose.CenterInSource().norm(), kSteps);
}
