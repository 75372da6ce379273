// Nearest points and ray hits on a set of triangles.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

namespace gsut {

// A tree of boxes over triangles. A face of one vertex three times is a point: then clouds are
// searched too. Same bits on any number of threads.
class TriangleTree {
 public:
  // vertices (V, 3), faces (F, 3), at least one. Throws InputError: a face names no vertex.
  TriangleTree(std::vector<double> vertices, std::vector<std::uint32_t> faces);

  // Of each query (count, 3): distance to the nearest triangle and its number.
  void Nearest(std::int64_t count, const double* queries, double* distances,
               std::int64_t* faces) const;
  // Of each ray (origins, directions (count, 3)): how many directions away it first meets a
  // triangle, and which; NaN and -1 where it meets none.
  void Cast(std::int64_t count, const double* origins, const double* directions, double* distances,
            std::int64_t* faces) const;

 private:
  struct Node {
    Eigen::Vector3d low, high;
    std::uint32_t first = 0, count = 0;  // of order_; count 0: an inner node
    std::uint32_t right = 0;             // the left child follows its parent
  };
  void Build(std::uint32_t first, std::uint32_t count, std::vector<Eigen::Vector3d>* middles);
  Eigen::Vector3d Corner(std::uint32_t face, int k) const {
    return Eigen::Map<const Eigen::Vector3d>(
        &vertices_[3 * std::size_t{faces_[3 * std::size_t{face} + static_cast<std::size_t>(k)]}]);
  }

  std::vector<double> vertices_;
  std::vector<std::uint32_t> faces_, order_;
  std::vector<Node> nodes_;
};

// label (V): the least vertex of each vertex' connected part of the mesh.
void LabelParts(std::int64_t num_vertices, std::int64_t num_faces, const std::uint32_t* faces,
                std::uint32_t* labels);

}  // namespace gsut
