// Finds the exact box of the pixels that see a Gaussian, through any lens, by halving the image.
#pragma once

#include <memory>
#include <vector>

#include "gsut/cameras/camera.h"

namespace gsut {

// The rays that come within D^2 < cutoff of a Gaussian, in the camera frame: with A = S^-1 R^T and
// w = A (mean - the ray's origin), those with w.A d > 0 and |w|^2 - (w.A d)^2 / |A d|^2 < cutoff.
struct RayCone {
  double whiten[3][3];  // A
  double center[3];     // A mean
  double cutoff;
  double mean[3];
  double radius;  // of the sphere around the mean that holds the ellipsoid
};

// Bounds of blocks of 2^k x 2^k pixels: the smallest cone (axis and half angle) around their rays,
// and where rays do not meet the smallest ball around their origins.
class RayPyramid {
 public:
  explicit RayPyramid(const Camera& camera);

  // The box (low_u, high_u, low_v, high_v) of the centres of all pixels whose ray lies in the cone;
  // false if there is none. Exact: pixels are tested one by one where it matters.
  // rays: those of the camera it was built for.
  bool Box(const RayTable& rays, const RayCone& cone, double box[4]) const;

 private:
  struct Node {
    float axis[3];
    float chord;  // largest |ray - axis|; negative: no pixel has a ray
    float origin[3];
    float spread;  // largest |origin of a ray - origin|; both 0 for a central lens
  };
  struct Level {
    int width, height;
    std::vector<Node> nodes;
  };
  static bool MayHold(const Node& node, const RayCone& cone);
  static bool MayHoldLine(const Node& node, const RayCone& cone);
  void Search(const RayTable& rays, const RayCone& cone, std::size_t level, int x, int y,
              int box[4]) const;

  int width_, height_;
  std::vector<Level> levels_;  // level k: blocks of kLeaf x 2^k pixels a side
};

// The pyramid of a camera; the latest ones are kept.
std::shared_ptr<const RayPyramid> PyramidOf(const Camera& camera);

}  // namespace gsut
