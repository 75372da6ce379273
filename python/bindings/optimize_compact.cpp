// Binds gsut/optimize's compaction: reduced copies of float32 Gaussians, palettes.
//
// Methods that need C++ for speed; those on scores of renders alone are written in Python.
#include <pybind11/pybind11.h>

#include "bindings/arrays.h"
#include "bindings/long_call.h"
#include "bindings/module.h"
#include "gsut/optimize/compact.h"
#include "gsut/optimize/palette.h"

namespace gsut::bindings {
namespace {

// The core can reduce some rows and keep others; from here it is always all of them.
std::vector<std::uint32_t> AllRows(std::int64_t size) {
  std::vector<std::uint32_t> rows(static_cast<std::size_t>(size));
  for (std::size_t i = 0; i < rows.size(); ++i) rows[i] = static_cast<std::uint32_t>(i);
  return rows;
}

// A vector of the core becomes an array by a copy: its memory is not numpy's.
py::array_t<float> CopyOf(const std::vector<float>& values,
                          std::initializer_list<py::ssize_t> shape) {
  auto array = NewArray<float>(shape);
  std::copy(values.begin(), values.end(), array.mutable_data());
  return array;
}

// means, quats, log_scales, opacity_logits, sh
py::tuple Arrays(const GaussianArrays& g) {
  const py::ssize_t n = g.size, k = g.sh_coefficients;
  return py::make_tuple(CopyOf(g.means, {n, 3}), CopyOf(g.quats, {n, 4}),
                        CopyOf(g.log_scales, {n, 3}), CopyOf(g.opacity_logits, {n}),
                        CopyOf(g.sh, {n, k, 3}));
}

// All of these make new Gaussians of the same degree and leave the old ones; the caller chooses
// rows by giving fewer. Long calls: Ctrl-C ends them, nothing half-done stays.
py::tuple Paper(const py::object& gaussians, double keep, std::uint64_t seed) {
  const auto view = ConstGaussians<float>(gaussians);
  HerdOptions options;
  options.keep = keep;
  options.seed = seed;
  GaussianArrays reduced(0, view.sh_coefficients);
  {
    const LongCall released;
    reduced = HerdPaper(view, AllRows(view.size), options);
  }
  return Arrays(reduced);
}

// weights (N,): what a Gaussian counts where two become one; None: opacity times shadow area.
py::tuple Merge(const py::object& gaussians, std::int64_t target, const py::object& weights) {
  const auto view = ConstGaussians<float>(gaussians);
  const float* weight_data =
      weights.is_none() ? nullptr : ConstData<float>(weights, "weights", {view.size});
  GaussianArrays reduced(0, view.sh_coefficients);
  {
    const LongCall released;
    reduced = MergePairs(view, AllRows(view.size), weight_data, target, MergeOptions());
  }
  return Arrays(reduced);
}

// Vector quantisation: (entries (M, columns), index of each row's (N,) uint32).
py::tuple PaletteOf(const py::array& rows, std::int64_t entries, int rounds) {
  if (rows.ndim() != 2) throw InputError("rows must have shape (N, columns)");
  // columns may be any number: a palette is of harmonics, or of anything else.
  const std::int64_t count = rows.shape(0);
  const int columns = static_cast<int>(rows.shape(1));
  const float* data = ConstData<float>(rows, "rows", {count, columns});
  Palette palette;
  {
    const LongCall released;
    palette = MakePalette(data, count, columns, {entries, rounds});
  }
  const auto size = static_cast<py::ssize_t>(palette.entries.size()) / columns;
  auto values = NewArray<float>({size, columns});
  auto labels = NewArray<std::uint32_t>({static_cast<py::ssize_t>(count)});
  std::copy(palette.entries.begin(), palette.entries.end(), values.mutable_data());
  std::copy(palette.labels.begin(), palette.labels.end(), labels.mutable_data());
  return py::make_tuple(values, labels);
}

}  // namespace

void BindOptimizeCompact(py::module_& m) {
  m.def("herd_paper", &Paper, py::arg("gaussians"), py::arg("keep"), py::arg("seed") = 0,
        "GHAP as published; means, quats, log_scales, opacity_logits, sh of the reduced.");
  m.def("merge_pairs", &Merge, py::arg("gaussians"), py::arg("target"),
        py::arg("weights") = py::none(),
        "Merges the cheapest pairs; means, quats, log_scales, opacity_logits, sh of the reduced.");
  m.def(
      "make_palette", &PaletteOf, py::arg("rows"), py::arg("entries"), py::arg("rounds") = 10,
      "Entries (M, columns) that stand for rows (N, columns) float32, and each row's (N,) uint32: "
      "k-means on two levels. M is `entries` at most.");
}

}  // namespace gsut::bindings
