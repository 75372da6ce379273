// Binds gsut/surface: depth maps of views, their fusion, marching cubes.
//
// Coordinates are world units about a centre that the caller chooses, so that float voxels keep
// their digits; meshes come back in world coordinates, double.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <limits>
#include <utility>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/geometry.h"
#include "bindings/long_call.h"
#include "bindings/module.h"
#include "gsut/surface/across_views.h"
#include "gsut/surface/marching_cubes.h"
#include "gsut/surface/refine_depth.h"
#include "gsut/surface/triangle_tree.h"

namespace gsut::bindings {
namespace {

// Three numbers from Python come as an array, as pybind11 converts no Eigen types here.
Eigen::Vector3d Vector(const std::array<double, 3>& values) {
  return {values[0], values[1], values[2]};
}

// inner in world units here, in voxels in the core; infinite: an even grid.
VoxelSpace Space(const std::array<double, 3>& center, double voxel, double inner) {
  if (!(voxel > 0.0) || !(inner > 0.0)) throw InputError("voxel and inner must be positive");
  return {Vector(center), voxel, inner / voxel};
}

// The depth maps of a scene, and the images beside them.
class DepthViews {
 public:
  explicit DepthViews(const std::array<double, 3>& center) : center_(center) {}

  // One view: depth (H, W) along the rays, NaN or 0 where there is none; weight (H, W) or None for
  // 1; image (H, W, 3) uint8 or None. Depths are copied into the view's own form; images are not.
  void Add(const Camera& camera, const py::object& pose, const py::object& depth,
           const py::object& weight, const py::object& image) {
    const std::int64_t h = camera.height(), w = camera.width();
    const float* depths = ConstData<float>(depth, "depth", {h, w});
    const float* weights = OptionalData<float>(weight, "weight", {h, w});
    images_.push_back(OptionalData<std::uint8_t>(image, "image", {h, w, 3}));
    kept_.append(image);
    const CameraMotion motion = ReadMotion(pose);
    const LongCall released;
    views_.emplace_back(camera, motion, depths, weights, Vector(center_));
  }

  // (H, W): the number of `others` that see a surface where this view does, within tolerance.
  py::array_t<std::uint8_t> Support(std::size_t which, const std::vector<std::size_t>& others,
                                    double tolerance) const {
    Check(which);
    for (const std::size_t other : others) Check(other);
    auto out = NewArray<std::uint8_t>({views_[which].height(), views_[which].width()});
    std::uint8_t* data = out.mutable_data();
    const LongCall released;
    CountSupport(views_, which, others, tolerance, data);
    return out;
  }

  // voxel: side in world units, inside `inner` of the centre; beyond it voxels grow with distance.
  // truncation: in voxels. max_blocks 0: no limit. Throws InputError where there would be more.
  DistanceField Fuse(double voxel, double inner, double truncation, double free_weight,
                     std::int64_t max_blocks) const {
    const VoxelSpace space = Space(center_, voxel, inner);
    if (!(truncation >= 2.0)) throw InputError("truncation must be at least 2 voxels");
    const LongCall released;
    return FuseDepth(views_, space, {truncation, free_weight, max_blocks});
  }

  // (N, 3) in [0, 1], NaN where no view sees the point. Points are about the centre, as views are.
  py::array_t<float> Colors(const py::object& points, double tolerance) const {
    const auto array = ReadArray<double>(points, "points", {kAny, 3});
    auto out = NewArray<float>({array.shape(0), 3});
    float* colors = out.mutable_data();
    std::vector<double> about(array.data(), array.data() + array.size());
    for (std::size_t i = 0; i < about.size(); ++i) about[i] -= center_[i % 3];
    const LongCall released;
    ColorPoints(views_, images_, array.shape(0), about.data(), tolerance, colors);
    return out;
  }

