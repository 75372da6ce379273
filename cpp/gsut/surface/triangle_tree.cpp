// Splits at the median along the longest side, and walks with a stack.
#include "gsut/surface/triangle_tree.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "gsut/base/check_arguments.h"
#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"

namespace gsut {
namespace {

using Eigen::Vector3d;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr std::uint32_t kLeaf = 4;
constexpr std::int64_t kGrain = 256;
constexpr int kDepth = 64;  // of the stack; trees of 2^32 triangles are 31 deep

// The point of the triangle (a, b, c) that is nearest to p (Ericson, Real-Time Collision Detection,
// 5.1.5): by the region of its plane that p lies over.
Vector3d NearestOnTriangle(const Vector3d& p, const Vector3d& a, const Vector3d& b,
                           const Vector3d& c) {
  const Vector3d ab = b - a, ac = c - a, ap = p - a, bp = p - b, cp = p - c;
  const double d1 = ab.dot(ap), d2 = ac.dot(ap);
  if (d1 <= 0.0 && d2 <= 0.0) return a;
  const double d3 = ab.dot(bp), d4 = ac.dot(bp);
  if (d3 >= 0.0 && d4 <= d3) return b;
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0) return a + d1 / (d1 - d3) * ab;
  const double d5 = ab.dot(cp), d6 = ac.dot(cp);
  if (d6 >= 0.0 && d5 <= d6) return c;
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0) return a + d2 / (d2 - d6) * ac;
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0.0 && d4 >= d3 && d5 >= d6) return b + (d4 - d3) / (d4 - d3 + d5 - d6) * (c - b);
  return a + ab * (vb / (va + vb + vc)) + ac * (vc / (va + vb + vc));
}

// How many directions away the ray meets the triangle, from either side (Moeller and Trumbore
// 1997).
// Solves o + t d = a + u ab + v ac by Cramer's rule, the determinants as triple products.
double MeetTriangle(const Vector3d& origin, const Vector3d& direction, const Vector3d& a,
                    const Vector3d& b, const Vector3d& c) {
  const Vector3d ab = b - a, ac = c - a, across = direction.cross(ac), from = origin - a;
  const double scale = ab.dot(across);
  if (scale == 0.0) return kInfinity;
  const double u = from.dot(across) / scale;
  const Vector3d turned = from.cross(ab);
  const double v = direction.dot(turned) / scale, t = ac.dot(turned) / scale;
  return u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 ? t : kInfinity;
}

}  // namespace

TriangleTree::TriangleTree(std::vector<double> vertices, std::vector<std::uint32_t> faces)
    : vertices_(std::move(vertices)), faces_(std::move(faces)), order_(faces_.size() / 3) {
  if (faces_.empty() || faces_.size() % 3 != 0)
    throw InputError("a mesh needs at least one face, and three vertices a face");
  if (*std::max_element(faces_.begin(), faces_.end()) >= vertices_.size() / 3) {
    throw InputError("a face names a vertex that is not there");
  }
  std::iota(order_.begin(), order_.end(), 0u);
  std::vector<Vector3d> middles(order_.size());
  for (std::size_t i = 0; i < middles.size(); ++i) {
    const auto face = static_cast<std::uint32_t>(i);
    middles[i] = (Corner(face, 0) + Corner(face, 1) + Corner(face, 2)) / 3.0;
  }
  Build(0, static_cast<std::uint32_t>(order_.size()), &middles);
}

// A bounding volume hierarchy: each node's box holds its triangles, split in two halves of equal
// count across the box's longest side, down to leaves of four.
// Nodes in the order of a walk down to the left: the left child of a node is the next, and only the
// right one's index is kept. Ties of the median are broken by index: one tree for one mesh.
void TriangleTree::Build(std::uint32_t first, std::uint32_t count, std::vector<Vector3d>* middles) {
  const std::size_t at = nodes_.size();
  Node node;
  node.low.setConstant(kInfinity);
  node.high.setConstant(-kInfinity);
  for (std::uint32_t i = first; i < first + count; ++i) {
    for (int k = 0; k < 3; ++k) {
      const Vector3d corner = Corner(order_[i], k);
      node.low = node.low.cwiseMin(corner);
      node.high = node.high.cwiseMax(corner);
    }
  }
  node.first = first;
  node.count = count <= kLeaf ? count : 0;
  nodes_.push_back(node);
  if (count <= kLeaf) return;
  int axis = 0;
  (node.high - node.low).maxCoeff(&axis);
  const std::uint32_t half = count / 2;
  const auto begin = order_.begin() + first;
  std::nth_element(begin, begin + half, begin + count, [&](std::uint32_t a, std::uint32_t b) {
    const double x = (*middles)[a][axis], y = (*middles)[b][axis];
    return x < y || (x == y && a < b);
  });
  Build(first, half, middles);
  nodes_[at].right = static_cast<std::uint32_t>(nodes_.size());
  Build(first + half, count - half, middles);
}

