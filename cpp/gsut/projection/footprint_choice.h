// Which method adaptive takes for each Gaussian, from its size and place alone.
#pragma once

#include <cstdint>

#include "gsut/base/aligned_vector.h"
#include "gsut/projection/footprint_kernels.h"
#include "gsut/projection/lens_bend.h"

namespace gsut {

// The cheapest method whose error (footprint_error.h) is below the limit, decided before any of
// them is computed.
inline ProjectionMethod CheapestWithin(double limit, double ewa, double unscented_center,
                                       double unscented_box, double loosest_box) {
  if (ewa <= limit) return ProjectionMethod::kEwa;
  if (unscented_center <= limit && unscented_box <= loosest_box) {
    return ProjectionMethod::kUnscented;
  }
  return ProjectionMethod::kSilhouette;
}

// A method as lanes hold it.
inline constexpr float CodeOf(ProjectionMethod method) { return static_cast<float>(method); }

// The choices (CodeOf) of Gaussians in a row, and by how much the box of the chosen method is to be
// widened so that it holds the footprint (0 for the silhouette).
struct FootprintChoices {
  AlignedVector<float> codes, widths;
};

// Of [first, first + count), first a multiple of 16; bend: LensBend::table(); limit: pixels.
void ChooseFootprints(const FootprintTask& task, const Bend* bend, float limit, std::int64_t first,
                      std::int64_t count, FootprintChoices* choices);

}  // namespace gsut
