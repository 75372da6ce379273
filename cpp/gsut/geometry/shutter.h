// A camera that moves while its image is read out: which line is read when, and where the camera is
// then.
#pragma once

#include <Eigen/Core>
#include <string>
#include <string_view>

#include "gsut/geometry/pose.h"

namespace gsut {

// The edge of the image that is read first and the one that is read last. Global: all at once.
enum class ShutterDirection { kGlobal, kTopToBottom, kBottomToTop, kLeftToRight, kRightToLeft };

// Times run from 0 at the start pose to 1 at the end pose; a line is a row, or a column if the
// shutter runs sideways.
struct Shutter {
  ShutterDirection direction = ShutterDirection::kGlobal;
  // gsut: the start and end poses are those at the two edges of the image, t = (line + 0.5) / n,
  // and the camera's centre moves on a straight line. gsplat: they are those of the first and the
  // last line, t = line / (n - 1), and the translation of camera_from_world is interpolated.
  bool gsplat_parity = false;

  // direction: "global", "top_to_bottom", "bottom_to_top", "left_to_right", "right_to_left";
  // parity: "" or "gsplat". Any other name throws InputError with the known ones.
  static Shutter Named(std::string_view direction, std::string_view parity = "");
  std::string DirectionName() const;

  bool IsGlobal() const { return direction == ShutterDirection::kGlobal; }
  bool RunsOverRows() const {
    return direction == ShutterDirection::kTopToBottom ||
           direction == ShutterDirection::kBottomToTop;
  }
  // Number of lines of an image, and the line that holds pixel (x, y); 0 for a global shutter.
  int NumLines(int width, int height) const;
  int LineOf(int x, int y) const { return IsGlobal() ? 0 : RunsOverRows() ? y : x; }
  // Time at which a line of an image of this size is read; 0 for a global shutter.
  double LineTime(int line, int width, int height) const;
  // Time at which the line through a pixel coordinate is read, continuous in it and not limited to
  // [0, 1]: the centre of a line has the line's own time.
  double PixelTime(double u, double v, int width, int height) const;
};

using Matrix6d = Eigen::Matrix<double, 6, 6>;
using Vector6d = Eigen::Matrix<double, 6, 1>;

// How a pose between two answers to them: its left perturbation is
// xi(t) = from_start xi_start + from_end xi_end, xi = (v, w) as ExpPose takes it.
struct MotionJacobian {
  Matrix6d from_start, from_end;
};

// A camera that moves from one pose to another during the exposure; camera_from_world at each time.
struct CameraMotion {
  Pose start, end;
  Shutter shutter;

  CameraMotion() = default;
  // A camera that stands still; implicit, since a pose alone means just that.
  CameraMotion(const Pose& camera_from_world)  // NOLINT(google-explicit-constructor)
      : start(camera_from_world), end(camera_from_world) {}
  CameraMotion(const Pose& start_pose, const Pose& end_pose, const Shutter& how)
      : start(start_pose), end(end_pose), shutter(how) {}

  // The pose at a time; times outside [0, 1] go on at the same speed. Rotation on the shortest
  // great arc.
  Pose At(double t) const;
  MotionJacobian JacobianAt(double t) const;
  // In the middle of the exposure (the start for a global shutter): what Gaussians are ordered and
  // shaded by.
  double MiddleTime() const { return shutter.IsGlobal() ? 0.0 : 0.5; }
  Pose Middle() const { return At(MiddleTime()); }
};

}  // namespace gsut