// Branch and bound: a box farther than the best triangle so far cannot hold a nearer one. The
// nearer child is taken first, so that the bound falls quickly.
void TriangleTree::Nearest(std::int64_t count, const double* queries, double* distances,
                           std::int64_t* faces) const {
  CheckArray(queries, count, "queries");
  CheckArray(distances, count, "distances");
  CheckArray(faces, count, "faces");
  ParallelFor(count, kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      const Eigen::Map<const Vector3d> p(queries + 3 * i);
      const auto to_box = [&](std::uint32_t n) {
        const Vector3d inside = p.cwiseMax(nodes_[n].low).cwiseMin(nodes_[n].high);
        return (p - inside).squaredNorm();
      };
      double best = kInfinity;
      std::int64_t found = -1;
      std::uint32_t stack[kDepth] = {0};
      for (int top = 1; top > 0;) {
        const std::uint32_t n = stack[--top];
        const Node& node = nodes_[n];
        if (to_box(n) >= best) continue;
        for (std::uint32_t k = node.first; k < node.first + node.count; ++k) {
          const std::uint32_t face = order_[k];
          const Vector3d on =
              NearestOnTriangle(p, Corner(face, 0), Corner(face, 1), Corner(face, 2));
          const double square = (p - on).squaredNorm();
          if (square >= best) continue;
          best = square;
          found = face;
        }
        if (node.count > 0) continue;
        const bool left_first = to_box(n + 1) <= to_box(node.right);
        stack[top++] = left_first ? node.right : n + 1;
        stack[top++] = left_first ? n + 1 : node.right;
      }
      distances[i] = found < 0 ? std::numeric_limits<double>::quiet_NaN() : std::sqrt(best);
      faces[i] = found;
    }
  });
}

// The same along a ray: a box is entered where the ray is between all three pairs of its sides
// (slab test, Kay and Kajiya, 1986).
void TriangleTree::Cast(std::int64_t count, const double* origins, const double* directions,
                        double* distances, std::int64_t* faces) const {
  CheckArray(origins, count, "origins");
  CheckArray(directions, count, "directions");
  CheckArray(distances, count, "distances");
  CheckArray(faces, count, "faces");
  ParallelFor(count, kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      const Vector3d origin = Eigen::Map<const Vector3d>(origins + 3 * i);
      const Vector3d direction = Eigen::Map<const Vector3d>(directions + 3 * i);
      // Infinite along an axis that the ray does not move on: the slab test then still holds.
      const Vector3d inverse = direction.cwiseInverse();
      const auto to_box = [&](std::uint32_t n) {
        const Vector3d one = (nodes_[n].low - origin).cwiseProduct(inverse);
        const Vector3d other = (nodes_[n].high - origin).cwiseProduct(inverse);
        double enter = 0.0, leave = kInfinity;
        for (int k = 0; k < 3; ++k) {  // NaN: in the plane of a side, which says nothing
          if (std::isnan(one[k]) || std::isnan(other[k])) continue;
          enter = std::max(enter, std::min(one[k], other[k]));
          leave = std::min(leave, std::max(one[k], other[k]));
        }
        return enter <= leave ? enter : kInfinity;
      };
      double best = kInfinity;
      std::int64_t found = -1;
      std::uint32_t stack[kDepth] = {0};
      // NaN directions meet nothing.
      for (int top = direction.allFinite() && origin.allFinite() ? 1 : 0; top > 0;) {
        const std::uint32_t n = stack[--top];
        const Node& node = nodes_[n];
        if (to_box(n) >= best) continue;
        for (std::uint32_t k = node.first; k < node.first + node.count; ++k) {
          const std::uint32_t face = order_[k];
          const double away =
              MeetTriangle(origin, direction, Corner(face, 0), Corner(face, 1), Corner(face, 2));
          if (away >= best) continue;
          best = away;
          found = face;
        }
        if (node.count > 0) continue;
        const bool left_first = to_box(n + 1) <= to_box(node.right);
        stack[top++] = left_first ? node.right : n + 1;
        stack[top++] = left_first ? n + 1 : node.right;
      }
      distances[i] = found < 0 ? std::numeric_limits<double>::quiet_NaN() : best;
      faces[i] = found;
    }
  });
}

// Union-find with path halving; the smaller label wins, so that labels do not depend on the order
// of the faces.
void LabelParts(std::int64_t num_vertices, std::int64_t num_faces, const std::uint32_t* faces,
                std::uint32_t* labels) {
  CheckArray(labels, num_vertices, "labels");
  CheckArray(faces, num_faces, "faces");
  if (num_faces > 0 && *std::max_element(faces, faces + 3 * num_faces) >= num_vertices) {
    throw InputError("a face names a vertex that is not there");
  }
  std::iota(labels, labels + num_vertices, 0u);
  const auto root = [&](std::uint32_t vertex) {
    while (labels[vertex] != vertex) {
      labels[vertex] = labels[labels[vertex]];
      vertex = labels[vertex];
    }
    return vertex;
  };
  for (std::int64_t i = 0; i < num_faces; ++i) {
    for (int k = 1; k < 3; ++k) {
      const std::uint32_t a = root(faces[3 * i]), b = root(faces[3 * i + k]);
      labels[std::max(a, b)] = std::min(a, b);
    }
  }
  for (std::int64_t i = 0; i < num_vertices; ++i) {
    labels[i] = root(static_cast<std::uint32_t>(i));
  }
}

}  // namespace gsut
