// Binds gsut/geometry: 4x4 matrices in and out.
//
// A pose is camera_from_world, rigid. Pose is not a class of the Python module: matrices go in and
// come out, so that numpy composes and inverts them.
#include "bindings/geometry.h"

#include <pybind11/pybind11.h>

#include "bindings/arrays.h"
#include "bindings/module.h"
#include "gsut/geometry/camera_chain.h"

namespace gsut::bindings {

// A camera_from_world: (4, 4) numbers, or any object with such a `matrix`. Pose::FromMatrix makes
// the rotation orthonormal to the last digit, and throws InputError for what is no rigid transform.
Pose ReadPose(const py::handle& object) {
  py::object matrix = py::reinterpret_borrow<py::object>(object);
  if (py::hasattr(matrix, "matrix")) matrix = matrix.attr("matrix");
  const auto array = ReadArray<double>(matrix, "camera_from_world", {4, 4});
  return Pose::FromMatrix(
      Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(array.data()));
}

// A motion as it is, or a pose, which stands still: where one is taken, so is the other.
CameraMotion ReadMotion(const py::handle& object) {
  if (py::isinstance<CameraMotion>(object)) return object.cast<CameraMotion>();
  return CameraMotion(ReadPose(object));
}

// A new (4, 4) float64 array; the last row is 0 0 0 1.
py::array_t<double> WritePose(const Pose& pose) {
  py::array_t<double> array({4, 4});
  Eigen::Map<Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(array.mutable_data()) = pose.Matrix();
  return array;
}

namespace {

// Values: neither class can be changed once made, so that a renderer may keep what it derived from
// one.
void BindShutter(py::module_& m) {
  py::class_<Shutter>(m, "Shutter", R"doc(
How an image is read out: all at once, or line by line while the camera moves.

Args:
    direction: "global", "top_to_bottom", "bottom_to_top", "left_to_right" or "right_to_left": the
        edge that is read first and the one that is read last.
    parity: None: the start and end poses are those at the two edges of the image, line i of n is
        read at t = (i + 0.5) / n, and the camera's centre moves on a straight line. "gsplat": they
        are those of the first and the last line, t = i / (n - 1), and the translation of
        camera_from_world is interpolated.

Raises:
    InputError: an unknown direction or parity; the known ones are listed.
)doc")
      .def(py::init([](const py::object& direction, const py::object& parity) {
             if (!py::isinstance<py::str>(direction)) {
               throw InputError("direction must be text, found " +
                                std::string(py::str(py::type::of(direction).attr("__name__"))));
             }
             return Shutter::Named(std::string(py::str(direction)),
                                   parity.is_none() ? std::string() : std::string(py::str(parity)));
           }),
           py::arg("direction") = "global", py::arg("parity") = py::none())
      .def_property_readonly("direction", &Shutter::DirectionName,
                             "The order of the lines, by name.")
      .def_property_readonly(
          "parity",
          [](const Shutter& shutter) -> py::object {
            if (!shutter.gsplat_parity) return py::none();
            return py::str("gsplat");
          },
          "Whose convention of times it follows; None: gsut's.")
      .def_property_readonly("is_global", &Shutter::IsGlobal, "Whether all lines share one time.")
      .def(
          "line_times",
          [](const Shutter& shutter, int width, int height) {
            const int lines = shutter.NumLines(width, height);
            auto times = NewArray<double>({lines});
            for (int i = 0; i < lines; ++i) {
              times.mutable_at(i) = shutter.LineTime(i, width, height);
            }
            return times;
          },
          py::arg("width"), py::arg("height"), R"doc(
Times at which the lines of an image are read, from 0 at the start pose to 1 at the end pose.

Args:
    width, height: of the image, pixels.

Returns:
    (n,) float64, one a row, or a column where the shutter runs sideways; a single 0 if it is global.
)doc");
  py::class_<CameraMotion>(m, "CameraMotion", R"doc(
A camera that moves from one pose to another while its image is read out.

Args:
    start: (4, 4) camera_from_world at time 0, rigid, or an object with such a `matrix`.
    end: (4, 4) camera_from_world at time 1, likewise.
    shutter: when each line is read.

Raises:
    InputError: a pose that is no rigid transform.
)doc")
      .def(py::init([](const py::handle& start, const py::handle& end, const Shutter& shutter) {
             return CameraMotion(ReadPose(start), ReadPose(end), shutter);
           }),
           py::arg("start"), py::arg("end"), py::arg("shutter"))
      .def_property_readonly(
          "start", [](const CameraMotion& motion) { return WritePose(motion.start); },
          "(4, 4) camera_from_world at time 0.")
      .def_property_readonly(
          "end", [](const CameraMotion& motion) { return WritePose(motion.end); },
          "(4, 4) camera_from_world at time 1.")
      .def_readonly("shutter", &CameraMotion::shutter, "When each line is read.")
      // Also beyond the readout: exposures before and after it go on at the same speed.
      .def(
          "at", [](const CameraMotion& motion, double t) { return WritePose(motion.At(t)); },
          py::arg("t"), R"doc(
The pose at a time: rotation by slerp, centre on a straight line.

Args:
    t: 0 at the start pose, 1 at the end pose; not limited to between.

Returns:
    (4, 4) float64 camera_from_world.
)doc");
}

}  // namespace

void BindGeometry(py::module_& m) {
  BindShutter(m);
  m.def(
      "exp_pose",
      [](const py::handle& xi) {
        const auto array = ReadArray<double>(xi, "xi", {6});
        return WritePose(ExpPose(Eigen::Map<const Eigen::Matrix<double, 6, 1>>(array.data())));
      },
      py::arg("xi"), R"doc(
The rigid transform of a twist, in closed form: what `Gradients.pose` is the gradient to.

Args:
    xi: (6,) translation v and rotation vector w in camera axes; scene units and radians.

Returns:
    (4, 4) float64 exp(v, w): the pose moved by it is exp_pose(xi) @ camera_from_world.

Raises:
    InputError: not 6 numbers.
)doc");
  // In camera_from_world itself, as gsplat's shutters have it; CameraMotion moves the centre.
  m.def(
      "interpolate_pose",
      [](const py::handle& start, const py::handle& end, double t) {
        return WritePose(Interpolate(ReadPose(start), ReadPose(end), t));
      },
      py::arg("start"), py::arg("end"), py::arg("t"),
      "Pose between two: translation lerp, rotation slerp.");
  m.def(
      "checked_pose", [](const py::handle& matrix) { return WritePose(ReadPose(matrix)); },
      py::arg("matrix"), "The pose with its rotation made orthonormal; InputError if it is none.");
  // Velocities are six numbers in Python, too: three of the centre's shift in world axes, three of
  // the turn in camera axes, over the whole readout.
  m.def(
      "velocity_between",
      [](const py::handle& start, const py::handle& end) {
        auto velocity = NewArray<double>({6});
        Eigen::Map<Velocity>(velocity.mutable_data()) =
            VelocityBetween(ReadPose(start), ReadPose(end));
        return velocity;
      },
      py::arg("start"), py::arg("end"),
      "Shift of the centre in the world and turn in the camera frame from one pose to another.");
  m.def(
      "moved_pose",
      [](const py::handle& middle, const py::handle& velocity, double time) {
        const auto array = ReadArray<double>(velocity, "velocity", {6});
        return WritePose(
            MovedPose(ReadPose(middle), Eigen::Map<const Velocity>(array.data()), time));
      },
      py::arg("middle"), py::arg("velocity"), py::arg("time"),
      "camera_from_world at a time of a rolling readout, -0.5 to 0.5, of a camera that moves by "
      "velocity (shift of the centre, turn) in the whole of it.");
}

}  // namespace gsut::bindings
