// Binds gsut/surface/sweep_scores.h, sweep_paths.h and other_photographs.h: comparison of
// photographs, for distances and for what moved.
//
// A sweep is one photograph, its neighbours one by one, and one answer. Python projects the cells'
// centres, as it knows lenses and shutters; what is done for each pixel is done in the core.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <tuple>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/long_call.h"
#include "bindings/module.h"
#include "gsut/surface/other_photographs.h"
#include "gsut/surface/sweep_paths.h"
#include "gsut/surface/sweep_scores.h"

namespace gsut::bindings {
namespace {

// The neighbours of one photograph at tried distances; arrays are kept, not copied.
class Sweep {
 public:
  // grey (H, W) must be float32 and contiguous: nothing is converted behind the caller's back.
  Sweep(const py::object& grey, int depths, int cell) : grey_object_(grey) {
    const py::array array = py::reinterpret_borrow<py::array>(grey);
    if (array.ndim() != 2 || depths < 3 || cell < 1) {
      throw InputError("grey must have two dimensions, depths be at least 3, and cell at least 1");
    }
    grid_ = {static_cast<int>(array.shape(1)), static_cast<int>(array.shape(0)), depths, cell};
    grey_ = ConstData<float>(grey, "grey", {grid_.height, grid_.width});
  }

  // One neighbour. All arrays must outlive the sweep, which refers to them; see SweepNeighbour.
  // What the neighbour shows is known from an earlier sweep, or None.
  void Add(const py::object& grey, const py::object& places, const py::object& nearness,
           const py::object& shown, const py::object& trust) {
    const py::array array = py::reinterpret_borrow<py::array>(grey);
    if (array.ndim() != 2) throw InputError("grey must have two dimensions");
    if (nearness.is_none() != shown.is_none() || shown.is_none() != trust.is_none()) {
      throw InputError("nearness, shown and trust belong together: give all or none");
    }
    const std::int64_t h = array.shape(0), w = array.shape(1);
    const std::int64_t depths = grid_.depths, rows = grid_.rows(), columns = grid_.columns();
    SweepNeighbour other;
    other.width = static_cast<int>(w);
    other.height = static_cast<int>(h);
    other.grey = ConstData<float>(grey, "grey", {h, w});
    other.places = ConstData<float>(places, "places", {depths, rows, columns, 2});
    other.nearness = OptionalData<float>(nearness, "nearness", {depths, rows, columns});
    other.shown = OptionalData<float>(shown, "shown", {h, w});
    other.trust = OptionalData<float>(trust, "trust", {h, w});
    neighbours_.push_back(other);
    kept_.append(py::make_tuple(grey, places, nearness, shown, trust));
  }

  // Scores all distances and chooses; see SweepOptions. The scores of a photograph of 200 pixels
  // and 112 distances are 18 MB, and live here alone. Other threads of Python run on.
  std::tuple<py::array_t<float>, py::array_t<float>> Solve(const py::object& counts, float contrast,
                                                           float step, float agreement,
                                                           float near_step, float far_step,
                                                           float edge) const {
    const bool* mask = ConstData<bool>(counts, "counts", {grid_.height, grid_.width});
    auto best = NewArray<float>({grid_.height, grid_.width});
    auto score = NewArray<float>({grid_.height, grid_.width});
    float *bests = best.mutable_data(), *scores_of = score.mutable_data();
    const SweepOptions options{contrast, step, agreement, near_step, far_step, edge};
    {
      const LongCall released;
      std::vector<float> scores(grid_.pixels() * grid_.depths);
      ScoreWindows(grid_, grey_, neighbours_, options, scores.data());
      ChooseDistances(grid_, grey_, mask, scores.data(), options, bests, scores_of);
    }
    return {std::move(best), std::move(score)};
  }

 private:
  py::object grey_object_;  // keeps `grey_` alive
  SweepGrid grid_;
  const float* grey_ = nullptr;
  std::vector<SweepNeighbour> neighbours_;
  py::list kept_;
};

// views: of (camera, camera_from_world, distances, values); see CompareShown. The list keeps the
// arrays alive while the core reads them; nothing of them is copied but the pose.
py::tuple CompareShownViews(const py::object& points, const py::list& views, double tolerance,
                            int most, int fewest) {
  const auto places = ReadArray<double>(points, "points", {kAny, 3});
  const std::int64_t count = places.shape(0);
  std::vector<ShownView> shown;
  for (const auto& each : views) {
    const auto [camera, pose, distances, values] =
        each.cast<std::tuple<const Camera*, py::object, py::object, py::object>>();
    const std::int64_t h = camera->height(), w = camera->width();
    ShownView& view = shown.emplace_back();
    view.camera = camera;
    // The last row of a rigid transform says nothing.
    const auto matrix = ReadArray<double>(pose, "pose", {4, 4});
    std::copy_n(matrix.data(), view.pose.size(), view.pose.data());
    view.distances = ConstData<float>(distances, "distances", {h, w});
    view.values = ConstData<float>(values, "values", {h, w, kShownValues});
  }
  // All results are written by the core, zeros too.
  auto medians = NewArray<float>({count, kShownValues});
  auto spreads = NewArray<float>({count});
  auto seen = NewArray<std::int64_t>({count});
  float *median = medians.mutable_data(), *spread = spreads.mutable_data();
  std::int64_t* number = seen.mutable_data();
  {
    const LongCall released;
    CompareShown(count, places.data(), shown, tolerance, most, fewest, median, spread, number);
  }
  return py::make_tuple(medians, spreads, seen);
}

}  // namespace

void BindStereo(py::module_& m) {
  py::class_<Sweep>(m, "Sweep",
                    "Compares a photograph with neighbours at tried distances, see gsut.stereo.")
      .def(py::init<const py::object&, int, int>(), py::arg("grey"), py::arg("depths"),
           py::arg("cell"),
           "grey (H, W) float32, 0 where masked; the number of distances; pixels a side of the "
           "cells at whose centres places are given.")
      .def("add", &Sweep::Add, py::arg("grey"), py::arg("places"), py::arg("nearness") = py::none(),
           py::arg("shown") = py::none(), py::arg("trust") = py::none(),
           "Adds a neighbour: grey (h, w), places (depths, rows, columns, 2) of the cells' centres "
           "in it, NaN where unseen; and together inverse distances from it (depths, rows, "
           "columns), "
           "those that it shows (h, w), 0 where unknown, and the trust in them (h, w). All "
           "float32.")
      .def("solve", &Sweep::Solve, py::arg("counts"), py::arg("contrast"), py::arg("step"),
           py::arg("agreement"), py::arg("near_step"), py::arg("far_step"), py::arg("edge"),
           "Returns the number, with a fraction, of each pixel's distance and its score, each "
           "(H, W) float32; `counts` (H, W) bool is False where a pixel has no say.");

  m.def("compare_shown", &CompareShownViews, py::arg("points"), py::arg("views"),
        py::arg("tolerance"), py::arg("most"), py::arg("fewest"), R"doc(
Compares what photographs show of points.

Args:
    points: (N, 3), world.
    views: list of (camera, camera_from_world (4, 4), distances (H, W), infinite where there is
        nothing, values (H, W, 9), the first three the colour), both float32, the first to ask first.
    tolerance: relative difference of distances up to which a view sees the point.
    most: views a point is compared in, at most 8.
    fewest: views below which a point has no medians.

Returns:
    (N, 9) medians of the values, (N,) median of the colours' mean difference from the median
    colour, zeros where too few views see the point; and (N,) how many see it, up to `most`.
)doc");
}

}  // namespace gsut::bindings
