// Binds gsut/optimize: Adam, MCMC and adaptive densification, on float32 arrays in place.
//
// All of it changes arrays of the caller in place, rows 0 to size of a capacity. Such calls cannot
// be interrupted: half a step would leave parameters and moments that do not belong together.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "bindings/arrays.h"
#include "bindings/harmonics_step.h"
#include "bindings/module.h"
#include "gsut/optimize/adam.h"
#include "gsut/optimize/adaptive.h"
#include "gsut/optimize/mcmc.h"
#include "gsut/optimize/training_state.h"

namespace gsut::bindings {
namespace {

// Null for None; otherwise at least one row, more than `rows` being allowed.
template <class T>
const T* OptionalRows(const py::object& object, const char* name, std::int64_t rows) {
  return object.is_none() ? nullptr : ConstData<T>(object, name, {rows});
}

std::int64_t Columns(const py::array& array) {
  std::int64_t columns = 1;
  for (py::ssize_t i = 1; i < array.ndim(); ++i) columns *= array.shape(i);
  return columns;
}

// Parameter arrays have one to three axes: only the first, rows, and the product of the others
// count. Capacity may exceed the rows in use, so that growing a scene copies nothing.
float* AnyShape(const py::handle& object, const std::string& name, const py::array& like) {
  using Array = py::array_t<float, py::array::c_style>;
  if (!py::isinstance<Array>(object)) {
    throw InputError(name + " must be a C-contiguous numpy array of dtype float32");
  }
  const auto array = py::reinterpret_borrow<py::array>(object);
  if (array.ndim() < 1 || Columns(array) != Columns(like)) {
    throw InputError(name + " has shape " + ShapeText(array) + ", which disagrees with the other " +
                     "arrays of its group: " + ShapeText(like));
  }
  return const_cast<float*>(static_cast<const float*>(array.data()));
}

// All arrays of a scene in one call. active_columns: the harmonics' columns in use so far; the rest
// stays 0. visible (rows,): rows with 0 keep parameters and moments. In place: no interrupt.
void Step(const py::list& params, const py::list& grads, const py::list& moment1,
          const py::list& moment2, const std::vector<std::vector<double>>& learning_rates,
          std::int64_t step, std::int64_t rows, const py::object& visible,
          const std::vector<int>& active_columns, double beta1, double beta2, double epsilon) {
  const std::size_t count = params.size();
  if (grads.size() != count || moment1.size() != count || moment2.size() != count ||
      learning_rates.size() != count ||
      (!active_columns.empty() && active_columns.size() != count)) {
    throw InputError("adam_step needs lists of the same length: params, grads, moment1, moment2, " +
                     std::string("learning_rates and, if given, active_columns"));
  }
  // Each group's four arrays must agree in columns and have `rows` rows; gradients alone may be
  // read-only. All checks come before anything is written.
  std::vector<AdamGroup> groups(count);
  for (std::size_t i = 0; i < count; ++i) {
    const auto like = py::reinterpret_borrow<py::array>(py::object(params[i]));
    AdamGroup& group = groups[i];
    const py::list* lists[4] = {&params, &grads, &moment1, &moment2};
    const char* names[4] = {"params", "grads", "moment1", "moment2"};
    float* data[4];
    for (int k = 0; k < 4; ++k) {
      const py::object object = (*lists[k])[i];
      std::string name = names[k];
      name.append("[").append(std::to_string(i)).append("]");
      data[k] = AnyShape(object, name, like);
      const auto array = py::reinterpret_borrow<py::array>(object);
      if (array.shape(0) < rows || (k != 1 && !array.writeable())) {
        throw InputError(name + " must be writable and have at least " + std::to_string(rows) +
                         " rows, found shape " + ShapeText(array));
      }
    }
    // Views of the caller's memory, used within this call only.
    group.params = data[0];
    group.gradients = data[1];
    group.moment1 = data[2];
    group.moment2 = data[3];
    group.columns = static_cast<int>(Columns(like));
    group.active_columns = active_columns.empty() ? group.columns : active_columns[i];
    group.learning_rates = learning_rates[i];
  }
  const std::uint8_t* mask = OptionalRows<std::uint8_t>(visible, "visible", rows);
  const py::gil_scoped_release release;
  AdamStep(groups, rows, step, mask, {beta1, beta2, epsilon});
}

// The step is constants and pointers; the arrays travel with it, so that they live as long.
BoundHarmonicsStep StepOfHarmonics(const py::object& params, const py::object& moment1,
                                   const py::object& moment2,
                                   const std::vector<double>& learning_rates, std::int64_t step,
                                   double beta1, double beta2, double epsilon) {
  const std::array<py::object, 3> arrays = {params, moment1, moment2};
  const char* names[] = {"params", "moment1", "moment2"};
  float* data[3];
  // The first array sets the shape that the other two must have.
  std::int64_t rows = kAny, coefficients = kAny;
  for (std::size_t i = 0; i < arrays.size(); ++i) {
    data[i] = MutableData<float>(arrays[i], names[i], {rows, coefficients, 3});
    const auto array = py::reinterpret_borrow<py::array>(arrays[i]);
    rows = array.shape(0);
    coefficients = array.shape(1);
  }
  // No gradient: the backward pass makes it row by row and steps at once.
  const AdamGroup group = {data[0],
                           nullptr,
                           data[1],
                           data[2],
                           static_cast<int>(3 * coefficients),
                           static_cast<int>(learning_rates.size()),
                           learning_rates};
  return {MakeHarmonicsStep(group, step, {beta1, beta2, epsilon}), arrays};
}

// Views of parameters and both moments, `size` rows of the capacity in use. Gaussians, not lists:
// densification moves a row of all five arrays together with its moments.
TrainingState State(const py::object& params, const py::object& moment1, const py::object& moment2,
                    std::int64_t size) {
  TrainingState state;
  state.params = MutableGaussians<float>(params);
  state.moment1 = MutableGaussians<float>(moment1);
  state.moment2 = MutableGaussians<float>(moment2);
  state.capacity = state.params.size;
  state.size = size;
  if (state.moment1.size != state.capacity || state.moment2.size != state.capacity) {
    throw InputError("params, moment1 and moment2 must have the same number of rows");
  }
  CheckState(state);
  return state;
}

// The first `size` rows of arrays that may have more.
GaussiansView<float> Rows(const py::object& params, std::int64_t size) {
  TrainingState state;
  state.params = MutableGaussians<float>(params);
  state.moment1 = state.moment2 = state.params;
  state.capacity = state.params.size;
  state.size = size;
  CheckState(state);
  return state.params;
}

// MCMC (Kheradmand et al., 2024): dead rows are moved to where `weights` say, then rows are added
// up to target_size. The random numbers are those of (seed, step, row), on any threads.
py::tuple Densify(const py::object& params, const py::object& moment1, const py::object& moment2,
                  std::int64_t size, std::int64_t target_size, const py::object& weights,
                  double dead_opacity, std::uint64_t seed, std::int64_t step) {
  const TrainingState state = State(params, moment1, moment2, size);
  const float* weight_data = ConstData<float>(weights, "weights", {size});
  McmcOptions options;
  options.dead_opacity = dead_opacity;
  options.seed = seed;
  options.step = step;
  McmcCounts counts;
  {
    const py::gil_scoped_release release;
    counts = McmcDensify(state, target_size, weight_data, options);
  }
  return py::make_tuple(counts.size, counts.relocated, counts.added);
}

// Moves the means alone, by a step that falls with opacity; random numbers as above.
void Noise(const py::object& params, std::int64_t size, double learning_rate, double noise_scale,
           std::uint64_t seed, std::int64_t step) {
  const GaussiansView<float> view = Rows(params, size);
  const py::gil_scoped_release release;
  McmcNoise(view, size, learning_rate, noise_scale, seed, step);
}

// Adds to gradients of the loss that are there already.
void Regularize(const py::object& params, std::int64_t size, const py::object& grad_logits,
                const py::object& grad_log_scales, double opacity_weight, double scale_weight) {
  const GaussiansView<float> view = Rows(params, size);
  float* logits = MutableData<float>(grad_logits, "opacity logit gradients", {size});
  float* log_scales = MutableData<float>(grad_log_scales, "log-scale gradients", {size, 3});
  const py::gil_scoped_release release;
  AddMcmcRegularizer(view.AsConst(), size, opacity_weight, scale_weight, logits, log_scales);
}

// Plan and action are two calls: the counts are known, and may be reported or refused, before
// anything changes. sums and counts: what Accumulate gathered since the last plan.
AdaptivePlan Plan(const py::object& params, std::int64_t size, const py::object& sums,
                  const py::object& counts, double gradient_threshold, double clone_scale,
                  double prune_opacity, double max_scale, std::int64_t max_gaussians) {
  const GaussiansView<float> view = Rows(params, size);
  const float* sum_data = ConstData<float>(sums, "gradient sums", {size});
  const std::int32_t* count_data = ConstData<std::int32_t>(counts, "counts", {size});
  const AdaptiveOptions options = {gradient_threshold, clone_scale, prune_opacity, max_scale,
                                   max_gaussians};
  const py::gil_scoped_release release;
  return PlanAdaptive(view, size, sum_data, count_data, options);
}

// Of the actions of each row, as numbers.
AdaptivePlan PlanOf(const py::object& actions) {
  const auto array = ReadArray<std::uint8_t>(actions, "actions", {kAny});
  AdaptivePlan plan;
  for (py::ssize_t i = 0; i < array.size(); ++i) {
    const std::uint8_t action = array.data()[i];
    if (action > static_cast<std::uint8_t>(AdaptiveAction::kSplit)) {
      throw InputError("action " + std::to_string(action) +
                       " is none of 0 (keep), 1 (prune), 2 (clone), 3 (split)");
    }
    plan.actions.push_back(static_cast<AdaptiveAction>(action));
  }
  plan.pruned = std::count(plan.actions.begin(), plan.actions.end(), AdaptiveAction::kPrune);
  plan.cloned = std::count(plan.actions.begin(), plan.actions.end(), AdaptiveAction::kClone);
  plan.split = std::count(plan.actions.begin(), plan.actions.end(), AdaptiveAction::kSplit);
  return plan;
}

// Returns the new size; clones and halves of splits follow the kept rows, with moments of 0.
std::int64_t Apply(const py::object& params, const py::object& moment1, const py::object& moment2,
                   std::int64_t size, const AdaptivePlan& plan, std::uint64_t seed,
                   std::int64_t step) {
  const TrainingState state = State(params, moment1, moment2, size);
  const py::gil_scoped_release release;
  return ApplyAdaptive(state, plan, seed, step);
}

// Also zeroes the opacities' moments, which were gathered at other values.
void Reset(const py::object& params, const py::object& moment1, const py::object& moment2,
           std::int64_t size, double max_opacity) {
  ResetOpacities(State(params, moment1, moment2, size), max_opacity);
}

// |dL/dmean| x distance is the gradient to the mean's place in the image, for any lens.
void Accumulate(const py::object& dl_dmeans, const py::object& distances, const py::object& visible,
                const py::object& max, const py::object& sum, const py::object& count) {
  const auto size = static_cast<std::int64_t>(py::len(dl_dmeans));
  const float* gradients = ConstData<float>(dl_dmeans, "gradients of the means", {size, 3});
  const float* distance_data = ConstData<float>(distances, "distances", {size});
  const std::uint8_t* mask = OptionalRows<std::uint8_t>(visible, "visible", size);
  float* max_data = MutableData<float>(max, "max", {size});
  float* sum_data = MutableData<float>(sum, "sum", {size});
  std::int32_t* count_data = MutableData<std::int32_t>(count, "count", {size});
  const py::gil_scoped_release release;
  AccumulateDensity(size, gradients, distance_data, mask, max_data, sum_data, count_data);
}

}  // namespace

void BindOptimize(pybind11::module_& m) {
  m.def("adam_step", &Step, py::arg("params"), py::arg("grads"), py::arg("moment1"),
        py::arg("moment2"), py::arg("learning_rates"), py::arg("step"), py::arg("rows"),
        py::arg("visible") = py::none(), py::arg("active_columns") = std::vector<int>(),
        py::arg("beta1") = 0.9, py::arg("beta2") = 0.999, py::arg("epsilon") = 1e-15,
        "One Adam step of several float32 arrays in place over their first `rows` rows; "
        "learning_rates: for each array a list of one rate or one an active column.");
  py::class_<BoundHarmonicsStep>(m, "HarmonicsStep",
                                 "One Adam step of the harmonics (N, K, 3), which "
                                 "Renderer.backward takes where it makes their "
                                 "gradients; learning_rates: one an active column.")
      .def(py::init(&StepOfHarmonics), py::arg("params"), py::arg("moment1"), py::arg("moment2"),
           py::arg("learning_rates"), py::arg("step"), py::arg("beta1") = 0.9,
           py::arg("beta2") = 0.999, py::arg("epsilon") = 1e-15);
  m.def("mcmc_densify", &Densify, py::arg("params"), py::arg("moment1"), py::arg("moment2"),
        py::arg("size"), py::arg("target_size"), py::arg("weights"), py::arg("dead_opacity"),
        py::arg("seed"), py::arg("step"),
        "Relocates dead rows and adds rows; returns (size, relocated, added).");
  m.def("mcmc_noise", &Noise, py::arg("params"), py::arg("size"), py::arg("learning_rate"),
        py::arg("noise_scale"), py::arg("seed"), py::arg("step"),
        "Adds the exploration noise of MCMC to the means.");
  m.def("mcmc_regularize", &Regularize, py::arg("params"), py::arg("size"), py::arg("grad_logits"),
        py::arg("grad_log_scales"), py::arg("opacity_weight"), py::arg("scale_weight"),
        "Adds the gradient of the mean opacity and mean scale to the gradients.");
  // Also made from actions, a number a row: strategies that decide in Python use the same moves.
  py::class_<AdaptivePlan>(m, "AdaptivePlan", "What adaptive densification is going to do.")
      .def(py::init(&PlanOf), py::arg("actions"))
      .def_readonly("pruned", &AdaptivePlan::pruned)
      .def_readonly("cloned", &AdaptivePlan::cloned)
      .def_readonly("split", &AdaptivePlan::split)
      .def_property_readonly("size_after", &AdaptivePlan::SizeAfter)
      .def_property_readonly("actions", [](const AdaptivePlan& plan) {
        auto actions = NewArray<std::uint8_t>({static_cast<py::ssize_t>(plan.actions.size())});
        for (std::size_t i = 0; i < plan.actions.size(); ++i) {
          actions.mutable_data()[i] = static_cast<std::uint8_t>(plan.actions[i]);
        }
        return actions;
      });
  m.def("plan_adaptive", &Plan, py::arg("params"), py::arg("size"), py::arg("sums"),
        py::arg("counts"), py::arg("gradient_threshold"), py::arg("clone_scale"),
        py::arg("prune_opacity"), py::arg("max_scale"), py::arg("max_gaussians"),
        "Decides which rows to prune (1), clone (2) and split (3).");
  m.def("apply_adaptive", &Apply, py::arg("params"), py::arg("moment1"), py::arg("moment2"),
        py::arg("size"), py::arg("plan"), py::arg("seed"), py::arg("step"),
        "Carries a plan out in place and returns the new size.");
  m.def("reset_opacities", &Reset, py::arg("params"), py::arg("moment1"), py::arg("moment2"),
        py::arg("size"), py::arg("max_opacity"), "Limits all opacities and zeroes their moments.");
  m.def("accumulate_density", &Accumulate, py::arg("dl_dmeans"), py::arg("distances"),
        py::arg("visible"), py::arg("max"), py::arg("sum"), py::arg("count"),
        "Gathers |dL/dmean| x distance: its maximum, half its sum, and a count.");
}

}  // namespace gsut::bindings
