// A lens' parameters in float.
#include <string>

#include "gsut/base/errors.h"
#include "gsut/cameras/lens_kernels.h"
#include "gsut/cameras/visit_lens.h"

namespace gsut {

// Parameters are rounded once; lanes read them by the thousand. Behind a table lie zeros that a
// whole row may be read from (SumRows).
FloatLens::FloatLens(const Camera& camera)
    : lens(camera.lens()),
      domain(camera.domain()),
      num_params(camera.num_params()),
      params(camera.params().begin(), camera.params().end()) {
  const bool has_table = VisitLens(lens, [](auto model) {
    return requires { decltype(model)::kHasTable; };
  });
  if (num_params > kMaxScalarParams && !has_table) {
    throw InputError("the lens has " + std::to_string(num_params) + " parameters; at most " +
                     std::to_string(kMaxScalarParams) + " can be projected or rendered");
  }
  params.resize(params.size() + kMaxColumns);
}

}  // namespace gsut
