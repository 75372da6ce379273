// Binds matching and verification of pairs, poses from points, and what normal equations of poses
// take, of gsut/sfm.
//
// Features become bearings, unit vectors with the pixels' derivatives, once an image: from here on
// no function knows a lens, and every lens is matched and posed alike.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/geometry.h"
#include "bindings/long_call.h"
#include "bindings/module.h"
#include "bindings/pixels.h"
#include "gsut/base/parallel.h"
#include "gsut/sfm/absolute_pose.h"
#include "gsut/sfm/eliminate_points.h"
#include "gsut/sfm/match.h"
#include "gsut/sfm/relative_pose.h"

namespace gsut::bindings {
namespace {

template <class T>
using ReadOnly = py::array_t<T, py::array::c_style | py::array::forcecast>;

// The features of one image as rays; made once, used by every pair.
struct ImageBearings {
  std::vector<Bearing> bearings;
  std::vector<std::uint8_t> valid;
};

// Pairs (P, 2) of indices below `count`.
// Checked here once, so that the core may index without a look.
ReadOnly<std::int64_t> ReadPairs(const py::handle& object, const char* name, std::int64_t count) {
  auto pairs = ReadArray<std::int64_t>(object, name, {kAny, 2});
  for (py::ssize_t i = 0; i < pairs.size(); ++i) {
    if (pairs.data()[i] >= 0 && pairs.data()[i] < count) continue;
    throw InputError(std::string(name) + " holds " + std::to_string(pairs.data()[i]) +
                     "; there are " + std::to_string(count));
  }
  return pairs;
}

// For each pair of images an array (M, 2) int32 of feature indices, one a match. descriptors: an
// (F, 128) uint8 array an image. Pairs run in parallel, each in one thread: the same matches on any
// number of threads.
py::list MatchPairs(const py::list& descriptors, const py::object& pairs_object, double max_ratio,
                    double max_distance) {
  std::vector<ReadOnly<std::uint8_t>> sets;
  for (const py::handle& item : descriptors) {
    // The one place where a conversion would not fail but change the meaning.
    if (!py::isinstance<py::array_t<std::uint8_t>>(item)) {  // floats would all become 0
      throw InputError("descriptors must be arrays of uint8");
    }
    sets.push_back(ReadArray<std::uint8_t>(item, "descriptors", {kAny, kDescriptorLength}));
  }
  const auto pairs = ReadPairs(pairs_object, "pairs", static_cast<std::int64_t>(sets.size()));
  const py::ssize_t count = pairs.shape(0);
  const std::int64_t* index = pairs.data();
  std::vector<std::vector<FeatureMatch>> found(count);
  // Plain pointers, as no array may be touched without the GIL; `sets` keeps what they point to.
  std::vector<const std::uint8_t*> data;
  std::vector<int> lengths;
  for (const auto& set : sets) {
    data.push_back(set.data());
    lengths.push_back(static_cast<int>(set.shape(0)));
  }
  {
    const LongCall released;
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

// For each pair (inliers (M,), second_from_first (4, 4), number of matches that a rotation alone
// explains, parallax in radians, whether a pose was found). Every pair draws from the same seed, so
// that a pair's result depends on no other.
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
      // A match names a feature of each image. One outside the lens' domain has no bearing, and a
      // match that names it would be a fault of the caller, not data.
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
  // A pair a task: RANSAC's time differs widely from pair to pair. Results stay in the order given.
  std::vector<RelativePose> found(count);
  {
    const LongCall released;
    ParallelFor(count, 1, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) {
        RelativePoseOptions options;
        options.max_error = max_error;
        options.seed = seed;
        found[i] = EstimateRelativePose(first[i], second[i], options);
      }
    });
  }
  // Tuples, not objects: Python unpacks them at once into arrays of its own.
  py::list result;
  for (const RelativePose& pose : found) {
    auto inliers = NewArray<bool>({static_cast<py::ssize_t>(pose.inliers.size())});
    std::copy(pose.inliers.begin(), pose.inliers.end(), inliers.mutable_data());
    result.append(py::make_tuple(inliers, WritePose(pose.second_from_first),
                                 pose.num_rotation_inliers, pose.parallax, pose.found));
  }
  return result;
}

// (camera_from_world (4, 4), inliers (M,)) of an image from features and the points (M, 3) that
// they show. Bearings, so that any lens will do; a feature without one is refused.
py::tuple AbsolutePoseOf(const ImageBearings& image, const py::object& features_object,
                         const py::object& points_object, double max_error, std::uint64_t seed) {
  const auto features = ReadArray<std::int64_t>(features_object, "features", {kAny});
  const auto points = ReadArray<double>(points_object, "points", {features.shape(0), 3});
  // Feature i of the list shows point i.
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
    const LongCall released;
    found = EstimateAbsolutePose(bearings, positions, options);
  }
  auto inliers = NewArray<bool>({static_cast<py::ssize_t>(found.inliers.size())});
  std::copy(found.inliers.begin(), found.inliers.end(), inliers.mutable_data());
  return py::make_tuple(WritePose(found.camera_from_world), inliers);
}

