// The methods' text for double: the names that it uses, then itself.
#pragma once

#include <hwy/highway.h>

#include "gsut/cameras/scalar_math.h"

namespace gsut::HWY_NAMESPACE {
using lenses::Abs;
using lenses::AndMask;
using lenses::Max;
using lenses::Min;
using lenses::OrMask;
using lenses::Select;
using lenses::Sqrt;
}  // namespace gsut::HWY_NAMESPACE

#include "gsut/projection/footprint-inl.h"

namespace gsut {

using ScalarFootprint = HWY_NAMESPACE::Footprint<double>;

}  // namespace gsut