  // (depth, moved), both (H, W): depths moved to where the photographs agree, and whether they
  // were.
  py::tuple Refine(std::size_t which, const std::vector<std::size_t>& others, const py::list& greys,
                   const py::object& normals, const py::object& depth) const {
    Check(which);
    for (const std::size_t other : others) Check(other);
    if (greys.size() != views_.size()) throw InputError("greys takes one array a view");
    std::vector<const float*> photographs;
    for (std::size_t i = 0; i < views_.size(); ++i) {
      photographs.push_back(
          ConstData<float>(greys[i], "greys", {views_[i].height(), views_[i].width()}));
    }
    const std::int64_t h = views_[which].height(), w = views_[which].width();
    const float* towards = ConstData<float>(normals, "normals", {h, w, 3});
    const float* depths = ConstData<float>(depth, "depth", {h, w});
    auto out = NewArray<float>({h, w});
    auto flags = NewArray<std::uint8_t>({h, w});
    float* refined = out.mutable_data();
    std::uint8_t* moved = flags.mutable_data();
    std::copy(depths, depths + h * w, refined);
    {
      const LongCall released;
      RefineDepth(views_, which, others, photographs, towards, refined, moved);
    }
    return py::make_tuple(out, flags);
  }

  std::size_t size() const { return views_.size(); }

 private:
  // Indices of views come from Python unchecked.
  void Check(std::size_t which) const {
    if (which >= views_.size()) throw InputError("no such view");
  }

