// Pixel by pixel in double: first each pixel's own terms, then what its neighbours' normals ask of
// its distance, gathered, so that sums have one order.
#include "gsut/loss/surface.h"

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>
#include <numeric>

#include "gsut/base/parallel.h"

namespace gsut {
namespace {

using Eigen::Map;
using Eigen::Vector3d;

constexpr double kCovered = 0.5;  // least alpha of a pixel whose distance says something
// Neighbours whose distances differ by more, relative, lie on two sides of an edge.
constexpr double kEdge = 0.1;

template <class T>
Vector3d VectorAt(const T* values, std::int64_t pixel) {
  return Map<const Eigen::Matrix<T, 3, 1>>(values + 3 * pixel).template cast<double>();
}

template <class T>
class Pixels {
 public:
  Pixels(const SurfaceRender<T>& render, const SurfaceWeights& weights,
         const SurfaceGradients<T>& out)
      : render_(render),
        weights_(weights),
        out_(out),
        distance_(static_cast<std::size_t>(render.height * render.width), 0.0),
        to_x_(distance_.size(), Vector3d::Zero()),
        to_y_(distance_.size(), Vector3d::Zero()) {}

  // Three passes with a barrier between: distances; each pixel's own terms, which leave gradients
  // to the differences of its neighbours' points; and what each pixel gets from its neighbours. A
  // pixel writes to itself only, so that no sum depends on threads.
  SurfaceTerms Run() {
    const std::int64_t pixels = render_.height * render_.width;
    std::vector<std::int64_t> known(static_cast<std::size_t>(render_.height), 0);
    EachRow([&](std::int64_t row) {
      for (std::int64_t p = row * render_.width; p < (row + 1) * render_.width; ++p) {
        const double alpha = static_cast<double>(render_.alpha[p]);
        if (!(alpha >= kCovered) || VectorAt(render_.directions, p).isZero(0.0)) continue;
        distance_[static_cast<std::size_t>(p)] = static_cast<double>(render_.depth[p]) / alpha;
        known[static_cast<std::size_t>(row)] += HasKnown(p);
      }
    });
    // Means over the image, and over the pixels with a known distance: steps of views of any size
    // agree.
    each_ = 1.0 / static_cast<double>(pixels);
    const std::int64_t all_known = std::accumulate(known.begin(), known.end(), std::int64_t{0});
    each_known_ = all_known == 0 ? 0.0 : 1.0 / static_cast<double>(all_known);
    std::vector<SurfaceTerms> terms(static_cast<std::size_t>(render_.height));
    EachRow([&](std::int64_t row) {
      for (std::int64_t column = 0; column < render_.width; ++column) {
        OwnTerms(row, column, &terms[static_cast<std::size_t>(row)]);
      }
    });
    EachRow([&](std::int64_t row) {
      for (std::int64_t column = 0; column < render_.width; ++column) FromNeighbours(row, column);
    });
    SurfaceTerms sum;
    for (const SurfaceTerms& part : terms) {
      sum.normal += part.normal;
      sum.distortion += part.distortion;
      sum.known += part.known;
    }
    return sum;
  }

 private:
  template <class Visit>
  void EachRow(const Visit& visit) const {
    ParallelFor(render_.height, 4, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t row = begin; row < end; ++row) visit(row);
    });
  }
  double Distance(std::int64_t pixel) const { return distance_[static_cast<std::size_t>(pixel)]; }
  bool HasKnown(std::int64_t pixel) const {
    return render_.known != nullptr && render_.known[pixel] > T(0);
  }
  Vector3d PointAt(std::int64_t pixel) const {
    return VectorAt(render_.origins, pixel) + Distance(pixel) * VectorAt(render_.directions, pixel);
  }
  // Whether two pixels have a distance and no edge lies between them.
  bool AreOne(std::int64_t a, std::int64_t b) const {
    const double one = Distance(a), other = Distance(b);
    return one > 0.0 && other > 0.0 && std::abs(one - other) <= kEdge * std::min(one, other);
  }

