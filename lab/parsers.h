// The parsers as fuzzers call them: a file's content is read, or refused by InputError.
#pragma once

#include <cstdint>
#include <fstream>
#include <string>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/formats/camera_model.h"
#include "gsut/formats/ply.h"

namespace gsut {

inline constexpr std::int64_t kMostRows = 1 << 20;  // of a file of some kilobytes

inline void WriteContent(const std::string& path, const std::string& content) {
  std::ofstream(path, std::ios::binary | std::ios::trunc) << content;
}

// Rows of the file; `path` is where it is written for the reader.
inline std::int64_t ReadGaussians(const std::string& content, const std::string& path) {
  WriteContent(path, content);
  PlyGaussianReader reader(path);
  const std::int64_t n = reader.size();
  if (n > kMostRows) return n;
  const int k = reader.sh_coefficients();
  std::vector<float> means(3 * n), quats(4 * n), scales(3 * n), logits(n), sh(3 * n * k);
  reader.Read({n, k, means.data(), quats.data(), scales.data(), logits.data(), sh.data()});
  return n;
}

inline std::int64_t ReadPoints(const std::string& content, const std::string& path) {
  WriteContent(path, content);
  return static_cast<std::int64_t>(ReadPlyColumns(path, {"x", "y", "z"}).size() / 3);
}

inline std::int64_t ReadCameraModel(const std::string& content, const std::string&) {
  ParseCameraModel(content, "lens.cameramodel");
  return 1;
}

}  // namespace gsut
