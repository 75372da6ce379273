// How much a lens bends around each direction: what the errors of local approximations rest on.
#pragma once

#include <memory>
#include <vector>

#include "gsut/cameras/camera.h"
#include "gsut/projection/lens_bound.h"

namespace gsut {

// Bend (lens_bound.h) of one camera, the largest over a cap of directions: bounded over patches of
// 2.8 degrees by interval arithmetic, not sampled. A cap that is not wholly inside the domain, that
// holds a panorama's pole or a kink of the lens, is infinite.
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
