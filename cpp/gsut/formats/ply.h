// PLY files of Gaussians (the layout of 3DGS) and of point clouds, read by property name.
#pragma once

#include <array>
#include <cstdint>
#include <fstream>
#include <functional>
#include <string>
#include <vector>

#include "gsut/formats/ply_header.h"
#include "gsut/gaussians/gaussians.h"

namespace gsut {

// Gaussians of a PLY file: properties x y z, f_dc_0..2, f_rest_0..(0, 9, 24 or 45, channel-major),
// opacity (a logit), scale_0..2 (logarithms), rot_0..3 (w x y z) of element `vertex`, in any order,
// of any numeric type, ascii or binary; others (nx ny nz ...) are ignored. Without scale_2 they are
// surfels (2DGS), and the third scale is that of `PressSurfel`.
class PlyGaussianReader {
 public:
  // Reads the header. Throws InputError naming the file and what is missing or wrong.
  explicit PlyGaussianReader(const std::string& path);

  std::int64_t size() const { return size_; }
  int sh_coefficients() const { return sh_coefficients_; }

  // Fills the arrays of `out`, which has size() rows and sh_coefficients(); call once. Rows are
  // kept as they are, also those that are not finite; returns how many these are. Only infinite
  // opacity logits, which some writers use for opacities of exactly 0 and 1, become -20 and 20.
  // Throws InputError naming file and row if the data is truncated.
  std::int64_t Read(const GaussiansView<float>& out);
  // What Read took off the means: 0, but for coordinates far from zero (UTM) in a file that holds
  // more digits of them than float does, as text or in double.
  const std::array<double, 3>& origin() const { return origin_; }

 private:
  std::string path_;
  std::ifstream stream_;
  PlyHeader header_;
  std::size_t element_ = 0;
  std::int64_t size_ = 0;
  int sh_coefficients_ = 1;
  std::array<double, 3> origin_ = {0.0, 0.0, 0.0};
};

// Opens a file to read. Throws InputError for a folder, a pipe, a device, or what is not there.
std::ifstream OpenToRead(const std::string& path);

// Takes bytes of a file, in order.
using PutBytes = std::function<void(const char* data, std::size_t size)>;

// Formats binary little-endian float32 with nx ny nz = 0, as 3DGS does. Bits are kept. surfels:
// without the third scale, as 2DGS does. announced: the number of Gaussians that the header gives,
// of which these may be the first; negative: rows without a header. Throws InputError if a comment
// holds a line break.
void PutPly(const GaussiansView<const float>& gaussians, const std::vector<std::string>& comments,
            bool surfels, std::int64_t announced, const PutBytes& put);

// The numbers of these properties of element `vertex`, (N, names) row-major, whatever type they
// have: a point cloud has x y z. Throws InputError naming the file and what is missing or wrong.
std::vector<double> ReadPlyColumns(const std::string& path, const std::vector<std::string>& names);

}  // namespace gsut
