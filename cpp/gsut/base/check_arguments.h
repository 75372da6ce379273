// Checks of pointers, counts and sizes at the edge of the API, so that no loop has to.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "gsut/base/errors.h"

namespace gsut {

// Throws InputError if a pointer that must be given is null.
inline void CheckGiven(const void* pointer, const char* name) {
  if (pointer == nullptr) throw InputError(std::string(name) + " is null; it must be given");
}

// Throws InputError if a count is negative, or if it is above 0 and the array is null.
inline void CheckArray(const void* array, std::int64_t count, const char* name) {
  if (count < 0) {
    throw InputError("the number of rows of " + std::string(name) + " is " + std::to_string(count) +
                     "; give at least 0");
  }
  if (count > 0) CheckGiven(array, name);
}

// Throws InputError unless two arrays have the same number of rows.
inline void CheckSameSize(std::size_t first, std::size_t second, const char* names) {
  if (first == second) return;
  throw InputError(std::string(names) + " have " + std::to_string(first) + " and " +
                   std::to_string(second) + " rows; give the same number");
}

}  // namespace gsut