// See gsut/sfm/eliminate_points.h. body, point (S,) from 0; by_body (S, 2, D), by_shared (S, 2, F)
// and by_point (S, 2, 3) weighted derivatives; prior (D,); held: unknowns of bodies.
py::tuple Information(const py::object& body, const py::object& point, const py::object& by_body,
                      const py::object& by_shared, const py::object& by_point,
                      const py::object& prior, const std::vector<int>& held) {
  const auto of_body = ReadArray<std::int64_t>(body, "body", {kAny});
  const py::ssize_t count = of_body.shape(0);
  const auto of_point = ReadArray<std::int64_t>(point, "point", {count});
  const auto priors = ReadArray<double>(prior, "prior", {kAny});
  const py::ssize_t size = priors.shape(0);
  const auto bodies_rows = ReadArray<double>(by_body, "by_body", {count, 2, size});
  const auto shared_rows = ReadArray<double>(by_shared, "by_shared", {count, 2, kAny});
  const auto point_rows = ReadArray<double>(by_point, "by_point", {count, 2, 3});
  const py::ssize_t shared = shared_rows.shape(2);
  using Rows = Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor>;
  // Checked here once, so that the core may index without a look.
  ObservationTable table;
  std::int64_t bodies = 0;
  for (py::ssize_t i = 0; i < count; ++i) {
    const std::int64_t own = of_body.data()[i], seen = of_point.data()[i];
    if (own < 0 || own >= count || seen < 0 || seen >= count) {
      throw InputError("body and point must be numbered from 0 without gaps");
    }
    bodies = std::max(bodies, own + 1);
    const auto read = [&](const auto& rows, py::ssize_t columns) {
      return Eigen::Map<const Rows>(rows.data() + 2 * columns * i, 2, columns);
    };
    table.linear.push_back({static_cast<int>(own),
                            read(bodies_rows, size),
                            read(shared_rows, shared),
                            read(point_rows, 3),
                            {}});
    if (seen >= static_cast<std::int64_t>(table.of_point.size())) table.of_point.resize(seen + 1);
    table.of_point[seen].push_back(static_cast<int>(i));
  }
  // The unknowns of bodies are numbered body by body.
  for (const int unknown : held) {
    if (unknown < 0 || unknown >= size * bodies) throw InputError("held names no unknown");
  }
  SharedInformation found;
  {
    // The table is the solver's own by now: no array of the caller is touched.
    const LongCall released;
    found = FindSharedInformation(std::move(table), static_cast<int>(bodies),
                                  Eigen::Map<const Eigen::VectorXd>(priors.data(), size), held,
                                  static_cast<int>(shared));
  }
  py::array_t<double> normal({shared, shared});
  Eigen::Map<Eigen::MatrixXd>(normal.mutable_data(), shared, shared) = found.normal;
  return py::make_tuple(normal, found.determined);
}

}  // namespace

void BindSfmMatching(py::module_& m) {
  // Opaque to Python but for `valid`: which features have a ray, and may be matched.
  py::class_<ImageBearings>(m, "ImageBearings")
      .def(py::init([](const Camera& camera, const py::object& pixels_object) {
             // Python objects are read before the GIL goes; unprojecting may take a lens'
             // iterations.
             const std::vector<Eigen::Vector2d> pixels = ReadPixels(pixels_object);
             ImageBearings image;
             const LongCall released;
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
  m.def("shared_information", &Information, py::arg("body"), py::arg("point"), py::arg("by_body"),
        py::arg("by_shared"), py::arg("by_point"), py::arg("prior"), py::arg("held"));
  m.def("absolute_pose", &AbsolutePoseOf, py::arg("image"), py::arg("features"), py::arg("points"),
        py::arg("max_error"), py::arg("seed"));
}

}  // namespace gsut::bindings
