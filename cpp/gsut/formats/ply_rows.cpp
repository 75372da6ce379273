// PLY values: ascii, and binary of either byte order.
#include "gsut/formats/ply_rows.h"

#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <vector>

#include "gsut/base/errors.h"

namespace gsut {
namespace {

// Bytes read from the file at a time; streams are slow for single numbers.
constexpr std::size_t kBufferBytes = std::size_t{1} << 20;

// Bytes of the stream, a block at a time.
class Source {
 public:
  explicit Source(std::istream& stream) : stream_(stream), buffer_(kBufferBytes) {}

  // The next byte, or -1 at the end.
  int Next() {
    if (at_ == end_ && !Fill()) return -1;
    return static_cast<unsigned char>(buffer_[at_++]);
  }

  // `bytes` (at most 8) into out; false if the file ends before.
  bool Take(int bytes, char* out) {
    const auto wanted = static_cast<std::size_t>(bytes);
    if (end_ - at_ >= wanted) {
      std::memcpy(out, buffer_.data() + at_, wanted);
      at_ += wanted;
      return true;
    }
    for (int i = 0; i < bytes; ++i) {
      const int byte = Next();
      if (byte < 0) return false;
      out[i] = static_cast<char>(byte);
    }
    return true;
  }

 private:
  bool Fill() {
    stream_.read(buffer_.data(), static_cast<std::streamsize>(buffer_.size()));
    at_ = 0;
    end_ = static_cast<std::size_t>(stream_.gcount());
    return end_ > 0;
  }
  std::istream& stream_;
  std::vector<char> buffer_;
  std::size_t at_ = 0;
  std::size_t end_ = 0;
};

// memcpy, as values in a file are not aligned.
template <class T>
double Decode(const char* bytes) {
  T value;
  std::memcpy(&value, bytes, sizeof value);
  return static_cast<double>(value);
}

// Every type of PLY is exact in double.
double Decode(PlyType type, const char* bytes) {
  switch (type) {
    case PlyType::kInt8:
      return Decode<std::int8_t>(bytes);
    case PlyType::kUint8:
      return Decode<std::uint8_t>(bytes);
    case PlyType::kInt16:
      return Decode<std::int16_t>(bytes);
    case PlyType::kUint16:
      return Decode<std::uint16_t>(bytes);
    case PlyType::kInt32:
      return Decode<std::int32_t>(bytes);
    case PlyType::kUint32:
      return Decode<std::uint32_t>(bytes);
    case PlyType::kFloat32:
      return Decode<float>(bytes);
    case PlyType::kFloat64:
      return Decode<double>(bytes);
  }
  return 0.0;
}

// Numbers of a file, one after the other, in whichever of the three encodings it has.
enum class Outcome { kValue, kEnd, kNotANumber };

class Values {
 public:
  Values(std::istream& stream, PlyFormat format)
      : source_(stream),
        ascii_(format == PlyFormat::kAscii),
        swap_((format == PlyFormat::kBinaryBigEndian) !=
              (std::endian::native == std::endian::big)) {}

  Outcome Read(PlyType type, double* value) {
    return ascii_ ? ReadWord(value) : ReadBytes(type, value);
  }
  const std::string& word() const { return word_; }

 private:
  // Bytes are reversed where the file's order is not this machine's.
  Outcome ReadBytes(PlyType type, double* value) {
    std::array<char, 8> found, bytes;
    const int count = PlyTypeBytes(type);
    if (!source_.Take(count, found.data())) return Outcome::kEnd;
    for (int i = 0; i < count; ++i) {
      bytes[static_cast<std::size_t>(i)] =
          found[static_cast<std::size_t>(swap_ ? count - 1 - i : i)];
    }
    *value = Decode(type, bytes.data());
    return Outcome::kValue;
  }

