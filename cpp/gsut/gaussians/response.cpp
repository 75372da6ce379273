// Names of the responses.
#include "gsut/gaussians/response.h"

#include "gsut/base/errors.h"

namespace gsut {

const char* NameOf(Response response) {
  switch (response) {
    case Response::kExtinction:
      return "extinction";
    case Response::kDensity:
      return "density";
    default:
      return "maximum";
  }
}

Response ResponseNamed(const std::string& name) {
  for (const Response known : {Response::kMaximum, Response::kExtinction, Response::kDensity}) {
    if (name == NameOf(known)) return known;
  }
  throw InputError("response \"" + name + "\" is unknown; known: maximum, extinction, density");
}

}  // namespace gsut
