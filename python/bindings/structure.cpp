// Binds structure from motion of gsut/poses: matching, verification of pairs, poses and points.
#include <pybind11/functional.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <string>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/module.h"
#include "bindings/poses.h"
#include "gsut/base/parallel.h"
#include "gsut/poses/absolute_pose.h"
#include "gsut/poses/match.h"
#include "gsut/poses/relative_pose.h"
#include "gsut/poses/refine_structure.h"
#include "gsut/poses/structure.h"

namespace gsut::bindings {
namespace {

using Released = py::gil_scoped_release;

template <class T>
using ReadOnly = py::array_t<T, py::array::c_style | py::array::forcecast>;

// The features of one image as rays; made once, used by every pair.
struct ImageBearings {
  std::vector<Bearing> bearings;
  std::vector<std::uint8_t> valid;
};

std::vector<Eigen::Vector2d> ReadPixels(const py::handle& object) {
  const auto array = ReadArray<double>(object, "pixels", {kAny, 2});
  std::vector<Eigen::Vector2d> pixels(array.shape(0));
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    pixels[i] = {array.data()[2 * i], array.data()[2 * i + 1]};
  }
  return pixels;
}

// Pairs (P, 2) of indices below `count`.
ReadOnly<std::int64_t> ReadPairs(const py::handle& object, const char* name, std::int64_t count) {
  auto pairs = ReadArray<std::int64_t>(object, name, {kAny, 2});
  for (py::ssize_t i = 0; i < pairs.size(); ++i) {
    if (pairs.data()[i] >= 0 && pairs.data()[i] < count) continue;
    throw InputError(std::string(name) + " holds " + std::to_string(pairs.data()[i]) +
                     "; there are " + std::to_string(count));
  }
  return pairs;
}

py::list MatchPairs(const py::list& descriptors, const py::object& pairs_object, double max_ratio,
                    double max_distance) {
  std::vector<ReadOnly<float>> sets;
  for (const py::handle& item : descriptors) {
    sets.push_back(ReadArray<float>(item, "descriptors", {kAny, kDescriptorLength}));
  }
  const auto pairs = ReadPairs(pairs_object, "pairs", static_cast<std::int64_t>(sets.size()));
  const py::ssize_t count = pairs.shape(0);
  const std::int64_t* index = pairs.data();
  std::vector<std::vector<FeatureMatch>> found(count);
  std::vector<const float*> data;
  std::vector<int> lengths;
  for (const auto& set : sets) {
    data.push_back(set.data());
    lengths.push_back(static_cast<int>(set.shape(0)));
  }
  {
    const Released released;
    ParallelFor(count, 1, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) {
        const std::int64_t a = index[2 * i], b = index[2 * i + 1];
        found[i] =
            MatchDescriptors(data[a], lengths[a], data[b], lengths[b], {max_ratio, max_distance});
      }
    });
  }
  py::list result;
  for (const auto& matches : found) {
    auto array = NewArray<std::int32_t>({static_cast<py::ssize_t>(matches.size()), 2});
    for (std::size_t i = 0; i < matches.size(); ++i) {
      array.mutable_data()[2 * i] = matches[i].first;
      array.mutable_data()[2 * i + 1] = matches[i].second;
    }
    result.append(array);
  }
  return result;
}

