// Renders Gaussians through the lens and pose of a file: render_ply SCENE.ply LENS OUT.png.
#include <gsut/cameras/camera.h>
#include <gsut/formats/camera_model.h>
#include <gsut/formats/ply.h>
#include <gsut/geometry/rotation_vector.h>
#include <gsut/raster/render.h>

#include <cstdio>
#include <vector>

#include "read_file.h"
#include "write_png.h"

// The arrays of a scene; gsut itself owns none.
struct Scene {
  explicit Scene(const std::string& path) {
    gsut::PlyGaussianReader reader(path);
    const auto n = static_cast<std::size_t>(reader.size());
    means.resize(3 * n), quats.resize(4 * n), log_scales.resize(3 * n), opacity_logits.resize(n);
    sh.resize(3 * n * reader.sh_coefficients());
    view = {reader.size(),     reader.sh_coefficients(), means.data(), quats.data(),
            log_scales.data(), opacity_logits.data(),    sh.data()};
    reader.Read(view);
  }
  std::vector<float> means, quats, log_scales, opacity_logits, sh;
  gsut::GaussiansView<float> view;
};

int main(int argc, char** argv) {
  if (argc != 4) {
    std::fprintf(stderr, "usage: render_ply SCENE.ply LENS.cameramodel OUT.png\n");
    return 2;
  }
  try {
    const Scene scene(argv[1]);
    const gsut::CameraModelFile file = gsut::ParseCameraModel(ReadFile(argv[2]), argv[2]);
    const std::array<double, 6>& e = file.extrinsics;  // camera_from_world
    gsut::Pose pose;
    pose.rotation = gsut::RotationOfVector({e[0], e[1], e[2]});
    pose.translation = {e[3], e[4], e[5]};

    const int width = file.camera.width(), height = file.camera.height();
    std::vector<float> image(static_cast<std::size_t>(3) * width * height);
    gsut::RenderJob job{file.camera, pose};
    job.keep_for_backward = false;
    job.image = image.data();
    gsut::Renderer().Render(scene.view.AsConst(), job);
    WritePng(argv[3], image, width, height);
    std::printf("%s: %d x %d pixels, %lld Gaussians\n", argv[3], width, height,
                static_cast<long long>(scene.view.size));
  } catch (const std::exception& error) {
    std::fprintf(stderr, "render_ply: %s\n", error.what());
    return 1;
  }
}
