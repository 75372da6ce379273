// Refuses bundles that do not fit together.
#pragma once

#include "gsut/sfm/bundle.h"

namespace gsut {

// Throws InputError for an index out of range, or a list whose length does not fit; says which.
void CheckBundle(const Bundle& bundle, const BundleOptions& options);

}  // namespace gsut