  // A word between white space. from_chars takes no plus sign, which some writers put; and unlike
  // streams it does not depend on the locale's decimal point.
  Outcome ReadWord(double* value) {
    const auto is_space = [](int c) { return c == ' ' || c == '\n' || c == '\r' || c == '\t'; };
    int c = source_.Next();
    while (is_space(c)) c = source_.Next();
    if (c < 0) return Outcome::kEnd;
    // A longer word is no number: binary data behind an ascii header would fill memory.
    constexpr std::size_t kLongestNumber = 64;
    word_.clear();
    for (; c >= 0 && !is_space(c) && word_.size() < kLongestNumber; c = source_.Next()) {
      word_.push_back(static_cast<char>(c));
    }
    const char* begin = word_.data() + (word_[0] == '+' ? 1 : 0);
    const char* end = word_.data() + word_.size();
    const auto result = std::from_chars(begin, end, *value);
    return result.ec == std::errc() && result.ptr == end ? Outcome::kValue : Outcome::kNotANumber;
  }

  Source source_;
  bool ascii_;
  bool swap_;
  std::string word_;
};

// Lists are read and dropped: faces and the like have no numbers of fixed places.
void ReadElement(Values& reader, const PlyElement& element, const std::string& path,
                 const std::function<void(const double*)>* row_function) {
  std::vector<double> values(element.properties.size());
  if (element.properties.empty()) return;  // rows of nothing, however many the header claims
  for (std::int64_t row = 0; row < element.count; ++row) {
    const auto fail = [&](const PlyProperty& property, const std::string& what) {
      throw InputError(path + ": " + element.name + " row " + std::to_string(row) + " of " +
                       std::to_string(element.count) + ", property " + property.name + ": " + what);
    };
    const auto read = [&](const PlyProperty& property, PlyType type, double* value) {
      const Outcome outcome = reader.Read(type, value);
      if (outcome == Outcome::kEnd) fail(property, "the file ends here; it is truncated");
      if (outcome == Outcome::kNotANumber) {
        fail(property, "\"" + reader.word() + "\" is not a number");
      }
    };
    for (std::size_t i = 0; i < values.size(); ++i) {
      const PlyProperty& property = element.properties[i];
      if (!property.is_list) {
        read(property, property.type, &values[i]);
        continue;
      }
      double length = 0.0, entry = 0.0;
      read(property, property.count_type, &length);
      // A list's length may be of any type. The loop needs no memory for it: of one too long the
      // file ends first.
      if (!(length >= 0.0 && length == std::floor(length))) {
        fail(property, "is a list of " + std::to_string(length) + " entries, which cannot be");
      }
      for (; length > 0.0; length -= 1.0) read(property, property.type, &entry);
      values[i] = 0.0;
    }
    if (row_function != nullptr) (*row_function)(values.data());
  }
}

}  // namespace

void CheckPlySize(std::istream& stream, const std::string& path, const PlyHeader& header) {
  // How much is left: to the end and back.
  const std::istream::pos_type here = stream.tellg();
  stream.seekg(0, std::ios::end);
  const double left = static_cast<double>(stream.tellg() - here);
  stream.seekg(here);
  // In double, since a hostile header's counts overflow whole numbers. Ascii rows have at least one
  // character a property, lists at least their count.
  double needed = 0.0;
  for (const PlyElement& element : header.elements) {
    std::int64_t row_bytes = 0;
    for (const PlyProperty& property : element.properties) {
      const bool ascii = header.format == PlyFormat::kAscii;
      row_bytes += ascii ? 1 : PlyTypeBytes(property.is_list ? property.count_type : property.type);
    }
    needed += static_cast<double>(element.count) * static_cast<double>(row_bytes);
  }
  if (needed > left) {
    const auto text = [](double bytes) {  // more than whole numbers hold, too
      const std::string digits = std::to_string(bytes);
      return digits.substr(0, digits.find('.'));
    };
    throw InputError(path + ": truncated: the header announces at least " + text(needed) +
                     " bytes of data, " + text(left) + " are there");
  }
}

// Rows are handed on one by one, so that no file is held in memory as a whole.
void ReadPlyRows(std::istream& stream, const std::string& path, const PlyHeader& header,
                 std::size_t index, const std::function<void(const double* values)>& row) {
  Values reader(stream, header.format);
  // Rows of earlier elements have no index: they are read to get past them.
  for (std::size_t i = 0; i < index; ++i) {
    ReadElement(reader, header.elements[i], path, nullptr);
  }
  ReadElement(reader, header.elements[index], path, &row);
}

}  // namespace gsut
