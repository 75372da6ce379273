// A camera without its pose: lens, parameters and image size. Dispatches once a batch.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "gsut/cameras/lens_registry.h"

namespace gsut {

// One unit ray a pixel centre, row by row.
struct RayTable {
  std::vector<double> rays;         // (height, width, 3); NaN where there is none
  std::vector<std::uint8_t> valid;  // (height, width); 0 where the pixel has no ray
  std::vector<double> origins;      // (height, width, 3), NaN likewise; empty for a central lens
};

// Immutable and cheap to copy: copies share the parameters, the domain and the ray table. Points
// are in the camera frame (x right, y down, z forward); the pixel (0.5, 0.5) is the centre of the
// top-left pixel. Valid means inside the lens' one-to-one domain; whether the pixel lies inside the
// image is another question. Same bits on any number of threads.
class Camera {
 public:
  // params: see the lens' file under models/. valid_field_angle (radians): the angle up to which
  // the calibration is trusted; points and pixels beyond it are invalid. Infinity: the whole
  // domain. Throws InputError: unknown model, wrong number of parameters, no lens, size or angle <=
  // 0.
  Camera(std::string_view model, std::vector<double> params, int width, int height,
         double valid_field_angle = kInfinity);

  LensModel lens() const;
  std::string model() const;
  const std::vector<double>& params() const;
  int num_params() const { return static_cast<int>(params().size()); }
  int width() const;
  int height() const;
  double valid_field_angle() const;
  // The lens' domain, cut at the valid field angle: what Lens::Project wants.
  const LensDomain& domain() const;
  // Radians: the domain is angle from the axis < MaxAngle().
  double MaxAngle() const { return domain().max_angle; }
  // All rays start at the camera's origin.
  bool IsCentral() const;
  // All rays look along the axis; nearness is z, not the distance from the origin.
  bool IsParallel() const;

  // points (count, 3) of any length but 0 -> pixels (count, 2), valid (count). Invalid: NaN pixels.
  void Project(std::int64_t count, const double* points, double* pixels, std::uint8_t* valid) const;

  // pixels (count, 2) -> unit rays (count, 3), valid (count). Invalid: NaN rays. Where valid,
  // projecting the ray gives the pixel to kInverseTolerance.
  void Unproject(std::int64_t count, const double* pixels, double* rays, std::uint8_t* valid) const;

  // As Unproject, with the origins (count, 3) of the rays in the camera frame: 0 for a central
  // lens.
  void UnprojectLines(std::int64_t count, const double* pixels, double* origins, double* rays,
                      std::uint8_t* valid) const;

  // As Project, with dpixel_dpoint (count, 2, 3) and dpixel_dparams (count, 2, num_params), exact
  // (forward mode) and NaN where invalid. Either may be null.
  void ProjectJacobian(std::int64_t count, const double* points, double* pixels,
                       std::uint8_t* valid, double* dpixel_dpoint, double* dpixel_dparams) const;

  // The same to the chosen parameters only, which takes time by their number: dpixel_dparams
  // (count, 2, chosen.size()) in their order. chosen: different indices of parameters.
  void ProjectJacobian(std::int64_t count, const double* points, double* pixels,
                       std::uint8_t* valid, double* dpixel_dpoint, double* dpixel_dparams,
                       std::span<const int> chosen) const;

  // The same lens on an image resized to this size: intrinsics scaled about the pixel corner (0,
  // 0).
  Camera Resized(int width, int height) const;

  // The same lens trusted up to this angle (radians).
  Camera WithValidFieldAngle(double valid_field_angle) const;

  // The rays of all pixel centres, built on the first call (in parallel, thread-safe) and kept.
  // Each is checked: a pixel whose ray does not project back to within 1e-6 px is masked.
  const RayTable& Rays() const;

  // The same table, shared: it expires with the last copy of the camera.
  std::shared_ptr<const RayTable> SharedRays() const;

  // Same lens, parameters, size and valid field angle.
  friend bool operator==(const Camera& a, const Camera& b);

 private:
  struct State;
  std::shared_ptr<const State> state_;
};

}  // namespace gsut
