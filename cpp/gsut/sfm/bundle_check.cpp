// Sizes and indices of a bundle and its options.
#include "gsut/sfm/bundle_check.h"

#include <algorithm>
#include <string>

#include "gsut/base/errors.h"
#include "gsut/sfm/lens_parameters.h"

namespace gsut {
namespace {

// Velocities and rigs: one entry an image, indices that are there.
void CheckMotions(const Bundle& bundle, const BundleOptions& options) {
  const std::size_t images = bundle.camera_from_world.size();
  // Empty means that there are none.
  const auto fits = [&](std::size_t size) { return size == 0 || size == images; };
  if (!fits(bundle.velocities.size()) || !fits(bundle.body_of_image.size()) ||
      !fits(bundle.mount_of_image.size()) || !fits(options.velocity_priors.size()) ||
      !fits(options.place_priors.size()) || !fits(options.velocity_fixed.size())) {
    throw InputError("velocities, priors, flags, bodies and mounts must have one entry an image");
  }
  // -1: the camera is the body itself.
  const int mounts = static_cast<int>(bundle.camera_from_body.size());
  for (const int mount : bundle.mount_of_image) {
    if (mount < -1 || mount >= mounts) {
      throw InputError("mount_of_image names mount " + std::to_string(mount) + " of " +
                       std::to_string(mounts));
    }
  }
  // Every body from 0 on has an image.
  std::vector<std::uint8_t> seen(images, 0);
  int bodies = 0;
  for (const int body : bundle.body_of_image) {
    if (body < 0 || body >= static_cast<int>(images)) {
      throw InputError("body_of_image names body " + std::to_string(body) + " of at most " +
                       std::to_string(images));
    }
    seen[body] = 1;
    bodies = std::max(bodies, body + 1);
  }
  if (std::count(seen.begin(), seen.begin() + bodies, 1) != bodies) {
    throw InputError("body_of_image leaves out a body below the largest");
  }
  if (!options.mount_free.empty() && static_cast<int>(options.mount_free.size()) != mounts) {
    throw InputError("mount_free must be empty or have one flag a mount");
  }
}

}  // namespace

// Everything that indexes something is checked here, once, so that no inner loop has to.
void CheckBundle(const Bundle& bundle, const BundleOptions& options) {
  const int images = static_cast<int>(bundle.camera_from_world.size());
  const int points = static_cast<int>(bundle.points.size());
  const auto inside = [](int index, int count) { return index >= 0 && index < count; };
  if (bundle.camera_of_image.size() != bundle.camera_from_world.size()) {
    throw InputError("camera_of_image must have one entry an image");
  }
  for (const int camera : bundle.camera_of_image) {
    if (!inside(camera, static_cast<int>(bundle.cameras.size()))) {
      throw InputError("camera_of_image names camera " + std::to_string(camera) + " of " +
                       std::to_string(bundle.cameras.size()));
    }
  }
  for (const BundleObservation& observation : bundle.observations) {
    if (inside(observation.image, images) && inside(observation.point, points)) continue;
    throw InputError("an observation names image " + std::to_string(observation.image) +
                     " and point " + std::to_string(observation.point) + "; there are " +
                     std::to_string(images) + " and " + std::to_string(points));
  }
  const auto fits = [](const std::vector<std::uint8_t>& flags, int count) {
    return flags.empty() || static_cast<int>(flags.size()) == count;
  };
  if (!fits(options.image_fixed, images) || !fits(options.point_fixed, points)) {
    throw InputError("image_fixed and point_fixed must be empty or have one flag each");
  }
  // Negative: the gauge is not held by an image.
  if (options.gauge_image >= images || options.scale_image >= images) {
    throw InputError("gauge_image or scale_image is not among the images");
  }
  // Residuals of bearings do not see the lens' parameters: only pixels through the lens do.
  CheckMotions(bundle, options);
  if (!options.lens_free.empty() && !options.through_lens) {
    throw InputError("lens_free needs through_lens");
  }
  CheckLensFlags(bundle.cameras, options.lens_free);
  bool known = options.lens_priors.empty() || options.lens_priors.size() == bundle.cameras.size();
  for (std::size_t c = 0; known && c < options.lens_priors.size(); ++c) {
    const LensPrior& prior = options.lens_priors[c];
    const auto own = static_cast<std::size_t>(bundle.cameras[c].num_params());
    known = prior.mean.size() == prior.sigma.size() &&
            (prior.sigma.empty() || prior.sigma.size() == own);
  }
  if (!known) throw InputError("lens_priors must have a mean and a sigma of each parameter");
}

}  // namespace gsut