py::list VerifyPairs(const std::vector<const ImageBearings*>& images,
                     const py::object& pairs_object, const py::list& matches, double max_error,
                     std::uint64_t seed) {
  const auto pairs = ReadPairs(pairs_object, "pairs", static_cast<std::int64_t>(images.size()));
  const py::ssize_t count = pairs.shape(0);
  if (static_cast<py::ssize_t>(matches.size()) != count) {
    throw InputError("matches must have one array a pair, found " + std::to_string(matches.size()) +
                     " for " + std::to_string(count));
  }
  const std::int64_t* index = pairs.data();
  std::vector<std::vector<Bearing>> first(count), second(count);
  for (py::ssize_t i = 0; i < count; ++i) {
    const auto array = ReadArray<std::int32_t>(matches[i], "matches", {kAny, 2});
    const ImageBearings& a = *images[index[2 * i]];
    const ImageBearings& b = *images[index[2 * i + 1]];
    for (py::ssize_t m = 0; m < array.shape(0); ++m) {
      const std::int32_t fa = array.data()[2 * m], fb = array.data()[2 * m + 1];
      const bool known = fa >= 0 && fb >= 0 && fa < static_cast<int>(a.bearings.size()) &&
                         fb < static_cast<int>(b.bearings.size());
      if (!known || !a.valid[fa] || !b.valid[fb]) {
        throw InputError("match " + std::to_string(m) + " of pair " + std::to_string(i) +
                         " names a feature that is not there or has no ray");
      }
      first[i].push_back(a.bearings[fa]);
      second[i].push_back(b.bearings[fb]);
    }
  }
  std::vector<RelativePose> found(count);
  {
    const Released released;
    ParallelFor(count, 1, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) {
        RelativePoseOptions options;
        options.max_error = max_error;
        options.seed = seed;
        found[i] = EstimateRelativePose(first[i], second[i], options);
      }
    });
  }
  py::list result;
  for (const RelativePose& pose : found) {
    auto inliers = NewArray<bool>({static_cast<py::ssize_t>(pose.inliers.size())});
    std::copy(pose.inliers.begin(), pose.inliers.end(), inliers.mutable_data());
    result.append(py::make_tuple(inliers, WritePose(pose.second_from_first),
                                 pose.num_rotation_inliers, pose.parallax, pose.found));
  }
  return result;
}

py::tuple AbsolutePoseOf(const ImageBearings& image, const py::object& features_object,
                         const py::object& points_object, double max_error, std::uint64_t seed) {
  const auto features = ReadArray<std::int64_t>(features_object, "features", {kAny});
  const auto points = ReadArray<double>(points_object, "points", {features.shape(0), 3});
  std::vector<Bearing> bearings;
  std::vector<Eigen::Vector3d> positions;
  for (py::ssize_t i = 0; i < features.shape(0); ++i) {
    const std::int64_t feature = features.data()[i];
    if (feature < 0 || feature >= static_cast<std::int64_t>(image.bearings.size()) ||
        !image.valid[feature]) {
      throw InputError("features names " + std::to_string(feature) +
                       ", which is not there or has no ray");
    }
    bearings.push_back(image.bearings[feature]);
    positions.emplace_back(points.data()[3 * i], points.data()[3 * i + 1],
                           points.data()[3 * i + 2]);
  }
  AbsolutePoseOptions options;
  options.max_error = max_error;
  options.seed = seed;
  AbsolutePose found;
  {
    const Released released;
    found = EstimateAbsolutePose(bearings, positions, options);
  }
  auto inliers = NewArray<bool>({static_cast<py::ssize_t>(found.inliers.size())});
  std::copy(found.inliers.begin(), found.inliers.end(), inliers.mutable_data());
  return py::make_tuple(WritePose(found.camera_from_world), inliers);
}

std::vector<VerifiedPair> ReadVerified(const py::list& verified) {
  std::vector<VerifiedPair> pairs;
  for (const py::handle& item : verified) {
    const auto tuple = py::cast<py::tuple>(item);
    VerifiedPair pair;
    pair.first = py::cast<int>(tuple[0]);
    pair.second = py::cast<int>(tuple[1]);
    const auto matches = ReadArray<std::int32_t>(tuple[2], "matches", {kAny, 2});
    for (py::ssize_t i = 0; i < matches.shape(0); ++i) {
      pair.matches.push_back({matches.data()[2 * i], matches.data()[2 * i + 1]});
    }
    pair.second_from_first = ReadPose(tuple[3]);
    pair.num_rotation_inliers = py::cast<int>(tuple[4]);
    pair.parallax = py::cast<double>(tuple[5]);
    pairs.push_back(std::move(pair));
  }
  return pairs;
}

