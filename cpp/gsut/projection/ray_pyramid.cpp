// Building and searching the pyramid of ray bundles.
#include "gsut/projection/ray_pyramid.h"

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <list>
#include <mutex>

namespace gsut {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr int kLeaf = 4;  // pixels a side of the smallest block
constexpr std::size_t kKept = 16;
constexpr float kFloatSlack = 1e-6f;  // rounding of a block's axis to float

Matrix3d Whiten(const RayCone& cone) {
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(&cone.whiten[0][0]);
}

Vector3d OriginOf(const RayTable& rays, std::size_t p) {
  if (rays.origins.empty()) return Vector3d::Zero();
  return Eigen::Map<const Vector3d>(&rays.origins[3 * p]);
}

}  // namespace

// A node stands for a block's rays: their mean direction, the largest chord to it, and, where rays
// have origins of their own, the mean origin and the spread about it. Blocks double from level to
// level, each made from all its rays, until one holds the image.
RayPyramid::RayPyramid(const Camera& camera) : width_(camera.width()), height_(camera.height()) {
  const RayTable& rays = camera.Rays();
  const auto blocks = [](int pixels) { return (pixels + kLeaf - 1) / kLeaf; };
  Level level = {blocks(width_), blocks(height_), {}};
  for (int size = kLeaf;; size *= 2) {
    level.nodes.resize(static_cast<std::size_t>(level.width) *
                       static_cast<std::size_t>(level.height));
    for (int by = 0; by < level.height; ++by) {
      for (int bx = 0; bx < level.width; ++bx) {
        const int x1 = std::min((bx + 1) * size, width_), y1 = std::min((by + 1) * size, height_);
        const auto for_each = [&](auto&& visit) {
          for (int y = by * size; y < y1; ++y) {
            for (int x = bx * size; x < x1; ++x) {
              const std::size_t p = static_cast<std::size_t>(y) * width_ + x;
              if (rays.valid[p]) {
                visit(Eigen::Map<const Vector3d>(&rays.rays[3 * p]), OriginOf(rays, p));
              }
            }
          }
        };
        Vector3d sum = Vector3d::Zero(), origins = Vector3d::Zero();
        int count = 0;
        for_each([&](const Vector3d& ray, const Vector3d& origin) {
          sum += ray;
          origins += origin;
          ++count;
        });
        Node& node = level.nodes[static_cast<std::size_t>(by) * level.width + bx];
        const Vector3d axis = sum.norm() > 0.0 ? sum.normalized() : Vector3d::UnitZ();
        origins /= std::max(count, 1);
        Eigen::Map<Eigen::Vector3f>(node.axis) = axis.cast<float>();
        Eigen::Map<Eigen::Vector3f>(node.origin) = origins.cast<float>();
        double chord = 0.0, spread = 0.0;
        for_each([&](const Vector3d& ray, const Vector3d& origin) {
          chord = std::max(chord, (ray - axis).norm());
          spread = std::max(spread, (origin - origins).norm());
        });
        node.chord = count > 0 ? static_cast<float>(chord) + kFloatSlack : -1.0f;
        const double farthest = origins.cwiseAbs().maxCoeff() + spread;
        node.spread = static_cast<float>(spread + kFloatSlack * farthest);
      }
    }
    levels_.push_back(level);
    if (level.width == 1 && level.height == 1) break;
    level.width = (level.width + 1) / 2;
    level.height = (level.height + 1) / 2;
  }
}

// Whether a ray of a block may see the Gaussian; rays from the camera's origin.
bool RayPyramid::MayHold(const Node& node, const RayCone& cone) {
  const Matrix3d whiten = Whiten(cone);
  const Eigen::Map<const Vector3d> center(cone.center);
  // Over |d - axis| <= chord, w.A d and the part of A d across w stray by at most their norm times
  // the chord; D^2 |A d|^2 = |w x A d|^2.
  const Vector3d axis = Eigen::Map<const Eigen::Vector3f>(node.axis).cast<double>();
  const Vector3d pull = whiten.transpose() * center;
  const double along = pull.dot(axis) + pull.norm() * node.chord;
  if (!(along > 0.0)) return false;
  const double g2 = center.squaredNorm();
  if (!(g2 > cone.cutoff)) return true;
  // Outside the ellipsoid the cone is |(I - c c^T) A d| < tan(cone) c.A d, c = w / |w|. The part
  // across is linear in d, its norm by rows.
  const Vector3d c = center / std::sqrt(g2);
  const Matrix3d across = whiten - c * (c.transpose() * whiten);
  const double tangent = std::sqrt(cone.cutoff / (g2 - cone.cutoff));
  double sum = 0.0;
  for (int row = 0; row < 3; ++row) {
    const double least =
        std::max(std::abs(across.row(row).dot(axis)) - across.row(row).norm() * node.chord, 0.0);
    sum += least * least;
  }
  return std::sqrt(sum) < tangent * along / std::sqrt(g2);
}