  // The terms about a pixel itself, at its expected distance t = depth / alpha:
  //   distortion / (t^2 + extent^2): relative far away, absolute near by;
  //   |known / t - 1|, whose gradient to t goes on to depth and alpha by the quotient's rule;
  //   alpha - sum . n: the blended normals against the normal n of the surface through the points
  //   of the four neighbours, along cross(y, x) of their differences x and y.
  // The gradients to x and y, cross(g, y) and cross(x, g) for the gradient g to their product, are
  // left for FromNeighbours.
  void OwnTerms(std::int64_t row, std::int64_t column, SurfaceTerms* terms) {
    const std::int64_t p = row * render_.width + column;
    out_.alpha[p] = out_.depth[p] = out_.distortion[p] = T(0);
    Map<Eigen::Matrix<T, 3, 1>> to_normals(out_.normals + 3 * p);
    to_normals.setZero();
    const double distance = Distance(p), alpha = static_cast<double>(render_.alpha[p]);
    if (!(distance > 0.0)) return;
    const double of_distortion =
        weights_.distortion * each_ / (distance * distance + weights_.extent * weights_.extent);
    out_.distortion[p] = static_cast<T>(of_distortion);
    terms->distortion += of_distortion * static_cast<double>(render_.distortion[p]);
    if (HasKnown(p)) {
      const double ratio = static_cast<double>(render_.known[p]) / distance;
      const double weight = weights_.known * each_known_;
      terms->known += weight * std::abs(ratio - 1.0);
      const double to_distance = weight * (ratio > 1.0 ? -1.0 : 1.0) * ratio / distance;
      out_.depth[p] = static_cast<T>(to_distance / alpha);
      out_.alpha[p] = static_cast<T>(-to_distance * distance / alpha);
    }
    if (row == 0 || column == 0 || row + 1 == render_.height || column + 1 == render_.width) return;
    const std::int64_t left = p - 1, right = p + 1, up = p - render_.width,
                       down = p + render_.width;
    if (!(AreOne(left, p) && AreOne(p, right) && AreOne(up, p) && AreOne(p, down))) return;
    const Vector3d x = PointAt(right) - PointAt(left), y = PointAt(down) - PointAt(up);
    Vector3d across = y.cross(x);
    const double length = across.norm();
    if (!(length > 0.0)) return;
    // Towards the camera: a mirrored image turns the other way round.
    const double sign = across.dot(VectorAt(render_.directions, p)) > 0.0 ? -1.0 : 1.0;
    // Normals are blended as colours 0.5 + 0.5 n over 0.5, see facing_axes: 2 value - 1 is their
    // sum.
    const Vector3d normal = sign / length * across;
    const Vector3d sum = 2.0 * VectorAt(render_.normals, p) - Vector3d::Ones();
    const double weight = weights_.normal * each_;
    terms->normal += weight * (alpha - sum.dot(normal));
    out_.alpha[p] += static_cast<T>(weight);
    to_normals = (-2.0 * weight * normal).cast<T>();
    // n = sign across / |across|, so that dn/dacross = sign (I - n n^T) / |across|.
    const Vector3d to_across = -weight * sign / length * (sum - normal * normal.dot(sum));
    to_x_[static_cast<std::size_t>(p)] = to_across.cross(y);
    to_y_[static_cast<std::size_t>(p)] = x.cross(to_across);
  }

  // Gathers what a pixel's distance does to the normals of its neighbours: its point is the end of
  // one difference and the start of another, so it gets theirs with either sign.
  void FromNeighbours(std::int64_t row, std::int64_t column) {
    const std::int64_t p = row * render_.width + column;
    const double distance = Distance(p);
    if (!(distance > 0.0)) return;
    const auto at = [](std::int64_t pixel) { return static_cast<std::size_t>(pixel); };
    Vector3d to_point = Vector3d::Zero();
    if (column > 0) to_point += to_x_[at(p - 1)];
    if (column + 1 < render_.width) to_point -= to_x_[at(p + 1)];
    if (row > 0) to_point += to_y_[at(p - render_.width)];
    if (row + 1 < render_.height) to_point -= to_y_[at(p + render_.width)];
    // p = o + t d and t = depth / alpha: dt/ddepth = 1 / alpha, dt/dalpha = -t / alpha.
    const double alpha = static_cast<double>(render_.alpha[p]);
    const double to_distance = to_point.dot(VectorAt(render_.directions, p));
    out_.depth[p] += static_cast<T>(to_distance / alpha);
    out_.alpha[p] -= static_cast<T>(to_distance * distance / alpha);
  }

  const SurfaceRender<T>& render_;
  const SurfaceWeights& weights_;
  const SurfaceGradients<T>& out_;
  std::vector<double> distance_;       // expected; 0: says nothing
  std::vector<Vector3d> to_x_, to_y_;  // to the differences of a pixel's neighbours
  double each_ = 0, each_known_ = 0;   // what a pixel counts
};

}  // namespace

template <class T>
SurfaceTerms SurfaceLoss(const SurfaceRender<T>& render, const SurfaceWeights& weights,
                         const SurfaceGradients<T>& gradients) {
  return Pixels<T>(render, weights, gradients).Run();
}

template SurfaceTerms SurfaceLoss(const SurfaceRender<float>&, const SurfaceWeights&,
                                  const SurfaceGradients<float>&);
template SurfaceTerms SurfaceLoss(const SurfaceRender<double>&, const SurfaceWeights&,
                                  const SurfaceGradients<double>&);

}  // namespace gsut
