// PLY header parser.
#include "gsut/formats/ply_header.h"

#include <sstream>
#include <unordered_set>
#include <utility>

#include "gsut/base/errors.h"

namespace gsut {
namespace {

constexpr int kMaxHeaderLines = 100000;
constexpr std::size_t kMaxLineBytes = 65536;
constexpr std::size_t kQuotedBytes = 60;  // of a file's words in a message
constexpr std::size_t kNamedBytes = 600;  // of the names that a message lists: 60 or more

struct TypeName {
  const char* name;
  const char* sized_name;
  PlyType type;
  int bytes;
};

constexpr TypeName kTypes[] = {
    {"char", "int8", PlyType::kInt8, 1},        {"uchar", "uint8", PlyType::kUint8, 1},
    {"short", "int16", PlyType::kInt16, 2},     {"ushort", "uint16", PlyType::kUint16, 2},
    {"int", "int32", PlyType::kInt32, 4},       {"uint", "uint32", PlyType::kUint32, 4},
    {"float", "float32", PlyType::kFloat32, 4}, {"double", "float64", PlyType::kFloat64, 8},
};

// Words of a file are cut short in messages: a line of a header may have 64 kB.
std::string Quote(const std::string& word) {
  return '"' + (word.size() <= kQuotedBytes ? word : word.substr(0, kQuotedBytes) + "...") + '"';
}

// One header line without its end; stops early on a line that no header has (binary rubbish). Bytes
// beyond ASCII become "?": lines are quoted in messages, which have to be text.
bool GetLine(std::istream& stream, std::string* line) {
  line->clear();
  int c;
  while ((c = stream.get()) != std::istream::traits_type::eof()) {
    if (c == '\n') {
      if (!line->empty() && line->back() == '\r') line->pop_back();
      return true;
    }
    if (line->size() == kMaxLineBytes) return false;
    line->push_back(c < 0x80 ? static_cast<char>(c) : '?');
  }
  return false;
}

class Parser {
 public:
  Parser(std::istream& stream, const std::string& path) : stream_(stream), path_(path) {}

  PlyHeader Parse() {
    std::string line;
    if (!GetLine(stream_, &line) || line != "ply") {
      throw InputError(path_ + ": not a PLY file (the first line is not \"ply\")");
    }
    // obj_info lines, which some writers add, are passed over; other unknown keywords are errors.
    bool has_format = false;
    for (line_ = 2; line_ < kMaxHeaderLines && GetLine(stream_, &line); ++line_) {
      std::istringstream words(line);
      std::string keyword;
      words >> keyword;
      if (keyword == "end_header") {
        if (!has_format) Fail("there is no format line");
        return std::move(header_);
      }
      if (keyword == "format") {
        ParseFormat(words);
        has_format = true;
      } else if (keyword == "comment") {
        const std::size_t start = line.find_first_not_of(' ', line.find(keyword) + keyword.size());
        header_.comments.push_back(start == std::string::npos ? "" : line.substr(start));
      } else if (keyword == "element") {
        ParseElement(words);
      } else if (keyword == "property") {
        ParseProperty(words);
      } else if (!keyword.empty() && keyword != "obj_info") {
        Fail("unknown keyword " + Quote(keyword));
      }
    }
    Fail("the file ends before end_header");
  }

 private:
  // Names the line, as headers are text that people edit.
  [[noreturn]] void Fail(const std::string& what) const {
    throw InputError(path_ + ": PLY header, line " + std::to_string(line_) + ": " + what);
  }

  // The version behind the name is always 1.0 and is not looked at.
  void ParseFormat(std::istringstream& words) {
    std::string name;
    words >> name;
    if (name == "ascii") {
      header_.format = PlyFormat::kAscii;
    } else if (name == "binary_little_endian") {
      header_.format = PlyFormat::kBinaryLittleEndian;
    } else if (name == "binary_big_endian") {
      header_.format = PlyFormat::kBinaryBigEndian;
    } else {
      Fail("unknown format " + Quote(name) +
           "; known are ascii, binary_little_endian, binary_big_endian");
    }
  }

  // "element vertex 1000"
  void ParseElement(std::istringstream& words) {
    PlyElement element;
    std::string more;
    if (!(words >> element.name >> element.count) || element.count < 0 || words >> more) {
      Fail("expected \"element NAME COUNT\" with COUNT >= 0");
    }
    // Readers look elements up by name: of two with one name they would see one.
    if (!elements_.insert(element.name).second) {
      Fail("element " + Quote(element.name) + " appears twice");
    }
    header_.elements.push_back(std::move(element));
    properties_.clear();
  }

  // "property float x" or "property list uchar int vertex_indices", of the last element named.
  void ParseProperty(std::istringstream& words) {
    if (header_.elements.empty()) Fail("a property stands before the first element");
    PlyProperty property;
    std::string type;
    words >> type;
    if (type == "list") {
      property.is_list = true;
      words >> type;
      property.count_type = ParseType(type);
      words >> type;
    }
    property.type = ParseType(type);
    if (!(words >> property.name)) Fail("a property has no name");
    // A set, not a search: a header of 100,000 properties is to be read in linear time, too.
    if (!properties_.insert(property.name).second) {
      Fail("property " + Quote(property.name) + " appears twice");
    }
    header_.elements.back().properties.push_back(std::move(property));
  }

  // Types have two names: float and float32, uchar and uint8 ...
  PlyType ParseType(const std::string& name) const {
    for (const TypeName& type : kTypes) {
      if (name == type.name || name == type.sized_name) return type.type;
    }
    Fail("unknown type " + Quote(name));
  }

  std::istream& stream_;
  const std::string& path_;
  PlyHeader header_;
  std::unordered_set<std::string> elements_, properties_;  // names; of the last element
  int line_ = 1;
};

}  // namespace

// Of a number in a binary file.
int PlyTypeBytes(PlyType type) {
  for (const TypeName& known : kTypes) {
    if (known.type == type) return known.bytes;
  }
  return 0;
}

// Properties are few, so a linear search does.
int PlyElement::Find(const std::string& property) const {
  for (std::size_t i = 0; i < properties.size(); ++i) {
    if (properties[i].name == property) return static_cast<int>(i);
  }
  return -1;
}

// For messages.
std::string PlyElement::PropertyNames() const {
  std::string names;
  for (const PlyProperty& property : properties) {
    names += (names.empty() ? "" : " ") + property.name;
    if (names.size() > kNamedBytes) return names.substr(0, kNamedBytes) + " ...";
  }
  return names;
}

PlyHeader ReadPlyHeader(std::istream& stream, const std::string& path) {
  return Parser(stream, path).Parse();
}

}  // namespace gsut
