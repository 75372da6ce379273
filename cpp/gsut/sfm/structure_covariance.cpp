// The bundle of a structure, and its covariances.
#include "gsut/sfm/structure_covariance.h"

#include <limits>
#include <string>

#include "gsut/base/errors.h"
#include "gsut/sfm/bundle.h"

namespace gsut {
namespace {

using AllBearings = std::span<const std::vector<Bearing>* const>;

void CheckIndices(AllBearings bearings, const FoundStructure& structure) {
  const auto check = [](std::int64_t index, std::size_t count, const char* what) {
    if (index >= 0 && index < static_cast<std::int64_t>(count)) return;
    throw InputError("an observation names " + std::string(what) + " " + std::to_string(index) +
                     " of " + std::to_string(count));
  };
  for (const auto& [point, image, feature] : structure.observations) {
    check(point, structure.points.size(), "point");
    check(image, bearings.size(), "image");
    check(feature, bearings[image]->size(), "feature");
  }
}

}  // namespace

std::vector<Eigen::Matrix<double, 6, 6>> StructureCovariances(AllBearings bearings,
                                                              const FoundStructure& structure) {
  CheckIndices(bearings, structure);
  // Images stand in the order of their first observation, as the solver's.
  Bundle bundle;
  bundle.points = structure.points;
  std::vector<int> place(bearings.size(), -1), image_of;
  for (const auto& [point, image, feature] : structure.observations) {
    if (place[image] < 0) {
      place[image] = static_cast<int>(image_of.size());
      image_of.push_back(image);
      bundle.camera_of_image.push_back(0);
      bundle.camera_from_world.push_back(structure.camera_from_world[image]);
    }
    bundle.observations.push_back({place[image], point, (*bearings[image])[feature]});
  }
  // As after the last adjustment: the same weights, and the same images that hold the gauge.
  BundleOptions options;
  options.loss_scale = structure.loss_pixels;
  const auto placed = [&](int image) {
    return image < 0 || image >= static_cast<int>(place.size()) ? -1 : place[image];
  };
  options.gauge_image = placed(structure.initial_first);
  options.scale_image = placed(structure.initial_second);
  std::vector<Eigen::Matrix<double, 6, 6>> covariances(bearings.size(),
                                                       Eigen::Matrix<double, 6, 6>::Zero());
  // Images that see nothing keep zeros, as those that are not registered.
  try {
    const auto found = PoseCovariances(bundle, options);
    for (std::size_t i = 0; i < image_of.size(); ++i) covariances[image_of[i]] = found[i];
  } catch (const SolveError&) {
    for (const int image : image_of) {
      covariances[image].setConstant(std::numeric_limits<double>::quiet_NaN());
    }
  }
  return covariances;
}

}  // namespace gsut