// (S, 3) int32: point, image, feature.
py::array WriteSights(const Structure& structure,
                      std::vector<TrackElement> StructurePoint::*elements) {
  std::vector<std::int32_t> sights;
  for (std::size_t i = 0; i < structure.points.size(); ++i) {
    for (const TrackElement& sight : structure.points[i].*elements) {
      sights.insert(sights.end(), {static_cast<std::int32_t>(i), sight.image, sight.feature});
    }
  }
  auto array = NewArray<std::int32_t>({static_cast<py::ssize_t>(sights.size() / 3), 3});
  std::copy(sights.begin(), sights.end(), array.mutable_data());
  return array;
}

py::dict WriteStructure(const Structure& structure) {
  const auto images = static_cast<py::ssize_t>(structure.registered.size());
  const auto points = static_cast<py::ssize_t>(structure.points.size());
  auto registered = NewArray<bool>({images});
  auto poses = NewArray<double>({images, 4, 4});
  auto covariances = NewArray<double>({images, 6, 6});
  using Row4 = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;
  using Row6 = Eigen::Matrix<double, 6, 6, Eigen::RowMajor>;
  for (py::ssize_t i = 0; i < images; ++i) {
    registered.mutable_data()[i] = structure.registered[i] != 0;
    Eigen::Map<Row4>(poses.mutable_data() + 16 * i) = structure.camera_from_world[i].Matrix();
    Eigen::Map<Row6>(covariances.mutable_data() + 36 * i) = structure.covariances[i];
  }
  auto positions = NewArray<double>({points, 3});
  auto errors = NewArray<double>({points});
  for (py::ssize_t i = 0; i < points; ++i) {
    const StructurePoint& point = structure.points[i];
    Eigen::Map<Eigen::Vector3d>(positions.mutable_data() + 3 * i) = point.position;
    errors.mutable_data()[i] = point.error;
  }
  py::list lens_params;
  for (const Camera& camera : structure.cameras) lens_params.append(camera.params());
  py::dict result;
  result["registered"] = registered;
  result["camera_from_world"] = poses;
  result["covariances"] = covariances;
  result["points"] = positions;
  result["point_errors"] = errors;
  result["sights"] = WriteSights(structure, &StructurePoint::sights);
  result["held_out_sights"] = WriteSights(structure, &StructurePoint::held_out);
  result["lens_params"] = lens_params;
  result["rms"] = structure.rms;
  result["median"] = structure.median;
  result["held_out"] = structure.held_out;
  result["num_held_out"] = structure.num_held_out;
  result["initial_pair"] = py::make_tuple(structure.initial_first, structure.initial_second);
  result["restarts"] = structure.restarts;
  result["failure"] = structure.failure;
  return result;
}

struct Inputs {
  std::vector<Camera> lenses;
  std::vector<ImageFeatures> images;
  std::vector<VerifiedPair> pairs;
  StructureOptions options;
};

Inputs ReadInputs(const std::vector<const Camera*>& cameras,
                  const std::vector<int>& camera_of_image, const py::list& pixels,
                  const py::list& verified, const py::dict& settings) {
  Inputs inputs;
  for (const Camera* camera : cameras) inputs.lenses.push_back(*camera);
  if (pixels.size() != camera_of_image.size()) {
    throw InputError("pixels must have one array an image, found " + std::to_string(pixels.size()) +
                     " for " + std::to_string(camera_of_image.size()));
  }
  for (std::size_t i = 0; i < camera_of_image.size(); ++i) {
    inputs.images.push_back({camera_of_image[i], ReadPixels(pixels[i])});
  }
  inputs.pairs = ReadVerified(verified);
  StructureOptions& options = inputs.options;
  for (const auto& [key, value] : settings) {
    const auto name = py::cast<std::string>(key);
    if (name == "max_error")
      options.max_error = py::cast<double>(value);
    else if (name == "min_angle")
      options.min_angle = py::cast<double>(value);
    else if (name == "min_inliers")
      options.min_inliers = py::cast<int>(value);
    else if (name == "loss_scale")
      options.loss_scale = py::cast<double>(value);
    else if (name == "hold_out_every")
      options.hold_out_every = py::cast<int>(value);
    else if (name == "covariances")
      options.covariances = py::cast<bool>(value);
    else if (name == "seed")
      options.seed = py::cast<std::uint64_t>(value);
    else if (name == "lens_free")
      options.lens_free = py::cast<std::vector<std::vector<std::uint8_t>>>(value);
    else
      throw InputError("estimate_poses has no setting " + name);
  }
  return inputs;
}

