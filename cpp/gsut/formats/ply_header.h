// The header of a PLY file: format, elements, properties.
#pragma once

#include <cstdint>
#include <istream>
#include <string>
#include <vector>

namespace gsut {

enum class PlyFormat { kAscii, kBinaryLittleEndian, kBinaryBigEndian };

enum class PlyType { kInt8, kUint8, kInt16, kUint16, kInt32, kUint32, kFloat32, kFloat64 };

// Bytes of one value in a binary file.
int PlyTypeBytes(PlyType type);

struct PlyProperty {
  std::string name;
  PlyType type = PlyType::kFloat32;  // of a list: of its entries
  bool is_list = false;
  PlyType count_type = PlyType::kUint8;  // lists only
};

struct PlyElement {
  std::string name;
  std::int64_t count = 0;
  std::vector<PlyProperty> properties;

  int Find(const std::string& property) const;  // -1 if absent
  std::string PropertyNames() const;            // "x y z", for messages
};

struct PlyHeader {
  PlyFormat format = PlyFormat::kBinaryLittleEndian;
  std::vector<PlyElement> elements;
  std::vector<std::string> comments;
};

// Reads up to and including end_header. Throws InputError naming `path` and the line.
PlyHeader ReadPlyHeader(std::istream& stream, const std::string& path);

}  // namespace gsut
