// How much a lens bends around each direction: what the errors of local approximations rest on.
#pragma once

#include <memory>
#include <vector>

#include "gsut/cameras/camera.h"

namespace gsut {

// With f(p) the pixel of the point p in the camera frame (constant along rays), at |p| = 1:
// second = the largest |D^2 f(p)[h, h]| over unit h, third the largest |D^3 f(p)[h, h, h]|, in
// pixels, each for the worse of u and v; at other distances they fall as 1/|p|^2 and 1/|p|^3.
// Infinite where the lens has no pixel nearby.
struct Bend {
  float second, third;
};

// Bend of one camera, the largest over a cap of directions. Derivatives are exact to first order
// (dual numbers) and differences beyond; they are sampled every 3 degrees; caps are widened by
// that, the second derivative by what the third can add in between, and both by a fifth. Near a
// panorama's poles and the edge of the domain they count as infinite.
class LensBend {
 public:
  explicit LensBend(const Camera& camera);

  // Caps of at most asin(kLargestSine) around the mean; larger ones are infinite.
  static constexpr double kLargestSine = 0.35;
  Bend At(const double mean[3], double sine) const;

  // The table by level (caps of sine below kSines[level]), face of a cube (+x, -x, +y, -y, +z, -z),
  // row and column; row and column are the other two coordinates in order, over the largest.
  static constexpr int kLevels = 4;
  static constexpr double kSines[kLevels] = {0.02, 0.06, 0.15, kLargestSine};
  static constexpr int kFaces = 6;
  static constexpr int kCells = 16;  // along a face's edge; 5.6 degrees and less
  const Bend* table() const { return table_.data(); }

 private:
  std::vector<Bend> table_;
};

// The bend of a camera; the latest ones are kept.
std::shared_ptr<const LensBend> BendOf(const Camera& camera);

}  // namespace gsut
