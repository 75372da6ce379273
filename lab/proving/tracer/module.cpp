// The Python module gsut_proving_tracer: the tracer of the proving ground, not in the wheel.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "tracer.h"

namespace py = pybind11;

namespace proving {
namespace {

using Floats = py::array_t<float, py::array::c_style | py::array::forcecast>;
using Numbers = py::array_t<std::int32_t, py::array::c_style | py::array::forcecast>;

void CheckShape(const py::array& array, const std::vector<py::ssize_t>& shape, const char* name) {
  bool fits = array.ndim() == static_cast<py::ssize_t>(shape.size());
  for (py::ssize_t k = 0; fits && k < array.ndim(); ++k) {
    fits = shape[k] < 0 || array.shape(k) == shape[k];
  }
  if (!fits) throw std::invalid_argument(std::string(name) + " has a wrong shape");
}

Texture MakeTexture(const Floats& pixels) {
  CheckShape(pixels, {-1, -1, 4}, "a texture");
  Texture texture;
  texture.levels.push_back({static_cast<int>(pixels.shape(0)),
                            static_cast<int>(pixels.shape(1)),
                            {pixels.data(), pixels.data() + pixels.size()}});
  while (texture.levels.back().height > 1 && texture.levels.back().width > 1) {
    const Texture::Level& fine = texture.levels.back();
    Texture::Level half{fine.height / 2, fine.width / 2, {}};
    half.pixels.resize(4 * static_cast<std::size_t>(half.height) * half.width);
    for (int y = 0; y < half.height; ++y) {
      for (int x = 0; x < 4 * half.width; ++x) {
        const int column = x / 4 * 8 + x % 4;
        const float* row = fine.pixels.data() + 4 * static_cast<std::size_t>(2 * y) * fine.width;
        const float* below = row + 4 * static_cast<std::size_t>(fine.width);
        half.pixels[4 * static_cast<std::size_t>(y) * half.width + x] =
            0.25f * (row[column] + row[column + 4] + below[column] + below[column + 4]);
      }
    }
    texture.levels.push_back(std::move(half));
  }
  return texture;
}

float MeasureTexels(const Triangle& t, const Texture& texture) {
  const Vec3& a = t.edge1;
  const Vec3& b = t.edge2;
  const float nx = a[1] * b[2] - a[2] * b[1], ny = a[2] * b[0] - a[0] * b[2],
              nz = a[0] * b[1] - a[1] * b[0];
  const float area = std::sqrt(nx * nx + ny * ny + nz * nz);
  const float du1 = t.uv[1][0] - t.uv[0][0], dv1 = t.uv[1][1] - t.uv[0][1];
  const float du2 = t.uv[2][0] - t.uv[0][0], dv2 = t.uv[2][1] - t.uv[0][1];
  const Texture::Level& level = texture.levels.front();
  const float texels = std::abs(du1 * dv2 - du2 * dv1) * level.width * level.height;
  return area > 0 ? std::sqrt(texels / area) : 0;
}

template <typename Row>
std::vector<Row> ReadRows(const Floats& rows, int fields, const char* name) {
  CheckShape(rows, {-1, fields}, name);
  std::vector<Row> out(rows.shape(0));
  if (!out.empty()) std::memcpy(out.data(), rows.data(), sizeof(Row) * out.size());
  return out;
}

std::unique_ptr<Tracer> MakeTracer(const Floats& corners, const Floats& normals, const Floats& uv,
                                   const Numbers& materials_of, const Numbers& bodies,
                                   const Floats& materials, const std::vector<Floats>& textures,
                                   const Floats& light, const Floats& lamps) {
  const py::ssize_t count = corners.shape(0);
  CheckShape(corners, {-1, 3, 3}, "corners");
  CheckShape(normals, {count, 3, 3}, "normals");
  CheckShape(uv, {count, 3, 2}, "uv");
  CheckShape(materials_of, {count}, "materials_of");
  CheckShape(bodies, {count}, "bodies");
  auto rows = ReadRows<Material>(materials, kMaterialFields, "materials");
  std::vector<Texture> pictures;
  for (const Floats& pixels : textures) pictures.push_back(MakeTexture(pixels));
  std::vector<Triangle> triangles(count);
  for (py::ssize_t i = 0; i < count; ++i) {
    Triangle& t = triangles[i];
    const float* p = corners.data() + 9 * i;
    for (int k = 0; k < 3; ++k) {
      t.corner[k] = p[k];
      t.edge1[k] = p[3 + k] - p[k];
      t.edge2[k] = p[6 + k] - p[k];
    }
    std::memcpy(&t.normals, normals.data() + 9 * i, sizeof(t.normals));
    std::memcpy(&t.uv, uv.data() + 6 * i, sizeof(t.uv));
    t.material = materials_of.data()[i];
    t.body = bodies.data()[i];
    if (t.material < 0 || t.material >= static_cast<int>(rows.size())) {
      throw std::invalid_argument("a triangle has no material");
    }
    const int texture = static_cast<int>(rows[t.material].texture);
    if (texture >= static_cast<int>(pictures.size())) {
      throw std::invalid_argument("a material has no texture");
    }
    t.texels = texture < 0 ? 0 : MeasureTexels(t, pictures[texture]);
  }
  const auto lights = ReadRows<Light>(light, kLightFields, "light");
  if (lights.size() != 1) throw std::invalid_argument("light has a wrong shape");
  return std::make_unique<Tracer>(std::move(triangles), std::move(rows), std::move(pictures),
                                  lights[0], ReadRows<Lamp>(lamps, kLampFields, "lamps"));
}

py::tuple TraceRays(const Tracer& tracer, const Floats& origins, const Floats& directions,
                    float spread, std::uint64_t seed, int samples, bool with_light) {
  const py::ssize_t count = directions.shape(0);
  CheckShape(directions, {-1, 3}, "directions");
  CheckShape(origins, {count, 3}, "origins");
  Floats colors({count, py::ssize_t{3}}), distances(count);
  Numbers bodies(count);
  float* color = colors.mutable_data();
  float* distance = distances.mutable_data();
  std::int32_t* body = bodies.mutable_data();
  {
    const py::gil_scoped_release release;
    for (py::ssize_t i = 0; i < count; ++i) {
      const float* o = origins.data() + 3 * i;
      const float* d = directions.data() + 3 * i;
      const Seen seen = tracer.Trace({o[0], o[1], o[2]}, {d[0], d[1], d[2]}, spread,
                                     (seed << 32) + static_cast<std::uint64_t>(i),
                                     static_cast<int>(i * samples / count), with_light);
      std::copy(seen.color.begin(), seen.color.end(), color + 3 * i);
      distance[i] = seen.distance;
      body[i] = seen.body;
    }
  }
  return py::make_tuple(colors, distances, bodies);
}

}  // namespace

PYBIND11_MODULE(gsut_proving_tracer, m) {
  m.doc() = "Traces rays through textured triangles under a sky.";
  py::class_<Tracer>(m, "Tracer")
      .def(py::init(&MakeTracer), py::arg("corners"), py::arg("normals"), py::arg("uv"),
           py::arg("materials_of"), py::arg("bodies"), py::arg("materials"), py::arg("textures"),
           py::arg("light"), py::arg("lamps"))
      .def("trace", &TraceRays, py::arg("origins"), py::arg("directions"), py::arg("spread"),
           py::arg("seed") = 0, py::arg("samples") = 1, py::arg("with_light") = true,
           "Colours (N, 3) in linear light, distances (N,), infinite for the sky, and bodies (N,), "
           "-1 for the sky, along unit directions (N, 3): first those of all pixels' first "
           "samples. Without light the colours are black.");
}

}  // namespace proving
