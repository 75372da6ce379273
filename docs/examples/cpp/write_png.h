// Writes an 8-bit RGB image as a PNG without compression, so that the examples need no library.
#pragma once

#include <algorithm>
#include <cstdint>
#include <fstream>
#include <string>
#include <vector>

namespace png {

inline void AppendBigEndian(std::string* out, std::uint32_t value) {
  for (int shift = 24; shift >= 0; shift -= 8) out->push_back(static_cast<char>(value >> shift));
}

// The checksum of a PNG chunk (polynomial 0xEDB88320, as in zip).
inline std::uint32_t Crc32(const std::string& bytes) {
  std::uint32_t crc = 0xFFFFFFFFu;
  for (const char byte : bytes) {
    crc ^= static_cast<std::uint8_t>(byte);
    for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ (crc & 1 ? 0xEDB88320u : 0u);
  }
  return ~crc;
}

// A zlib stream of stored blocks: RFC 1950 and 1951.
inline std::string Store(const std::string& bytes) {
  constexpr std::size_t kBlock = 65535;
  std::string out = "\x78\x01";
  std::uint32_t a = 1, b = 0;
  for (std::size_t begin = 0; begin < bytes.size(); begin += kBlock) {
    const std::size_t length = std::min(kBlock, bytes.size() - begin);
    out.push_back(begin + length == bytes.size() ? 1 : 0);
    for (const std::size_t word : {length, ~length}) {
      out.push_back(static_cast<char>(word));
      out.push_back(static_cast<char>(word >> 8));
    }
    out.append(bytes, begin, length);
  }
  for (const char byte : bytes) {
    a = (a + static_cast<std::uint8_t>(byte)) % 65521;
    b = (b + a) % 65521;
  }
  AppendBigEndian(&out, b << 16 | a);
  return out;
}

}  // namespace png

// rgb: (height, width, 3) in [0, 1]; values outside are clamped. Throws if `path` cannot be
// written.
inline void WritePng(const std::string& path, const std::vector<float>& rgb, int width,
                     int height) {
  std::string rows;
  for (int y = 0; y < height; ++y) {
    rows.push_back(0);  // no filter
    for (int i = 0; i < 3 * width; ++i) {
      const float value = std::clamp(rgb[static_cast<std::size_t>(3) * y * width + i], 0.0f, 1.0f);
      rows.push_back(static_cast<char>(static_cast<int>(255.0f * value + 0.5f)));
    }
  }
  std::string header;
  png::AppendBigEndian(&header, static_cast<std::uint32_t>(width));
  png::AppendBigEndian(&header, static_cast<std::uint32_t>(height));
  header += std::string("\x08\x02\x00\x00\x00", 5);  // 8 bits, RGB
  std::ofstream stream(path, std::ios::binary);
  stream.exceptions(std::ios::failbit | std::ios::badbit);
  stream << "\x89PNG\r\n\x1a\n";
  for (const auto& [name, data] : {std::pair<std::string, std::string>{"IHDR", header},
                                   {"IDAT", png::Store(rows)},
                                   {"IEND", ""}}) {
    std::string length, crc;
    png::AppendBigEndian(&length, static_cast<std::uint32_t>(data.size()));
    png::AppendBigEndian(&crc, png::Crc32(name + data));
    stream << length << name << data << crc;
  }
}
