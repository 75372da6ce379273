// What gsut takes from the C++20 library and libc++ before version 20 lacks (Debian's
// Emscripten 3.1.6 has 13). Included before every file of such a build; empty with a current
// library.
#pragma once

#include <algorithm>
#include <charconv>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <string>
#include <system_error>
#include <type_traits>
#include <version>

#if defined(_LIBCPP_VERSION) && _LIBCPP_VERSION < 16000
namespace std {  // NOLINT(cert-dcl58-cpp): what the standard puts there

#if _LIBCPP_VERSION < 14000
template <class To, class From>
constexpr To bit_cast(const From& from) {
  static_assert(sizeof(To) == sizeof(From));
  return __builtin_bit_cast(To, from);
}
#endif

template <class T>
unique_ptr<T> make_unique_for_overwrite() {
  return unique_ptr<T>(new T);
}

}  // namespace std
#endif

#if defined(_LIBCPP_VERSION) && _LIBCPP_VERSION < 200000
namespace std {

// The number at the beginning of [first, last), as from_chars reads it: no white space, no plus
// sign, no hexadecimal digits. The C library rounds correctly, and this module never changes its
// locale.
template <class T, enable_if_t<is_floating_point_v<T>, int> = 0>
from_chars_result from_chars(const char* first, const char* last, T& value) {
  const char* end = first;
  if (end != last && *end == '-') ++end;
  if (end == last || !(strchr("0123456789.iInN", *end) != nullptr && *end != '\0')) {
    return {first, errc::invalid_argument};
  }
  while (end != last && strchr("0123456789.eE+-infatyINFATY", *end) != nullptr && *end != '\0')
    ++end;
  const string text(first, end);
  char* stop = nullptr;
  const double found = strtod(text.c_str(), &stop);
  if (stop == text.c_str()) return {first, errc::invalid_argument};
  const char* after = first + (stop - text.c_str());
  const bool digits = text.find_first_of("123456789") != string::npos;
  if ((found == 0 && digits) || found - found != 0) {
    if (found == 0 || digits) return {after, errc::result_out_of_range};
  }
  value = static_cast<T>(found);
  return {after, errc()};
}

// As to_chars, except that 17 digits always stand where fewer would read back to the same number.
template <class T, enable_if_t<is_floating_point_v<T>, int> = 0>
to_chars_result to_chars(char* first, char* last, T value) {
  char text[32];
  const int length = snprintf(text, sizeof(text), "%.17g", static_cast<double>(value));
  if (length > last - first) return {last, errc::value_too_large};
  return {copy(text, text + length, first), errc()};
}

}  // namespace std
#endif
