// Names of the orders: what files, options and Python call them. They are part of the format of
// scene files and stay as they are.
#include "gsut/gaussians/order.h"

#include "gsut/base/errors.h"

namespace gsut {

const char* NameOf(OrderKey order) {
  switch (order) {
    case OrderKey::kDepthZ:
      return "z";
    case OrderKey::kRay:
      return "ray";
    case OrderKey::kIntegral:
      return "integral";
    case OrderKey::kModel:
      return "model";
    default:
      return "distance";
  }
}

OrderKey OrderNamed(const std::string& name) {
  for (const OrderKey known : {OrderKey::kDistance, OrderKey::kDepthZ, OrderKey::kRay,
                               OrderKey::kIntegral, OrderKey::kModel}) {
    if (name == NameOf(known)) return known;
  }
  throw InputError("order \"" + name + "\" is unknown; known: distance, z, ray, integral, model");
}

}  // namespace gsut
