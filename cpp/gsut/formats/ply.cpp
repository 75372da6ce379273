// Reads and writes PLY files of Gaussians and points.
//
// The layout of 3DGS, which all viewers read: one element "vertex" with float properties
//   x y z                     means;
//   nx ny nz                  normals, zero;
//   f_dc_0 .. 2               harmonics of degree 0, one a channel;
//   f_rest_0 .. 3 (K - 1) - 1 the others, channel by channel: all K - 1 of red come first;
//   opacity                   logit;
//   scale_0 .. 2              natural logarithms (surfels: two);
//   rot_0 .. 3                quaternion w x y z, of any norm.
// Readers find properties by name, so other properties and orders do no harm.
#include "gsut/formats/ply.h"

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <system_error>

#include "gsut/base/errors.h"
#include "gsut/formats/ply_rows.h"
#include "gsut/gaussians/check_gaussians.h"
#include "gsut/gaussians/harmonics.h"
#include "gsut/gaussians/surfels.h"

namespace gsut {
namespace {

// Stands for an infinite logit; the opacity 1 - 2e-9 rounds to 1 in float.
constexpr float kLargestLogit = 20.0f;
// Farther from zero, neighbouring floats lie 0.5 mm apart, or more, of coordinates in metres.
constexpr double kFarFromZero = 4096.0;

// Element of this name, or an error that lists what the file has instead.
std::size_t FindVertices(const PlyHeader& header, const std::string& path) {
  std::string names;
  for (std::size_t i = 0; i < header.elements.size(); ++i) {
    if (header.elements[i].name == "vertex") return i;
    names += " " + header.elements[i].name;
  }
  throw InputError(path + ": no element \"vertex\"; the file has:" + names);
}

std::size_t FindProperty(const PlyElement& element, const std::string& name,
                         const std::string& path, const char* kind) {
  const int at = element.Find(name);
  if (at < 0) {
    throw InputError(path + ": property \"" + name + "\" is missing, so these are not " + kind +
                     "; the file has: " + element.PropertyNames());
  }
  if (element.properties[static_cast<std::size_t>(at)].is_list) {
    throw InputError(path + ": property \"" + name + "\" is a list; a number is needed");
  }
  return static_cast<std::size_t>(at);
}

// Columns of name0, name1, ... in the file.
std::vector<std::size_t> FindNumbered(const PlyElement& element, const std::string& name, int count,
                                      const std::string& path) {
  std::vector<std::size_t> columns(static_cast<std::size_t>(count));
  for (int i = 0; i < count; ++i) {
    columns[i] = FindProperty(element, name + std::to_string(i), path, "Gaussians");
  }
  return columns;
}

// K from the number of f_rest properties: 3 (K - 1) of them.
int CountCoefficients(const PlyElement& element, const std::string& path) {
  const std::string prefix = "f_rest_";
  const auto rest = std::count_if(
      element.properties.begin(), element.properties.end(),
      [&](const PlyProperty& property) { return property.name.rfind(prefix, 0) == 0; });
  if (rest % 3 != 0 || ShDegree(rest / 3 + 1) < 0) {
    throw InputError(path + ": " + std::to_string(rest) +
                     " properties f_rest_*; harmonics of degree 0 to 3 have 0, 9, 24 or 45");
  }
  return static_cast<int>(rest / 3 + 1);
}

// Files that are written are little-endian on every machine.
void PutLittleEndian(float value, char* out) {
  std::memcpy(out, &value, sizeof value);
  if constexpr (std::endian::native == std::endian::big) std::reverse(out, out + sizeof value);
}

// How many scales the file has: surfels have two, as 2DGS writes them.
int CountScales(const PlyElement& element) {
  return element.Find("scale_2") < 0 && element.Find("scale_1") >= 0 ? 2 : 3;
}

std::string GaussianHeader(const GaussiansView<const float>& gaussians, std::int64_t announced,
                           const std::vector<std::string>& comments, int scales, int* properties) {
  std::string text = "ply\nformat binary_little_endian 1.0\n";
  for (const std::string& comment : comments) text += "comment " + comment + "\n";
  text += "element vertex " + std::to_string(announced) + "\n";
  *properties = 0;
  const auto add = [&](const std::string& name) {
    text += "property float " + name + "\n";
    ++*properties;
  };
  const auto add_numbered = [&](const std::string& name, int count) {
    for (int i = 0; i < count; ++i) add(name + std::to_string(i));
  };
  for (const char* name : {"x", "y", "z", "nx", "ny", "nz"}) add(name);
  add_numbered("f_dc_", 3);
  add_numbered("f_rest_", 3 * (gaussians.sh_coefficients - 1));
  add("opacity");
  add_numbered("scale_", scales);
  add_numbered("rot_", 4);
  return text + "end_header\n";
}

// One row in the order of GaussianHeader.
void PutRow(const GaussiansView<const float>& g, std::int64_t row, int scales, char* out) {
  const auto put = [&](float value) {
    PutLittleEndian(value, out);
    out += sizeof value;
  };
  const auto put_range = [&](const float* values, int count) {
    for (int i = 0; i < count; ++i) put(values[i]);
  };
  put_range(g.means + 3 * row, 3);
  for (int i = 0; i < 3; ++i) put(0.0f);  // normals, which Gaussians do not have
  const float* sh = g.sh + 3 * row * g.sh_coefficients;
  put_range(sh, 3);
  for (int channel = 0; channel < 3; ++channel) {
    for (int k = 1; k < g.sh_coefficients; ++k) put(sh[3 * k + channel]);
  }
  put(g.opacity_logits[row]);
  put_range(g.log_scales + 3 * row, scales);
  put_range(g.quats + 4 * row, 4);
}

// Names are UTF-8 everywhere; Windows would take plain bytes for its own code page.
std::filesystem::path ToPath(const std::string& name) {
#ifdef _WIN32
  return std::filesystem::path(std::u8string(name.begin(), name.end()));
#else
  return name;  // whatever bytes it has
#endif
}

}  // namespace

// A folder opens without an error and then reads nothing; a pipe would wait for ever.
std::ifstream OpenToRead(const std::string& path) {
  if (path.find('\0') != std::string::npos) {  // the system would cut it off there
    throw InputError(std::string(path.c_str()) + "...: the name holds a zero byte; give another");
  }
  std::error_code unknown;
  const std::filesystem::file_status status = std::filesystem::status(ToPath(path), unknown);
  if (std::filesystem::exists(status) && !std::filesystem::is_regular_file(status)) {
    const bool is_folder = std::filesystem::is_directory(status);
    throw InputError(path + ": " + (is_folder ? "a folder" : "a pipe or a device") +
                     ", not a file");
  }
  std::ifstream stream(ToPath(path), std::ios::binary);
  if (!stream) throw InputError(path + ": cannot be opened: " + std::strerror(errno));
  return stream;
}

PlyGaussianReader::PlyGaussianReader(const std::string& path)
    : path_(path), stream_(OpenToRead(path)), header_(ReadPlyHeader(stream_, path)) {
  element_ = FindVertices(header_, path);
  const PlyElement& element = header_.elements[element_];
  // Everything is looked for now, so that a file of another kind fails before memory is allocated.
  for (const char* name : {"x", "y", "z", "opacity"}) {
    FindProperty(element, name, path, "Gaussians");
  }
  FindNumbered(element, "f_dc_", 3, path);
  FindNumbered(element, "scale_", CountScales(element), path);
  FindNumbered(element, "rot_", 4, path);
  sh_coefficients_ = CountCoefficients(element, path);
  FindNumbered(element, "f_rest_", 3 * (sh_coefficients_ - 1), path);
  CheckPlySize(stream_, path, header_);
  size_ = element.count;
}

std::int64_t PlyGaussianReader::Read(const GaussiansView<float>& out) {
  CheckGaussians(out.AsConst());
  // The arrays are those that size() and sh_coefficients() said.
  if (out.size != size_ || out.sh_coefficients != sh_coefficients_) {
    throw InputError(path_ + ": the arrays have " + std::to_string(out.size) + " rows of " +
                     std::to_string(out.sh_coefficients) + " coefficients; the file has " +
                     std::to_string(size_) + " of " + std::to_string(sh_coefficients_));
  }
  const PlyElement& element = header_.elements[element_];
  std::vector<std::size_t> means;
  for (const char* name : {"x", "y", "z"}) {
    means.push_back(FindProperty(element, name, path_, "Gaussians"));
  }
  const std::size_t opacity = FindProperty(element, "opacity", path_, "Gaussians");
  const auto scales = FindNumbered(element, "scale_", CountScales(element), path_);
  const auto rotations = FindNumbered(element, "rot_", 4, path_);
  // sh[k][channel] of the file: f_dc for k = 0, then channel-major f_rest.
  const int k_count = sh_coefficients_;
  const auto constant = FindNumbered(element, "f_dc_", 3, path_);
  const auto rest = FindNumbered(element, "f_rest_", 3 * (k_count - 1), path_);
  std::vector<std::size_t> sh(constant);
  for (int k = 1; k < k_count; ++k) {
    for (int channel = 0; channel < 3; ++channel) {
      sh.push_back(rest[static_cast<std::size_t>(channel * (k_count - 1) + k - 1)]);
    }
  }
  // Only ascii and double coordinates have digits that float would lose far from zero; the first
  // row's place, in whole units, then becomes the origin of all.
  const bool has_digits =
      header_.format == PlyFormat::kAscii || element.properties[means[0]].type == PlyType::kFloat64;
  std::int64_t row = 0, not_finite = 0;
  ReadPlyRows(stream_, path_, header_, element_, [&](const double* values) {
    bool finite = true;
    if (row == 0 && has_digits) {
      double largest = 0.0;
      for (const std::size_t column : means) largest = std::max(largest, std::abs(values[column]));
      for (std::size_t k = 0; std::isfinite(largest) && largest >= kFarFromZero && k < 3; ++k) {
        origin_[k] = std::round(values[means[k]]);
      }
    }
    // Values are double here; what float cannot hold becomes infinite and is counted.
    const auto get = [&](const std::vector<std::size_t>& columns, float* to) {
      for (const std::size_t column : columns) {
        *to = static_cast<float>(values[column]);
        finite = finite && std::isfinite(*to);
        ++to;
      }
    };
    for (std::size_t k = 0; k < 3; ++k) {
      float& mean = out.means[3 * row + static_cast<std::int64_t>(k)];
      mean = static_cast<float>(values[means[k]] - origin_[k]);
      finite = finite && std::isfinite(mean);
    }
    get(rotations, out.quats + 4 * row);
    get(scales, out.log_scales + 3 * row);
    if (scales.size() < 3) PressSurfel(out.log_scales + 3 * row);
    float& logit = out.opacity_logits[row];
    logit = static_cast<float>(values[opacity]);
    // Some trainers clamp opacities at 0 and 1, whose logits are infinite.
    if (std::isinf(logit)) logit = std::copysign(kLargestLogit, logit);
    finite = finite && !std::isnan(logit);
    get(sh, out.sh + 3 * row * k_count);
    not_finite += finite ? 0 : 1;
    ++row;
  });
  return not_finite;
}

void PutPly(const GaussiansView<const float>& gaussians, const std::vector<std::string>& comments,
            bool surfels, std::int64_t announced, const PutBytes& put) {
  CheckGaussians(gaussians);
  // A line break would end the comment and begin a line of the header.
  for (const std::string& comment : comments) {
    if (comment.find_first_of("\r\n") != std::string::npos) {
      throw InputError("a PLY comment holds a line break: \"" + comment + "\"; give one a line");
    }
  }
  int properties = 0;
  const int scales = surfels ? 2 : 3;
  const std::string header = GaussianHeader(gaussians, announced, comments, scales, &properties);
  // Parts of one file have one header, that of all of them.
  if (announced >= 0) put(header.data(), header.size());
  // Rows written at a time: about a megabyte.
  constexpr std::int64_t kBlockRows = 4096;
  // Rows are put together in memory: one write a block, not a number.
  const std::size_t row_bytes = static_cast<std::size_t>(properties) * sizeof(float);
  std::vector<char> block(kBlockRows * row_bytes);
  for (std::int64_t begin = 0; begin < gaussians.size; begin += kBlockRows) {
    const std::int64_t end = std::min(begin + kBlockRows, gaussians.size);
    for (std::int64_t row = begin; row < end; ++row) {
      PutRow(gaussians, row, scales,
             block.data() + static_cast<std::size_t>(row - begin) * row_bytes);
    }
    put(block.data(), static_cast<std::size_t>(end - begin) * row_bytes);
  }
}

std::vector<double> ReadPlyColumns(const std::string& path, const std::vector<std::string>& names) {
  std::ifstream stream = OpenToRead(path);
  const PlyHeader header = ReadPlyHeader(stream, path);
  const std::size_t index = FindVertices(header, path);
  CheckPlySize(stream, path, header);
  std::vector<std::size_t> columns;
  for (const std::string& name : names) {
    columns.push_back(FindProperty(header.elements[index], name, path, "points"));
  }
  std::vector<double> numbers;
  ReadPlyRows(stream, path, header, index, [&](const double* values) {
    for (const std::size_t column : columns) numbers.push_back(values[column]);
  });
  return numbers;
}

}  // namespace gsut
