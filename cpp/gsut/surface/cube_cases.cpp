// Makes the cases of marching cubes from the rule for faces, on first use, not from a table.
#include "gsut/surface/cube_cases.h"

#include <limits>

namespace gsut {
namespace {

constexpr int kEdges = 12;
// More diagonals than any polygon of a cell can have.
constexpr int kMostBad = 100;

// Edges are numbered by axis, then by the two other bits of their first corner.
int EdgeBetween(int one, int other) {
  const int start = one < other ? one : other;
  const int axis = (one ^ other) == 1 ? 0 : (one ^ other) == 2 ? 1 : 2;
  const int first = axis == 0 ? 1 : 0, second = axis == 2 ? 1 : 2;
  return 4 * axis + (start >> first & 1) + 2 * (start >> second & 1);
}

// The corners of each face, counterclockwise seen from outside.
std::array<std::array<int, 4>, 6> CubeFaces() {
  std::array<std::array<int, 4>, 6> faces;
  constexpr int kRound[4][2] = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
  for (int face = 0; face < 6; ++face) {
    const int axis = face / 2, side = face % 2;
    for (int i = 0; i < 4; ++i) {
      const int* at = kRound[side == 1 ? i : 3 - i];
      faces[face][i] = side << axis | at[0] << (axis + 1) % 3 | at[1] << (axis + 2) % 3;
    }
  }
  return faces;
}

// Cuts a polygon into triangles with as few diagonals as possible that lie in a face of the cell,
// where the neighbouring cell might draw the same one: none, for the polygons that occur.
class PolygonCut {
 public:
  PolygonCut(const std::vector<int>& polygon, const std::array<unsigned, kEdges>& faces_of_edge)
      : polygon_(polygon), faces_of_edge_(faces_of_edge) {}

  // Of the vertices i to j, closed by the side from j to i; the triangles go to out if not null.
  int Cut(int i, int j, std::vector<std::uint8_t>* out) const {
    if (j - i < 2) return 0;
    int least = kMostBad, best = i + 1;
    for (int k = i + 1; k < j; ++k) {
      const int bad = Cut(i, k, nullptr) + Cut(k, j, nullptr) + Bad(i, k) + Bad(k, j);
      if (bad >= least) continue;
      least = bad;
      best = k;
    }
    if (out != nullptr) {
      for (const int at : {i, best, j}) {
        out->push_back(static_cast<std::uint8_t>(polygon_[static_cast<std::size_t>(at)]));
      }
      Cut(i, best, out);
      Cut(best, j, out);
    }
    return least;
  }

 private:
  int Bad(int i, int j) const {
    if (j - i == 1) return 0;
    const auto faces = [&](int at) {
      return faces_of_edge_[static_cast<std::size_t>(polygon_[static_cast<std::size_t>(at)])];
    };
    return (faces(i) & faces(j)) != 0;
  }

  const std::vector<int>& polygon_;
  const std::array<unsigned, kEdges>& faces_of_edge_;
};

// The surface cuts each face of a cell along segments that part runs of negative corners from the
// others; a face with two opposite negative corners is cut into two single ones, in both cells that
// share it, so that no hole opens between them. The segments of all faces close to polygons.
std::vector<std::uint8_t> CaseOf(unsigned signs, const std::array<std::array<int, 4>, 6>& faces,
                                 const std::array<unsigned, kEdges>& faces_of_edge) {
  // Along each face from the edge where a run of negative corners begins to where it ends.
  std::array<int, kEdges> next;
  next.fill(-1);
  for (const std::array<int, 4>& corners : faces) {
    const auto corner = [&](int i) { return corners[static_cast<std::size_t>(i & 3)]; };
    const auto negative = [&](int i) { return (signs >> corner(i) & 1) != 0; };
    for (int i = 0; i < 4; ++i) {
      if (!negative(i) || negative(i + 3)) continue;
      int last = i;
      while (negative(last + 1)) ++last;
      next[static_cast<std::size_t>(EdgeBetween(corner(i + 3), corner(i)))] =
          EdgeBetween(corner(last), corner(last + 1));
    }
  }
  // The segments are links from edge to edge: following them until they come back is one polygon.
  std::vector<std::uint8_t> triangles;
  for (int start = 0; start < kEdges; ++start) {
    std::vector<int> polygon;
    for (int edge = start; next[static_cast<std::size_t>(edge)] >= 0;) {
      polygon.push_back(edge);
      const int after = next[static_cast<std::size_t>(edge)];
      next[static_cast<std::size_t>(edge)] = -1;
      edge = after;
    }
    if (polygon.empty()) continue;
    const PolygonCut cut(polygon, faces_of_edge);
    cut.Cut(0, static_cast<int>(polygon.size()) - 1, &triangles);
  }
  return triangles;
}

}  // namespace

CubeEdge EdgeOfCube(int edge) {
  const int axis = edge / 4, first = axis == 0 ? 1 : 0, second = axis == 2 ? 1 : 2;
  return {axis, (edge & 1) << first | (edge >> 1 & 1) << second};
}

const std::array<std::vector<std::uint8_t>, 256>& CubeCases() {
  static const std::array<std::vector<std::uint8_t>, 256> cases = [] {
    const auto faces = CubeFaces();
    std::array<unsigned, kEdges> faces_of_edge{};
    for (std::size_t face = 0; face < faces.size(); ++face) {
      for (std::size_t i = 0; i < 4; ++i) {
        const int edge = EdgeBetween(faces[face][i], faces[face][(i + 1) % 4]);
        faces_of_edge[static_cast<std::size_t>(edge)] |= 1u << face;
      }
    }
    // Which faces an edge lies in, for PolygonCut; then a list of triangles for each choice of
    // signs.
    std::array<std::vector<std::uint8_t>, 256> made;
    for (unsigned signs = 0; signs < 256; ++signs) {
      made[signs] = CaseOf(signs, faces, faces_of_edge);
    }
    return made;
  }();
  return cases;
}

}  // namespace gsut
