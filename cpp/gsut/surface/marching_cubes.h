// The zero level of a distance field as triangles.
#pragma once

#include <cstdint>
#include <vector>

#include "gsut/surface/fuse.h"

namespace gsut {

struct Mesh {
  std::vector<double> vertices;      // (V, 3) world
  std::vector<std::uint32_t> faces;  // (F, 3), counterclockwise seen from the positive side
};

// Marching cubes (Lorensen and Cline 1987) over the cells whose eight voxels have values. A vertex
// lies on a grid edge, by linear interpolation; cells of neighbouring blocks share it. On a face of
// two opposite negative corners these are cut off one by one, in both cells, and polygons are cut
// into triangles along no diagonal within a face of the cell: every edge has at most two triangles,
// and exactly two away from cells without values.
Mesh MarchingCubes(const DistanceField& field);

}  // namespace gsut
