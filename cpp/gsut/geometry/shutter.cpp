// Line times and the interpolated pose with its derivatives.
#include "gsut/geometry/shutter.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "gsut/base/errors.h"
#include "gsut/geometry/rotation_vector.h"

namespace gsut {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr struct {
  ShutterDirection direction;
  const char* name;
} kDirections[] = {
    {ShutterDirection::kGlobal, "global"},
    {ShutterDirection::kTopToBottom, "top_to_bottom"},
    {ShutterDirection::kBottomToTop, "bottom_to_top"},
    {ShutterDirection::kLeftToRight, "left_to_right"},
    {ShutterDirection::kRightToLeft, "right_to_left"},
};

}  // namespace

Shutter Shutter::Named(std::string_view direction, std::string_view parity) {
  Shutter shutter;
  std::string known;
  bool found = false;
  for (const auto& entry : kDirections) {
    if (direction == entry.name) {
      shutter.direction = entry.direction;
      found = true;
    }
    known += (known.empty() ? "" : ", ") + std::string(entry.name);
  }
  if (!found) {
    throw InputError("unknown shutter direction '" + std::string(direction) + "'; known: " + known);
  }
  if (parity != "" && parity != "gsplat") {
    throw InputError("unknown shutter parity '" + std::string(parity) +
                     "'; known: gsplat, or none");
  }
  shutter.gsplat_parity = parity == "gsplat";
  return shutter;
}

std::string Shutter::DirectionName() const {
  for (const auto& entry : kDirections) {
    if (entry.direction == direction) return entry.name;
  }
  return "";
}

// Lines are rows or columns, by the direction of the readout.
int Shutter::NumLines(int width, int height) const {
  return IsGlobal() ? 1 : RunsOverRows() ? height : width;
}

// The middle of a line's exposure, in readouts. gsplat takes 0 and 1 for the outer lines instead.
double Shutter::LineTime(int line, int width, int height) const {
  if (IsGlobal()) return 0.0;
  const int lines = NumLines(width, height);
  const bool backwards =
      direction == ShutterDirection::kBottomToTop || direction == ShutterDirection::kRightToLeft;
  const int read = backwards ? lines - 1 - line : line;
  if (gsplat_parity) return lines > 1 ? static_cast<double>(read) / (lines - 1) : 0.0;
  return (read + 0.5) / lines;
}

// Continuous between lines, so that a projection can be solved for the time it is seen at.
double Shutter::PixelTime(double u, double v, int width, int height) const {
  if (IsGlobal()) return 0.0;
  const int lines = NumLines(width, height);
  const double first = LineTime(0, width, height);
  const double step = lines > 1 ? LineTime(1, width, height) - first : 0.0;
  return first + ((RunsOverRows() ? v : u) - 0.5) * step;
}

// The rotation goes the shortest way at a steady speed, and so does the centre: the camera's own
// motion. gsplat moves the translation evenly, which bends the centre's path as the camera turns.
Pose CameraMotion::At(double t) const {
  if (shutter.IsGlobal() || t == 0.0) return start;
  if (t == 1.0) return end;
  Pose pose;
  pose.rotation =
      RotationOfVector(t * VectorOfRotation(end.rotation * start.rotation.transpose())) *
      start.rotation;
  if (shutter.gsplat_parity) {
    pose.translation = (1.0 - t) * start.translation + t * end.translation;
  } else {
    const Vector3d center = (1.0 - t) * start.CenterInSource() + t * end.CenterInSource();
    pose.translation = -(pose.rotation * center);
  }
  return pose;
}

MotionJacobian CameraMotion::JacobianAt(double t) const {
  MotionJacobian out;
  out.from_start.setZero();
  out.from_end.setZero();
  if (shutter.IsGlobal()) {
    out.from_start.setIdentity();
    return out;
  }
  // R(t) = exp(t phi) R0 with phi = log(R1 R0^T). A turn w1 of R1 and w0 of R0 changes phi by
  // J^-1(phi) w1 - J^-1(-phi) w0, so R(t) turns by t J(t phi) of that plus exp(t phi) w0.
  const Vector3d phi = VectorOfRotation(end.rotation * start.rotation.transpose());
  const Matrix3d turned = RotationOfVector(t * phi);
  const Matrix3d left = t * LeftJacobian(t * phi);
  const Matrix3d turn_start = turned - left * InverseLeftJacobian(-phi);
  const Matrix3d turn_end = left * InverseLeftJacobian(phi);
  out.from_start.bottomRightCorner<3, 3>() = turn_start;
  out.from_end.bottomRightCorner<3, 3>() = turn_end;
  const Matrix3d rotation = turned * start.rotation;
  if (!shutter.gsplat_parity) {
    // The centre c = -R^T t moves by -R^T v, whatever w is; it is what is interpolated.
    out.from_start.topLeftCorner<3, 3>() = (1.0 - t) * rotation * start.rotation.transpose();
    out.from_end.topLeftCorner<3, 3>() = t * rotation * end.rotation.transpose();
    return out;
  }
  // The translation moves by v + w x translation at either end and at t.
  const Vector3d translation = (1.0 - t) * start.translation + t * end.translation;
  const Matrix3d cross = Skew(translation);
  out.from_start.topLeftCorner<3, 3>() = (1.0 - t) * Matrix3d::Identity();
  out.from_end.topLeftCorner<3, 3>() = t * Matrix3d::Identity();
  out.from_start.topRightCorner<3, 3>() = cross * turn_start - (1.0 - t) * Skew(start.translation);
  out.from_end.topRightCorner<3, 3>() = cross * turn_end - t * Skew(end.translation);
  return out;
}

}  // namespace gsut
