// The primitives that the build found: names, and their text for double.
#include "gsut/gaussians/primitive.h"

#include <cmath>

#include "gsut/base/errors.h"

namespace gsut {
namespace primitives {
namespace {

// What the text of a primitive calls, for double; vectors have theirs in primitives-inl.h.
double Sqrt(double x) { return std::sqrt(x); }
double Log2(double x) { return std::log2(x); }
double Exp2(double x) { return std::exp2(x); }
double Min(double a, double b) { return b < a ? b : a; }
double Max(double a, double b) { return a < b ? b : a; }
double Select(bool mask, double yes, double no) { return mask ? yes : no; }

#include "gsut_primitive_files.inc"

}  // namespace
}  // namespace primitives

namespace {

constexpr double kLn2 = 0.69314718055994530942;
// v = kPerSquare x D^2
constexpr double kPerSquare = -0.72134752044448170368;

// Calls visitor(primitives::Beta()) for kBeta, and so on.
template <class Visitor>
auto Visit(Primitive primitive, Visitor&& visitor) {
  switch (primitive) {
#define GSUT_PRIMITIVE_CASE(Kind) \
  case Primitive::k##Kind:        \
    return visitor(primitives::Kind());
    GSUT_FOR_EACH_PRIMITIVE(GSUT_PRIMITIVE_CASE)
#undef GSUT_PRIMITIVE_CASE
  }
  __builtin_unreachable();  // values come from PrimitiveNamed only
}

}  // namespace

// The generated list is in the order of the files' names, and so are the values of the enumeration:
// a primitive's value is its place in the list. Files name primitives by their names, so that the
// order may change.
std::vector<std::string> PrimitiveNames() {
  return {
#define GSUT_PRIMITIVE_NAME(Kind) primitives::Kind::kName,
      GSUT_FOR_EACH_PRIMITIVE(GSUT_PRIMITIVE_NAME)
#undef GSUT_PRIMITIVE_NAME
  };
}

Primitive PrimitiveNamed(const std::string& name) {
  const std::vector<std::string> names = PrimitiveNames();
  std::string known;
  for (std::size_t i = 0; i < names.size(); ++i) {
    if (name == names[i]) return static_cast<Primitive>(i);
    known += (i == 0 ? "" : ", ") + names[i];
  }
  throw InputError("primitive \"" + name + "\" is unknown; known: " + known);
}

const char* NameOf(Primitive primitive) {
  return Visit(primitive, [](auto kind) { return decltype(kind)::kName; });
}

bool HasShape(Primitive primitive) {
  return Visit(primitive, [](auto kind) { return decltype(kind)::kHasShape; });
}

bool IsFlat(Primitive primitive) {
  return Visit(primitive, [](auto kind) {
    return requires { kind.kEdges; };
  });
}

double WidthOf(Primitive primitive) {
  const double half = 2.0 * kLn2;  // D^2 of a Gaussian at half its response
  const double area = Visit(primitive, [](auto kind) {
    if constexpr (requires { kind.kArea; }) {
      return decltype(kind)::kArea;
    } else {
      return 1.0;
    }
  });
  return std::sqrt(area * Profile{primitive}.Cutoff(half) / half);
}

std::span<const double> ExampleShapes(Primitive primitive) {
  return Visit(primitive,
               [](auto kind) { return std::span<const double>(decltype(kind)::kExampleShapes); });
}

double Profile::Gauge(double x, double y, double* slopes) const {
  return Visit(primitive, [&](auto kind) {
    if constexpr (requires { kind.kEdges; }) {
      return kind.Gauge(x, y, &slopes[0], &slopes[1]);
    } else {
      return 0.0;  // no flat primitive
    }
  });
}

// The text counts in halvings, log2, as the float kernels do; here it is turned into nats. The
// derivative of ln f by -D^2 / 2 is that of log2 f by v: both logarithms have the same base.
double Profile::Response(double d2) const {
  return Visit(primitive, [&](auto kind) {
    return std::exp2(kind.LogResponse(kPerSquare * d2, kind.Activate(stored)));
  });
}

double Profile::Slope(double d2) const {
  return Visit(primitive,
               [&](auto kind) { return kind.Slope(kPerSquare * d2, kind.Activate(stored)); });
}

double Profile::StoredSlope(double d2) const {
  return Visit(primitive, [&](auto kind) {
    return kLn2 * kind.ShapeSlope(kPerSquare * d2, kind.Activate(stored)) *
           kind.ActivationSlope(stored);
  });
}

double Profile::Cutoff(double gaussian_cutoff) const {
  return Visit(primitive, [&](auto kind) {
    return kind.Invert(kPerSquare * gaussian_cutoff, kind.Activate(stored)) / kPerSquare;
  });
}

double Profile::Shape() const {
  return Visit(primitive, [&](auto kind) { return kind.Activate(stored); });
}

double Profile::ActivationSlope() const {
  return Visit(primitive, [&](auto kind) { return kind.ActivationSlope(stored); });
}

}  // namespace gsut
