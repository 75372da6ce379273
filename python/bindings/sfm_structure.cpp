// Binds structure from motion of gsut/sfm: poses and points from verified matches.
//
// Lists and dictionaries of Python become the core's structs before the GIL goes, and the result
// one dictionary after it is back: in between no Python object is touched, but for progress.
#include <pybind11/functional.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <string>
#include <utility>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/geometry.h"
#include "bindings/long_call.h"
#include "bindings/module.h"
#include "bindings/pixels.h"
#include "gsut/sfm/match.h"
#include "gsut/sfm/refine_structure.h"
#include "gsut/sfm/structure.h"

namespace gsut::bindings {
namespace {

// Tuples (first image, second image, matches (M, 2), second_from_first, rotation inliers,
// parallax), as verify_pairs gives them with the inliers taken out.
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

// Cameras that are fixed to each other; core terms: a body carries mounts, a mount one camera.
// A dictionary body_of_image, mount_of_image, camera_from_body, refine; None: no rig.
Rig ReadRig(const py::object& object) {
  Rig rig;
  if (object.is_none()) return rig;
  const auto values = py::cast<py::dict>(object);
  rig.body_of_image = py::cast<std::vector<int>>(values["body_of_image"]);
  rig.mount_of_image = py::cast<std::vector<int>>(values["mount_of_image"]);
  for (const py::handle& pose : py::cast<py::list>(values["camera_from_body"])) {
    rig.camera_from_body.push_back(ReadPose(pose));
  }
  rig.refine = py::cast<bool>(values["refine"]);
  return rig;
}

// (S, 3) int32: point, image, feature.
py::array WriteObservations(const Structure& structure) {
  std::vector<std::int32_t> observations;
  for (std::size_t i = 0; i < structure.points.size(); ++i) {
    for (const TrackElement& observation : structure.points[i].observations) {
      observations.insert(observations.end(),
                          {static_cast<std::int32_t>(i), observation.image, observation.feature});
    }
  }
  auto array = NewArray<std::int32_t>({static_cast<py::ssize_t>(observations.size() / 3), 3});
  std::copy(observations.begin(), observations.end(), array.mutable_data());
  return array;
}

// Structure of arrays: images I, points P and observations S, each with its own rows. Tables of
// observations name point, image and feature by index, so that no Python object is made for one. A
// global shutter has no velocities: (0, 6).
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
  const bool rolling = !structure.velocities.empty();
  auto velocities = NewArray<double>({rolling ? images : 0, 6});
  for (py::ssize_t i = 0; rolling && i < images; ++i) {
    Eigen::Map<Velocity>(velocities.mutable_data() + 6 * i) = structure.velocities[i];
  }
  auto positions = NewArray<double>({points, 3});
  auto errors = NewArray<double>({points});
  for (py::ssize_t i = 0; i < points; ++i) {
    const StructurePoint& point = structure.points[i];
    Eigen::Map<Eigen::Vector3d>(positions.mutable_data() + 3 * i) = point.position;
    errors.mutable_data()[i] = point.error;
  }
  // Where each observation's point lies in the camera that saw it, at the time of its line: what a
  // lens is fitted to.
  std::vector<double> in_camera;
  for (const StructurePoint& point : structure.points) {
    for (const Eigen::Vector3d& p : point.in_camera) {
      in_camera.insert(in_camera.end(), p.begin(), p.end());
    }
  }
  auto observations_in_camera =
      NewArray<double>({static_cast<py::ssize_t>(in_camera.size() / 3), 3});
  std::copy(in_camera.begin(), in_camera.end(), observations_in_camera.mutable_data());
  py::list camera_from_body;
  for (const Pose& pose : structure.camera_from_body) camera_from_body.append(WritePose(pose));
  py::list lens_params;
  for (const Camera& camera : structure.cameras) lens_params.append(camera.params());
  py::dict result;
  result["registered"] = registered;
  result["camera_from_world"] = poses;
  result["covariances"] = covariances;
  result["velocities"] = velocities;
  result["camera_from_body"] = camera_from_body;
  result["points"] = positions;
  result["point_errors"] = errors;
  result["observations"] = WriteObservations(structure);
  result["observations_in_camera"] = observations_in_camera;
  result["lens_params"] = lens_params;
  result["rms"] = structure.rms;
  result["median"] = structure.median;
  result["other_noise"] = structure.other_noise;
  result["initial_pair"] = py::make_tuple(structure.initial_first, structure.initial_second);
  result["restarts"] = structure.restarts;
  result["failure"] = structure.failure;
  return result;
}

// What the three calls below share, in the core's types.
struct Inputs {
  std::vector<Camera> lenses;
  std::vector<ImageFeatures> images;
  std::vector<VerifiedPair> pairs;
  StructureOptions options;
  // Keeps what the images point to.
  std::vector<py::array_t<std::uint8_t, py::array::c_style | py::array::forcecast>> descriptors;
};

// Rows of a camera of whose lens nothing is known are empty; the solver checks their lengths, so
// that only the numbers of rows need to agree here.
std::vector<LensPrior> ReadLensPriors(SettingsReader* settings) {
  std::vector<std::vector<double>> means, sigmas;
  settings->Read("lens_mean", &means);
  settings->Read("lens_sigma", &sigmas);
  if (means.size() != sigmas.size()) {
    throw InputError("lens_mean and lens_sigma must have one row a camera");
  }
  std::vector<LensPrior> priors;
  for (std::size_t c = 0; c < means.size(); ++c) priors.push_back({means[c], sigmas[c]});
  return priors;
}

// An index that came as a double, beside other numbers; NaN is none either.
int ReadIndex(double value, std::size_t count, const std::string& what) {
  if (!(value >= 0 && value < static_cast<double>(count))) {
    throw InputError(what + " that is not there");
  }
  return static_cast<int>(value);
}

// Rows of both images, a rotation by rows, the columns by the calibration one after the other, and
// a standard deviation.
void ReadTurns(SettingsReader* settings, std::size_t images, StructureOptions* options) {
  std::vector<std::vector<double>> rows;
  std::vector<double> sigmas;
  settings->Read("turns", &rows);
  settings->Read("calibration_sigma", &sigmas);
  options->calibration_sigma =
      Eigen::Map<const Eigen::VectorXd>(sigmas.data(), static_cast<Eigen::Index>(sigmas.size()));
  for (const std::vector<double>& row : rows) {
    const std::size_t unknowns = sigmas.size();
    if (row.size() != 12 + 3 * unknowns) {
      throw InputError(
          "turns must have two images, nine numbers, three an unknown of the "
          "calibration, and a standard deviation in a row");
    }
    TurnPrior& turn = options->turns.emplace_back();
    for (const auto& [image, value] : {std::pair(&turn.first, row[0]), {&turn.second, row[1]}}) {
      *image = ReadIndex(value, images, "turns names an image");
    }
    turn.rotation = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(&row[2]);
    turn.by_calibration =
        Eigen::Map<const Eigen::Matrix3Xd>(row.data() + 11, 3, static_cast<Eigen::Index>(unknowns));
    turn.sigma = row.back();
  }
}

// A flag for each feature of another kind, whose noise is estimated: see ImageFeatures. An empty
// list says that all are of one kind.
void ReadOthers(SettingsReader* settings, std::vector<ImageFeatures>* images) {
  std::vector<std::vector<std::uint8_t>> others;
  settings->Read("is_other", &others);
  if (others.empty()) return;
  if (others.size() != images->size()) throw InputError("is_other must have one row an image");
  for (std::size_t i = 0; i < others.size(); ++i) {
    if (others[i].size() != (*images)[i].pixels.size()) {
      throw InputError("is_other must have one flag a feature");
    }
    (*images)[i].is_other = std::move(others[i]);
  }
}

// Where a survey says that points lie: image and feature, place, standard deviations.
void ReadStatedPoints(SettingsReader* settings, const std::vector<ImageFeatures>& images,
                      StructureOptions* options) {
  std::vector<std::array<double, 8>> points;
  settings->Read("points", &points);
  // Standard deviations are relative to those of features: see `StatedPoints.to_settings`.
  for (const std::array<double, 8>& row : points) {
    const int image = ReadIndex(row[0], images.size(), "points names an image");
    const int feature = ReadIndex(row[1], images[image].pixels.size(), "points names a feature");
    options->stated_points.push_back({{image, feature},
                                      Eigen::Map<const Eigen::Vector3d>(&row[2]),
                                      Eigen::Map<const Eigen::Vector3d>(&row[5])});
  }
}

// cameras: lenses; camera_of_image: which of them took each image; pixels: (F, 2) an image;
// settings: StructureOptions by name. descriptors, if given, let tracks grow into images that no
// match reaches; they are not copied.
Inputs ReadInputs(const std::vector<const Camera*>& cameras,
                  const std::vector<int>& camera_of_image, const py::list& pixels,
                  const py::list& verified, const py::dict& values) {
  Inputs inputs;
  // Copies: the solver may adjust lenses, the caller's cameras are values.
  for (const Camera* camera : cameras) inputs.lenses.push_back(*camera);
  if (pixels.size() != camera_of_image.size()) {
    throw InputError("pixels must have one array an image, found " + std::to_string(pixels.size()) +
                     " for " + std::to_string(camera_of_image.size()));
  }
  for (std::size_t i = 0; i < camera_of_image.size(); ++i) {
    inputs.images.push_back({camera_of_image[i], ReadPixels(pixels[i])});
  }
  inputs.pairs = ReadVerified(verified);
  if (values.contains("descriptors")) {
    const auto arrays = py::cast<py::list>(values["descriptors"]);
    if (arrays.size() != inputs.images.size()) {
      throw InputError("descriptors must have one array an image");
    }
    for (std::size_t i = 0; i < inputs.images.size(); ++i) {
      const auto count = static_cast<py::ssize_t>(inputs.images[i].pixels.size());
      inputs.descriptors.push_back(
          ReadArray<std::uint8_t>(arrays[i], "descriptors", {count, kDescriptorLength}));
      inputs.images[i].descriptors = inputs.descriptors.back().data();
    }
  }
  StructureOptions& options = inputs.options;
  std::string shutter = "global";
  std::vector<std::string> shutters;
  std::vector<std::array<double, 6>> rates;
  std::vector<std::array<double, 3>> places;
  std::array<double, 3> place_sigma = {1.0, 1.0, 1.0};
  SettingsReader settings(values, "estimate_poses");
  settings.Read("max_error", &options.max_error);
  settings.Read("min_angle", &options.min_angle);
  settings.Read("min_inliers", &options.min_inliers);
  settings.Read("loss_scale", &options.loss_scale);
  settings.Read("thin_from", &options.thin_from);
  settings.Read("covariances", &options.covariances);
  settings.Read("seed", &options.seed);
  settings.Read("extend_radius", &options.extend_radius);
  settings.Read("extend_distance", &options.extend_distance);
  settings.Read("extend_rounds", &options.extend_rounds);
  settings.Read("lens_settled", &options.lens_settled);
  settings.Read("lens_free", &options.lens_free);
  options.lens_priors = ReadLensPriors(&settings);
  settings.Read("shutter", &shutter);
  settings.Read("rolling_error", &options.rolling_error);
  settings.Read("image_shutters", &shutters);
  settings.Read("image_readouts", &options.image_readouts);
  settings.Read("frame_times", &options.frame_times);
  settings.Read("frame_cameras", &options.frame_cameras);
  settings.Read("readout_time", &options.readout_time);
  settings.Read("image_rates", &rates);
  settings.Read("rate_sigma", &options.rate_sigma);
  settings.Read("places", &places);
  settings.Read("place_sigma", &place_sigma);
  ReadOthers(&settings, &inputs.images);
  ReadStatedPoints(&settings, inputs.images, &options);
  ReadTurns(&settings, inputs.images.size(), &options);
  settings.CheckAllRead({"descriptors"});
  // Names and arrays that are no plain fields of the options are converted here.
  options.shutter = Shutter::Named(shutter);
  for (const std::string& name : shutters) options.image_shutters.push_back(Shutter::Named(name));
  const auto fits = [&](std::size_t rows) { return rows == 0 || rows == inputs.images.size(); };
  if (!fits(shutters.size()) || !fits(options.image_readouts.size()) ||
      !fits(options.frame_cameras.size())) {
    throw InputError("image_shutters, image_readouts and frame_cameras have one entry an image");
  }
  if (!rates.empty() && rates.size() != inputs.images.size()) {
    throw InputError("image_rates must have one row an image");
  }
  if (!places.empty() && places.size() != inputs.images.size()) {
    throw InputError("places must have one row an image");
  }
  // Rows with NaN are images whose place is not known.
  for (const std::array<double, 3>& place : places) {
    options.places.emplace_back(Eigen::Map<const Eigen::Vector3d>(place.data()));
  }
  options.place_sigma = Eigen::Map<const Eigen::Vector3d>(place_sigma.data());
  for (const std::array<double, 6>& rate : rates) {
    options.image_rates.emplace_back(Eigen::Map<const Velocity>(rate.data()));
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
    // Called from the solver's thread between steps; false asks the solver to stop.
    progress = [&](const StructureProgress& state) {
      const py::gil_scoped_acquire acquired;
      try {
        // As `OnStep` of gsut.sfm takes them.
        on_progress(state.registered, state.images, state.points, std::string(state.step));
      } catch (py::error_already_set& error) {
        kept = new py::error_already_set(error);
        raised = true;
      }
      return !raised;
    };
  }
  // A solver that was stopped throws SolveError; the caller's own exception is the one to see.
  Structure structure;
  try {
    const LongCall released;
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

// From nothing but verified pairs: a first pair, and one image after the other.
py::dict Estimate(const std::vector<const Camera*>& cameras,
                  const std::vector<int>& camera_of_image, const py::list& pixels,
                  const py::list& verified, const py::dict& settings,
                  const py::object& on_progress) {
  Inputs inputs = ReadInputs(cameras, camera_of_image, pixels, verified, settings);
  return Solve(on_progress, [&](const OnProgress& progress) {
    return EstimatePoses(inputs.lenses, inputs.images, inputs.pairs, inputs.options, progress);
  });
}

// From poses that are nearly right: points anew, then bundle adjustment. registered: which poses
// are known, empty: all; the other images are placed by what they see. rig: see ReadRig.
py::dict RefinedStructure(const std::vector<const Camera*>& cameras,
                          const std::vector<int>& camera_of_image, const py::list& pixels,
                          const py::list& verified, const py::list& camera_from_world,
                          const py::dict& settings, const py::object& on_progress,
                          const std::vector<std::uint8_t>& registered, const py::object& rig) {
  Inputs inputs = ReadInputs(cameras, camera_of_image, pixels, verified, settings);
  inputs.options.rig = ReadRig(rig);
  std::vector<Pose> poses;
  for (const py::handle& pose : camera_from_world) poses.push_back(ReadPose(pose));
  return Solve(on_progress, [&](const OnProgress& progress) {
    return RefineStructure(inputs.lenses, inputs.images, inputs.pairs, poses, registered,
                           inputs.options, progress);
  });
}

}  // namespace

void BindSfmStructure(py::module_& m) {
  m.def("estimate_poses", &Estimate, py::arg("cameras"), py::arg("camera_of_image"),
        py::arg("pixels"), py::arg("verified"), py::arg("settings"), py::arg("on_progress"));
  m.def("refine_structure", &RefinedStructure, py::arg("cameras"), py::arg("camera_of_image"),
        py::arg("pixels"), py::arg("verified"), py::arg("camera_from_world"), py::arg("settings"),
        py::arg("on_progress"), py::arg("registered") = std::vector<std::uint8_t>(),
        py::arg("rig") = py::none());
}

}  // namespace gsut::bindings
