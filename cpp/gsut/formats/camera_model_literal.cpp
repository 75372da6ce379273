// Parses Python literals, the text of mrcal's .cameramodel files.
#include "gsut/formats/camera_model_literal.h"

#include <cctype>
#include <charconv>

#include "gsut/base/errors.h"

namespace gsut {
namespace {

using Kind = PythonLiteral::Kind;

// Deeper nesting is no lens file, and would exhaust the stack.
constexpr int kMaxDepth = 32;

// A recursive-descent parser: one function for each kind of value,
//   value := dict | list | strings | word | number
//   dict  := '{' [value ':' value {',' value ':' value} [',']] '}'
//   list  := '[' [value {',' value} [',']] ']', or the same in parentheses.
// Each consumes what it recognises and leaves the rest, and counts lines for messages.
class Parser {
 public:
  Parser(std::string_view text, const std::string& source) : text_(text), source_(source) {}

  PythonLiteral ParseAll() {
    PythonLiteral value = ParseValue(0);
    SkipSpace();
    if (!AtEnd()) Fail("expected the end of the file");
    return value;
  }

 private:
  bool AtEnd() const { return position_ >= text_.size(); }
  char Peek() const { return AtEnd() ? '\0' : text_[position_]; }

  // Consumes a character.
  char Take() {
    const char c = Peek();
    if (c == '\n') ++line_;
    ++position_;
    return c;
  }

  // What was expected, and what is there instead.
  [[noreturn]] void Fail(const std::string& problem) const {
    std::string found = "the file ends";
    if (Peek() == '\n') {
      found = "the line ends";
    } else if (!AtEnd() && !std::isprint(static_cast<unsigned char>(Peek()))) {
      found = "found byte " + std::to_string(static_cast<unsigned char>(Peek()));
    } else if (!AtEnd()) {
      found.assign("found '").append(1, Peek()).append("'");
    }
    throw CalibrationError(source_ + ", line " + std::to_string(line_) + ": " + problem + ", " +
                           found + "; a .cameramodel file holds one Python dictionary");
  }

  // White space and comments.
  void SkipSpace() {
    while (!AtEnd()) {
      if (Peek() == '#') {
        while (!AtEnd() && Peek() != '\n') Take();
      } else if (std::isspace(static_cast<unsigned char>(Peek()))) {
        Take();
      } else {
        return;
      }
    }
  }

  // Consumes this character if it comes next, behind white space.
  bool TakeIf(char c) {
    SkipSpace();
    if (AtEnd() || Peek() != c) return false;
    Take();
    return true;
  }

  void Expect(char c) {
    if (!TakeIf(c)) Fail(std::string("expected '").append(1, c).append("'"));
  }

  PythonLiteral ParseValue(int depth) {
    SkipSpace();
    PythonLiteral value;
    value.line = line_;
    // Recursion is as deep as the nesting.
    if (depth > kMaxDepth) Fail("nested too deep");
    if (AtEnd()) Fail("expected a value");
    const char c = Peek();
    if (c == '{') {
      ParseDict(depth, &value);
    } else if (c == '[' || c == '(') {
      ParseList(depth, &value);
    } else if (IsStringStart()) {
      ParseStrings(&value);
    } else if (std::isalpha(static_cast<unsigned char>(c))) {
      ParseWord(&value);
    } else {
      ParseNumber(&value);
    }
    return value;
  }

  // Keys and values alternate in `items`. A comma may stand behind the last one.
  void ParseDict(int depth, PythonLiteral* value) {
    value->kind = Kind::kDict;
    Expect('{');
    while (!TakeIf('}')) {
      value->items.push_back(ParseValue(depth + 1));
      Expect(':');
      value->items.push_back(ParseValue(depth + 1));
      if (!TakeIf(',')) {
        Expect('}');
        return;
      }
    }
  }

  // Tuples are read as lists.
  void ParseList(int depth, PythonLiteral* value) {
    value->kind = Kind::kList;
    const char close = Take() == '[' ? ']' : ')';
    while (!TakeIf(close)) {
      value->items.push_back(ParseValue(depth + 1));
      if (!TakeIf(',')) {
        Expect(close);
        return;
      }
    }
  }

