// Names of the responses: what files, options and Python call them. They are part of the format of
// scene files and stay as they are.
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
  // The writer may be newer than this reader, so the message says what this one knows.
  throw InputError("response \"" + name + "\" is unknown; known: maximum, extinction, density");
}

}  // namespace gsut
