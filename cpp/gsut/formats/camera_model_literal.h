// Parses Python literals, the text of mrcal's .cameramodel files.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace gsut {

// One value with the line it starts on. Tuples count as lists; bytes as strings.
struct PythonLiteral {
  enum class Kind { kNone, kBool, kNumber, kString, kList, kDict };
  Kind kind = Kind::kNone;
  int line = 1;
  double number = 0.0;               // also 0 or 1 of a bool
  std::string text;                  // of a string, escapes resolved
  std::vector<PythonLiteral> items;  // of a list; of a dict its keys and values in turn

  // The value of a key; null if this is no dict or lacks the key. The last one counts, as in
  // Python.
  const PythonLiteral* Find(std::string_view key) const;
};

// "a number", "a list" ...: for messages.
const char* KindName(PythonLiteral::Kind kind);

// Reads one literal and nothing after it but comments and white space. source: the file's name, for
// messages. Throws CalibrationError naming source, line and what was found.
PythonLiteral ParsePythonLiteral(std::string_view text, const std::string& source);

}  // namespace gsut