  std::array<double, 3> center_;
  std::vector<DepthView> views_;
  std::vector<const std::uint8_t*> images_;
  py::list kept_;  // the images
};

// A field from arrays, for tests of marching cubes; Find needs sorted blocks.
DistanceField FieldOf(const py::object& blocks, const py::object& values,
                      const std::array<double, 3>& center, double voxel, double inner) {
  const auto places = ReadArray<std::int32_t>(blocks, "blocks", {kAny, 3});
  const auto numbers = ReadArray<float>(values, "values", {places.shape(0), kBlockVoxels});
  DistanceField field;
  field.space = Space(center, voxel, inner);
  for (py::ssize_t i = 0; i < places.shape(0); ++i) {
    field.blocks.push_back({places.at(i, 0), places.at(i, 1), places.at(i, 2)});
  }
  // DistanceField::Find searches by halves.
  for (std::size_t i = 1; i < field.blocks.size(); ++i) {
    if (!(field.blocks[i - 1] < field.blocks[i])) {
      throw InputError("blocks must be in increasing order, none twice");
    }
  }
  field.values.assign(numbers.data(), numbers.data() + numbers.size());
  return field;
}

// The mesh as new arrays: its size is known only afterwards.
py::tuple MeshOf(const DistanceField& field) {
  Mesh mesh;
  {
    const LongCall released;
    mesh = MarchingCubes(field);
  }
  auto vertices = NewArray<double>({static_cast<py::ssize_t>(mesh.vertices.size() / 3), 3});
  auto faces = NewArray<std::uint32_t>({static_cast<py::ssize_t>(mesh.faces.size() / 3), 3});
  std::copy(mesh.vertices.begin(), mesh.vertices.end(), vertices.mutable_data());
  std::copy(mesh.faces.begin(), mesh.faces.end(), faces.mutable_data());
  return py::make_tuple(vertices, faces);
}

// vertices (V, 3) float64 and faces (F, 3) uint32, both copied: the tree outlives the arrays.
TriangleTree TreeOf(const py::object& vertices, const py::object& faces) {
  const auto places = ReadArray<double>(vertices, "vertices", {kAny, 3});
  const auto corners = ReadArray<std::uint32_t>(faces, "faces", {kAny, 3});
  return {{places.data(), places.data() + places.size()},
          {corners.data(), corners.data() + corners.size()}};
}

// distances are NaN and faces -1 where nothing is met. queries, origins and directions (N, 3)
// float64.
// (distances (N,), faces (N,)).
// What both searches of a tree share: outputs made before the GIL goes.
template <class Search>
py::tuple Searched(py::ssize_t count, const Search& search) {
  auto distances = NewArray<double>({count});
  auto faces = NewArray<std::int64_t>({count});
  double* distances_data = distances.mutable_data();
  std::int64_t* faces_data = faces.mutable_data();
  {
    const LongCall released;
    search(distances_data, faces_data);
  }
  return py::make_tuple(distances, faces);
}

// Distances (N,) of points from the mesh, and the face that is nearest to each.
py::tuple NearestOf(const TriangleTree& tree, const py::object& queries) {
  const auto points = ReadArray<double>(queries, "queries", {kAny, 3});
  return Searched(points.shape(0), [&](double* distances, std::int64_t* faces) {
    tree.Nearest(points.shape(0), points.data(), distances, faces);
  });
}

// Where rays first meet the mesh, in lengths of their directions, and on which face.
py::tuple CastOf(const TriangleTree& tree, const py::object& origins,
                 const py::object& directions) {
  const auto from = ReadArray<double>(origins, "origins", {kAny, 3});
  const auto along = ReadArray<double>(directions, "directions", {from.shape(0), 3});
  return Searched(from.shape(0), [&](double* distances, std::int64_t* faces) {
    tree.Cast(from.shape(0), from.data(), along.data(), distances, faces);
  });
}

// A label a vertex: the lowest index of a vertex that faces connect it with.
py::array_t<std::uint32_t> Parts(std::int64_t num_vertices, const py::object& faces) {
  const auto corners = ReadArray<std::uint32_t>(faces, "faces", {kAny, 3});
  for (py::ssize_t i = 0; i < corners.size(); ++i) {
    if (corners.data()[i] >= num_vertices) {
      throw InputError("a face names a vertex that is not there");
    }
  }
  auto labels = NewArray<std::uint32_t>({num_vertices});
  LabelParts(num_vertices, corners.shape(0), corners.data(), labels.mutable_data());
  return labels;
}

}  // namespace

void BindSurface(py::module_& m) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  py::class_<DistanceField>(m, "DistanceField", "A sparse truncated signed distance field.")
      .def(py::init(&FieldOf), py::arg("blocks"), py::arg("values"), py::arg("center"),
           py::arg("voxel"), py::arg("inner") = kInfinity)
      .def_property_readonly(
          "blocks",
          [](const DistanceField& field) {
            auto out = NewArray<std::int32_t>({static_cast<py::ssize_t>(field.blocks.size()), 3});
            std::int32_t* to = out.mutable_data();
            for (const auto& block : field.blocks) to = std::copy(block.begin(), block.end(), to);
            return out;
          },
          "(B, 3) grid coordinates of the first voxels, in eights.")
      .def_property_readonly(
          "values",
          [](const DistanceField& field) {
            auto out = NewArray<float>(
                {static_cast<py::ssize_t>(field.blocks.size()), py::ssize_t{kBlockVoxels}});
            std::copy(field.values.begin(), field.values.end(), out.mutable_data());
            return out;
          },
          "(B, 512) signed distances in voxels, x fastest; NaN where nothing is known.")
      .def("__len__", [](const DistanceField& field) { return field.blocks.size(); })
      .def("mesh", &MeshOf, "Vertices (V, 3) and faces (F, 3) of the zero level.");
  py::class_<TriangleTree>(m, "TriangleTree", "Nearest points and ray hits on triangles.")
      .def(py::init(&TreeOf), py::arg("vertices"), py::arg("faces"))
      .def("nearest", &NearestOf, py::arg("queries"))
      .def("cast", &CastOf, py::arg("origins"), py::arg("directions"));
  // Connected parts, by which small pieces of a mesh are found and dropped.
  m.def("mesh_parts", &Parts, py::arg("num_vertices"), py::arg("faces"));
  py::class_<DepthViews>(m, "DepthViews", "Depth maps of views, to be fused.")
      .def(py::init<const std::array<double, 3>&>(), py::arg("center"))
      .def("add", &DepthViews::Add, py::arg("camera"), py::arg("camera_from_world"),
           py::arg("depth"), py::arg("weight"), py::arg("image"))
      .def("support", &DepthViews::Support, py::arg("which"), py::arg("others"),
           py::arg("tolerance"))
      .def("refine", &DepthViews::Refine, py::arg("which"), py::arg("others"), py::arg("greys"),
           py::arg("normals"), py::arg("depth"))
      .def("fuse", &DepthViews::Fuse, py::arg("voxel"), py::arg("inner"), py::arg("truncation"),
           py::arg("free_weight"), py::arg("max_blocks"))
      .def("colors", &DepthViews::Colors, py::arg("points"), py::arg("tolerance"))
      .def("__len__", &DepthViews::size);
}

}  // namespace gsut::bindings