using OnProgress = std::function<bool(const StructureProgress&)>;

// Runs the solver without the GIL. An exception of the caller's function (Ctrl-C too) is kept, and
// raised again at the end.
py::dict Solve(const py::object& on_progress,
               const std::function<Structure(const OnProgress&)>& solver) {
  OnProgress progress;
  bool raised = false;
  py::error_already_set* kept = nullptr;
  if (!on_progress.is_none()) {
    progress = [&](const StructureProgress& state) {
      const py::gil_scoped_acquire acquired;
      try {
        on_progress(state.registered, state.images, state.points, std::string(state.step));
      } catch (py::error_already_set& error) {
        kept = new py::error_already_set(error);
        raised = true;
      }
      return !raised;
    };
  }
  Structure structure;
  try {
    const Released released;
    structure = solver(progress);
  } catch (const SolveError&) {
    if (!raised) throw;
  }
  if (raised) {
    const py::error_already_set error(*kept);
    delete kept;
    throw error;
  }
  return WriteStructure(structure);
}

py::dict Estimate(const std::vector<const Camera*>& cameras,
                  const std::vector<int>& camera_of_image, const py::list& pixels,
                  const py::list& verified, const py::dict& settings,
                  const py::object& on_progress) {
  Inputs inputs = ReadInputs(cameras, camera_of_image, pixels, verified, settings);
  return Solve(on_progress, [&](const OnProgress& progress) {
    return EstimatePoses(inputs.lenses, std::move(inputs.images), inputs.pairs, inputs.options,
                         progress);
  });
}

py::dict Refine(const std::vector<const Camera*>& cameras, const std::vector<int>& camera_of_image,
                const py::list& pixels, const py::list& verified, const py::list& camera_from_world,
                const py::dict& settings, const py::object& on_progress) {
  const Inputs inputs = ReadInputs(cameras, camera_of_image, pixels, verified, settings);
  std::vector<Pose> poses;
  for (const py::handle& pose : camera_from_world) poses.push_back(ReadPose(pose));
  return Solve(on_progress, [&](const OnProgress& progress) {
    return RefineStructure(inputs.lenses, inputs.images, inputs.pairs, poses, inputs.options,
                           progress);
  });
}

}  // namespace

void BindStructure(py::module_& m) {
  py::class_<ImageBearings>(m, "ImageBearings")
      .def(py::init([](const Camera& camera, const py::object& pixels_object) {
             const std::vector<Eigen::Vector2d> pixels = ReadPixels(pixels_object);
             ImageBearings image;
             const Released released;
             image.bearings = MakeBearings(camera, pixels, &image.valid);
             return image;
           }),
           py::arg("camera"), py::arg("pixels"))
      .def_property_readonly("valid", [](const ImageBearings& image) {
        auto valid = NewArray<bool>({static_cast<py::ssize_t>(image.valid.size())});
        std::copy(image.valid.begin(), image.valid.end(), valid.mutable_data());
        return valid;
      });
  m.def("match_pairs", &MatchPairs, py::arg("descriptors"), py::arg("pairs"), py::arg("max_ratio"),
        py::arg("max_distance"));
  m.def("verify_pairs", &VerifyPairs, py::arg("images"), py::arg("pairs"), py::arg("matches"),
        py::arg("max_error"), py::arg("seed"));
  m.def("absolute_pose", &AbsolutePoseOf, py::arg("image"), py::arg("features"), py::arg("points"),
        py::arg("max_error"), py::arg("seed"));
  m.def("estimate_poses", &Estimate, py::arg("cameras"), py::arg("camera_of_image"),
        py::arg("pixels"), py::arg("verified"), py::arg("settings"), py::arg("on_progress"));
  m.def("refine_structure", &Refine, py::arg("cameras"), py::arg("camera_of_image"),
        py::arg("pixels"), py::arg("verified"), py::arg("camera_from_world"), py::arg("settings"),
        py::arg("on_progress"));
}

}  // namespace gsut::bindings
