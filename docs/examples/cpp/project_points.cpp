// Projects points of the camera frame through the lens of a file: project_points LENS < POINTS.
#include <gsut/base/errors.h>
#include <gsut/cameras/camera.h>
#include <gsut/formats/camera_model.h>

#include <cmath>
#include <cstdio>
#include <iostream>
#include <vector>

#include "read_file.h"

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: project_points LENS.cameramodel < POINTS\n");
    return 2;
  }
  try {
    const gsut::Camera camera = gsut::ParseCameraModel(ReadFile(argv[1]), argv[1]).camera;
    std::vector<double> points;  // x right, y down, z forward, any length but 0
    for (double value; std::cin >> value;) points.push_back(value);
    const auto count = static_cast<std::int64_t>(points.size() / 3);

    std::vector<double> pixels(2 * count), dpixel_dpoint(6 * count), rays(3 * count);
    std::vector<std::uint8_t> valid(count), has_ray(count);
    camera.ProjectJacobian(count, points.data(), pixels.data(), valid.data(), dpixel_dpoint.data(),
                           nullptr);
    camera.Unproject(count, pixels.data(), rays.data(), has_ray.data());

    std::printf("# %s, %d x %d pixels; the centre of the top-left pixel is (0.5, 0.5)\n",
                camera.model().c_str(), camera.width(), camera.height());
    for (std::int64_t i = 0; i < count; ++i) {
      if (!valid[i]) {
        std::printf("no image\n");  // outside the domain where the lens is one-to-one
        continue;
      }
      const double* slope = &dpixel_dpoint[6 * i];
      const double px_per_unit = std::hypot(slope[0], slope[3]);  // of a step along x
      std::printf("%.6f %.6f  ray %.9f %.9f %.9f  %.3f px per unit of x\n", pixels[2 * i],
                  pixels[2 * i + 1], rays[3 * i], rays[3 * i + 1], rays[3 * i + 2], px_per_unit);
    }
  } catch (const std::exception& error) {
    std::fprintf(stderr, "project_points: %s\n", error.what());
    return 1;
  }
}