  static bool IsQuote(char c) { return c == '\'' || c == '"'; }

  // Strings: files of old Python versions have b'...' and u'...'.
  // A quote, perhaps after one of the prefixes b, r, u.
  bool IsStringStart() const {
    if (IsQuote(Peek())) return true;
    const bool prefix = std::string_view("bBrRuU").find(Peek()) != std::string_view::npos;
    return prefix && position_ + 1 < text_.size() && IsQuote(text_[position_ + 1]);
  }

  // Adjacent strings are one.
  void ParseStrings(PythonLiteral* value) {
    value->kind = Kind::kString;
    do {
      if (!IsQuote(Peek())) Take();
      ParseString(&value->text);
      SkipSpace();
    } while (!AtEnd() && IsStringStart());
  }

  void ParseString(std::string* out) {
    const char quote = Take();
    const std::string triple(3, quote);
    // Triple quotes may span lines; single ones may not.
    const bool is_triple = text_.substr(position_ - 1, 3) == triple;
    if (is_triple) position_ += 2;
    for (;;) {
      if (AtEnd()) Fail("a string is not closed");
      if (is_triple && text_.substr(position_, 3) == triple) {
        position_ += 3;
        return;
      }
      if (!is_triple && Peek() == quote) {
        Take();
        return;
      }
      if (!is_triple && Peek() == '\n') Fail("a string is not closed");
      // Only the escapes that such files use: others stand for their character.
      char c = Take();
      if (c == '\\' && !AtEnd()) {
        c = Take();
        if (c == 'n') c = '\n';
        if (c == 't') c = '\t';
      }
      out->push_back(c);
    }
  }

  // True, False or None; nothing is evaluated.
  void ParseWord(PythonLiteral* value) {
    const std::size_t begin = position_;
    std::size_t end = begin;
    while (end < text_.size() && std::isalnum(static_cast<unsigned char>(text_[end]))) ++end;
    const std::string_view word = text_.substr(begin, end - begin);
    if (word == "True" || word == "False") {
      value->kind = Kind::kBool;
      value->number = word == "True" ? 1.0 : 0.0;
    } else if (word != "None") {
      Fail("expected a value");
    }
    position_ = end;
  }

  // from_chars takes no plus sign, so it is passed over; then none may follow.
  void ParseNumber(PythonLiteral* value) {
    value->kind = Kind::kNumber;
    std::size_t begin = position_;
    if (Peek() == '+') ++begin;
    const char* first = text_.data() + begin;
    const char* last = text_.data() + text_.size();
    const auto [end, error] = std::from_chars(first, last, value->number);
    const bool sign_twice = begin != position_ && begin < text_.size() && text_[begin] == '-';
    if (error != std::errc() || sign_twice) Fail("expected a number");
    position_ = static_cast<std::size_t>(end - text_.data());
  }

  std::string_view text_;
  const std::string& source_;
  std::size_t position_ = 0;
  int line_ = 1;
};

}  // namespace

// Of several equal keys the last, as in Python.
const PythonLiteral* PythonLiteral::Find(std::string_view key) const {
  const PythonLiteral* found = nullptr;
  if (kind != Kind::kDict) return found;
  for (std::size_t i = 0; i < items.size(); i += 2) {
    if (items[i].kind == Kind::kString && items[i].text == key) found = &items[i + 1];
  }
  return found;
}

// For messages: an article and a noun.
const char* KindName(PythonLiteral::Kind kind) {
  switch (kind) {
    case Kind::kNone:
      return "None";
    case Kind::kBool:
      return "a truth value";
    case Kind::kNumber:
      return "a number";
    case Kind::kString:
      return "a string";
    case Kind::kList:
      return "a list";
    case Kind::kDict:
      return "a dictionary";
  }
  return "something else";
}

PythonLiteral ParsePythonLiteral(std::string_view text, const std::string& source) {
  return Parser(text, source).ParseAll();
}

}  // namespace gsut
