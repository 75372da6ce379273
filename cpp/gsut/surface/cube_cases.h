// The triangles of a cell of marching cubes for each pattern of signs of its corners.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace gsut {

// Corner c lies at x = c & 1, y = c >> 1 & 1, z = c >> 2 & 1. Edge 4 a + k runs along axis a from
// the corner that CubeEdge gives.
struct CubeEdge {
  int axis;
  int corner;  // where it starts
};
CubeEdge EdgeOfCube(int edge);

// cases[signs]: edges, three a triangle; bit c of signs is set where corner c is negative.
const std::array<std::vector<std::uint8_t>, 256>& CubeCases();

}  // namespace gsut
