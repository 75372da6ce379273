// Vertices block by block, then the cells between them.
#include "gsut/surface/marching_cubes.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/surface/cube_cases.h"

namespace gsut {
namespace {

using Eigen::Vector3d;

constexpr int kSide = kBlockSide + 1;  // with the first voxels of the blocks behind
constexpr int kGrain = 16;
constexpr int kWords = 3 * kBlockVoxels / 64;
constexpr std::uint32_t kUnused = std::numeric_limits<std::uint32_t>::max();

// Marching cubes (Lorensen and Cline, 1987) in three passes, each over all blocks at once:
//   1. MarkVertices finds the grid edges whose ends have opposite signs; a bit an edge.
//   2. A running sum over the blocks numbers all vertices, so that the others can name them.
//   3. WriteVertices places them where the linear distance is 0, and AddTriangles joins them by the
//      signs of each cell's corners (cube_cases.h).
// An edge belongs to the block of its first voxel; cells on a block's far side use the vertices of
// the blocks behind.

// Which of a block's grid edges carry a vertex: bit 512 axis + voxel. Vertices are numbered by
// block and then by bit.
struct BlockVertices {
  std::uint64_t bits[kWords] = {};
  std::uint32_t first = 0;

  void Mark(int axis, int voxel) { bits[8 * axis + voxel / 64] |= 1ull << voxel % 64; }
  std::uint32_t Number(int axis, int voxel) const {
    const int word = 8 * axis + voxel / 64;
    std::uint32_t number = first;
    for (int i = 0; i < word; ++i) number += static_cast<std::uint32_t>(std::popcount(bits[i]));
    const std::uint64_t below = bits[word] & ((1ull << voxel % 64) - 1);
    return number + static_cast<std::uint32_t>(std::popcount(below));
  }
  std::uint32_t Count() const {
    std::uint32_t count = 0;
    for (const std::uint64_t word : bits) count += static_cast<std::uint32_t>(std::popcount(word));
    return count;
  }
};

// A block's values and those of the voxels behind it.
struct BlockValues {
  std::int64_t neighbours[8];  // by the bits x, y, z; -1: none
  float values[kSide * kSide * kSide];

