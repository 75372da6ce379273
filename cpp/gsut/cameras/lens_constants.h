// Numbers that every lens shares.
#pragma once

#include <limits>

namespace gsut {

inline constexpr double kPi = 3.141592653589793238;
inline constexpr double kInfinity = std::numeric_limits<double>::infinity();

// A pixel coordinate beyond this is no image, and a domain ends before it: a double has no digit
// left below 1e-7 px there, and the bound keeps overflow and NaN out of the results of every scalar
// type. It costs a pinhole of focal length 1000 px the last 2e-6 rad before 90 degrees.
inline constexpr double kMaxPixel = 1e9;

// |Project(Unproject(pixel)) - pixel| in pixels, unless the rounding of the pixel (beyond 1e5 px)
// or of the ray (where a pixel moves by more than 1e5 px per radian, next to a pole) is larger:
// then a few units in the last place of either.
inline constexpr double kInverseTolerance = 1e-9;

// Of SumRows: most columns, and the entries that a table in float has after its last (contract.h).
inline constexpr int kMaxColumns = 8;

}  // namespace gsut