// The same for rays with origins of their own: the line may meet the sphere around the Gaussian.
// With p = mean - origin and unit d, |p x d| is the distance of the line from the mean; over the
// block, p strays by `spread` and d by `chord`.
bool RayPyramid::MayHoldLine(const Node& node, const RayCone& cone) {
  const Vector3d axis = Eigen::Map<const Eigen::Vector3f>(node.axis).cast<double>();
  const Vector3d p = Eigen::Map<const Vector3d>(cone.mean) -
                     Eigen::Map<const Eigen::Vector3f>(node.origin).cast<double>();
  const double stray = node.spread + p.norm() * node.chord;
  return p.cross(axis).norm() - stray < cone.radius && p.dot(axis) + stray > -cone.radius;
}

// Down into the four children of every node that may hold a ray that sees the Gaussian; pixels of a
// leaf are tested exactly. Nodes inside the box found so far are skipped: only its edges matter.
void RayPyramid::Search(const RayTable& rays, const RayCone& cone, std::size_t level, int x, int y,
                        int box[4]) const {
  const Level& here = levels_[level];
  if (x >= here.width || y >= here.height) return;
  const int size = kLeaf << level;
  const int x0 = x * size, y0 = y * size;
  const int x1 = std::min(x0 + size, width_), y1 = std::min(y0 + size, height_);
  // What the box already holds cannot widen it.
  if (x0 >= box[0] && x1 - 1 <= box[1] && y0 >= box[2] && y1 - 1 <= box[3]) return;
  const Node& node = here.nodes[static_cast<std::size_t>(y) * here.width + x];
  if (node.chord < 0.0f) return;
  if (!(rays.origins.empty() ? MayHold(node, cone) : MayHoldLine(node, cone))) return;
  if (level > 0) {
    for (int k = 0; k < 4; ++k) Search(rays, cone, level - 1, 2 * x + k % 2, 2 * y + k / 2, box);
    return;
  }
  const Matrix3d whiten = Whiten(cone);
  for (int row = y0; row < y1; ++row) {
    for (int column = x0; column < x1; ++column) {
      const std::size_t p = static_cast<std::size_t>(row) * width_ + column;
      if (!rays.valid[p]) continue;
      const Vector3d d = whiten * Eigen::Map<const Vector3d>(&rays.rays[3 * p]);
      Vector3d center = Eigen::Map<const Vector3d>(cone.center);
      if (!rays.origins.empty()) {
        center = whiten * (Eigen::Map<const Vector3d>(cone.mean) - OriginOf(rays, p));
      }
      const double toward = center.dot(d);
      if (!(toward > 0.0)) continue;
      // |w x A d|^2 keeps its digits where |w|^2 - (w.A d)^2 / |A d|^2 would cancel.
      if (!(center.cross(d).squaredNorm() < cone.cutoff * d.squaredNorm())) continue;
      box[0] = std::min(box[0], column);
      box[1] = std::max(box[1], column);
      box[2] = std::min(box[2], row);
      box[3] = std::max(box[3], row);
    }
  }
}

bool RayPyramid::Box(const RayTable& rays, const RayCone& cone, double box[4]) const {
  int pixels[4] = {width_, -1, height_, -1};
  Search(rays, cone, levels_.size() - 1, 0, 0, pixels);
  for (int k = 0; k < 4; ++k) box[k] = pixels[k] + 0.5;
  return pixels[1] >= 0;
}

// Those of the last cameras, found by their ray tables; an entry whose table is gone matches none.
std::shared_ptr<const RayPyramid> PyramidOf(const Camera& camera) {
  struct Kept {
    std::weak_ptr<const RayTable> rays;
    std::shared_ptr<const RayPyramid> pyramid;
  };
  static std::mutex mutex;
  static std::list<Kept> kept;
  const std::shared_ptr<const RayTable> rays = camera.SharedRays();
  const std::lock_guard<std::mutex> lock(mutex);
  for (auto entry = kept.begin(); entry != kept.end(); ++entry) {
    if (entry->rays.lock() == rays) {
      kept.splice(kept.begin(), kept, entry);
      return entry->pyramid;
    }
  }
  kept.push_front({rays, std::make_shared<const RayPyramid>(camera)});
  if (kept.size() > kKept) kept.pop_back();
  return kept.front().pyramid;
}

}  // namespace gsut