  BlockValues(const DistanceField& field, std::int64_t number) {
    const auto& block = field.blocks[static_cast<std::size_t>(number)];
    for (int n = 0; n < 8; ++n) {
      neighbours[n] =
          n == 0
              ? number
              : field.Find({block[0] + (n & 1), block[1] + (n >> 1 & 1), block[2] + (n >> 2 & 1)});
    }
    for (int z = 0, i = 0; z < kSide; ++z) {
      for (int y = 0; y < kSide; ++y) {
        for (int x = 0; x < kSide; ++x, ++i) {
          const std::int64_t from = neighbours[Owner(x, y, z)];
          values[i] = from < 0 ? std::numeric_limits<float>::quiet_NaN()
                               : field.values[static_cast<std::size_t>(from) * kBlockVoxels +
                                              static_cast<std::size_t>(Voxel(x, y, z))];
        }
      }
    }
  }
  static int Owner(int x, int y, int z) {
    return (x == kBlockSide) | (y == kBlockSide) << 1 | (z == kBlockSide) << 2;
  }
  // Within its owner.
  static int Voxel(int x, int y, int z) {
    constexpr int kMask = kBlockSide - 1;
    return (x & kMask) + kBlockSide * ((y & kMask) + kBlockSide * (z & kMask));
  }
  float At(int x, int y, int z) const { return values[x + kSide * (y + kSide * z)]; }
};

bool Crosses(float one, float other) {
  return (one < 0.0f && other >= 0.0f) || (one >= 0.0f && other < 0.0f);
}

template <class Visit>
void ForEachVoxel(Visit&& visit) {
  for (int z = 0; z < kBlockSide; ++z) {
    for (int y = 0; y < kBlockSide; ++y) {
      for (int x = 0; x < kBlockSide; ++x) visit(x, y, z);
    }
  }
}

// Only the three edges that start at a voxel, so that each edge of the grid is seen once.
void MarkVertices(const BlockValues& block, BlockVertices* vertices) {
  ForEachVoxel([&](int x, int y, int z) {
    const float here = block.At(x, y, z);
    const float next[3] = {block.At(x + 1, y, z), block.At(x, y + 1, z), block.At(x, y, z + 1)};
    for (int axis = 0; axis < 3; ++axis) {
      if (Crosses(here, next[axis])) vertices->Mark(axis, BlockValues::Voxel(x, y, z));
    }
  });
}

// In double, and from grid to world through the space, which may be contracted far out.
void WriteVertices(const DistanceField& field, std::int64_t number, const BlockValues& block,
                   const BlockVertices& vertices, double* out) {
  const auto& at = field.blocks[static_cast<std::size_t>(number)];
  const Vector3d first = kBlockSide * Vector3d(at[0], at[1], at[2]);
  for (int bit = 0, done = 0; bit < 3 * kBlockVoxels; ++bit) {
    if ((vertices.bits[bit / 64] >> bit % 64 & 1) == 0) continue;
    const int axis = bit / kBlockVoxels, voxel = bit % kBlockVoxels;
    const int x = voxel % kBlockSide, y = voxel / kBlockSide % kBlockSide;
    const int z = voxel / (kBlockSide * kBlockSide);
    const double here = double{block.At(x, y, z)};
    const double next = double{block.At(x + (axis == 0), y + (axis == 1), z + (axis == 2))};
    Vector3d grid = first + Vector3d(x, y, z);
    // The zero of the line through (0, here) and (1, next).
    grid[axis] += here / (here - next);
    Eigen::Map<Vector3d>(out + 3 * done) = field.space.center + field.space.AboutCenter(grid);
    ++done;
  }
}

// The signs of a cell's corners choose one of 256 cases; a case lists edges of the cell, three a
// triangle, and an edge's vertex is named by the block that owns the edge.
void AddTriangles(const BlockValues& block, const std::vector<BlockVertices>& vertices,
                  std::vector<std::uint32_t>* faces) {
  const auto& cases = CubeCases();
  ForEachVoxel([&](int x, int y, int z) {
    unsigned signs = 0;
    for (int corner = 0; corner < 8; ++corner) {
      const float value = block.At(x + (corner & 1), y + (corner >> 1 & 1), z + (corner >> 2 & 1));
      // Where a corner was never seen there is no surface, not a closed one.
      if (!(std::abs(value) < std::numeric_limits<float>::infinity())) return;
      signs |= static_cast<unsigned>(value < 0.0f) << corner;
    }
    for (const std::uint8_t edge : cases[signs]) {
      const CubeEdge on = EdgeOfCube(edge);
      const int cx = x + (on.corner & 1), cy = y + (on.corner >> 1 & 1);
      const int cz = z + (on.corner >> 2 & 1);
      const std::int64_t owner = block.neighbours[BlockValues::Owner(cx, cy, cz)];
      faces->push_back(vertices[static_cast<std::size_t>(owner)].Number(
          on.axis, BlockValues::Voxel(cx, cy, cz)));
    }
  });
}

// Leaves out vertices that no face names: their cells miss a value.
void DropUnused(Mesh* mesh) {
  std::vector<std::uint32_t> renamed(mesh->vertices.size() / 3, kUnused);
  for (const std::uint32_t vertex : mesh->faces) renamed[vertex] = 0;
  std::uint32_t kept = 0;
  for (std::size_t i = 0; i < renamed.size(); ++i) {
    if (renamed[i] == kUnused) continue;
    std::copy_n(&mesh->vertices[3 * i], 3, &mesh->vertices[3 * std::size_t{kept}]);
    renamed[i] = kept++;
  }
  mesh->vertices.resize(3 * std::size_t{kept});
  for (std::uint32_t& vertex : mesh->faces) vertex = renamed[vertex];
}

}  // namespace

Mesh MarchingCubes(const DistanceField& field) {
  const auto count = static_cast<std::int64_t>(field.blocks.size());
  std::vector<BlockVertices> vertices(field.blocks.size());
  const auto over_blocks = [&](const auto& body) {
    ParallelFor(count, kGrain, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) body(i, BlockValues(field, i));
    });
  };
  over_blocks([&](std::int64_t i, const BlockValues& block) {
    MarkVertices(block, &vertices[static_cast<std::size_t>(i)]);
  });
  std::uint64_t total = 0;
  for (BlockVertices& of_block : vertices) {
    of_block.first = static_cast<std::uint32_t>(total);
    total += of_block.Count();
  }
  if (total >= kUnused) throw InputError("the mesh has 2^32 vertices or more; take larger voxels");
  Mesh mesh;
  mesh.vertices.resize(3 * total);
  std::vector<std::vector<std::uint32_t>> faces(
      static_cast<std::size_t>((count + kGrain - 1) / kGrain));
  over_blocks([&](std::int64_t i, const BlockValues& block) {
    const BlockVertices& own = vertices[static_cast<std::size_t>(i)];
    WriteVertices(field, i, block, own, mesh.vertices.data() + 3 * std::size_t{own.first});
    AddTriangles(block, vertices, &faces[static_cast<std::size_t>(i / kGrain)]);
  });
  for (std::vector<std::uint32_t>& of_chunk : faces) {
    mesh.faces.insert(mesh.faces.end(), of_chunk.begin(), of_chunk.end());
    of_chunk = {};
  }
  DropUnused(&mesh);
  return mesh;
}

}  // namespace gsut
