// Poses, points and lenses together, from poses and lenses that are roughly right.
#pragma once

#include <functional>
#include <span>
#include <vector>

#include "gsut/sfm/structure.h"

namespace gsut {

// As EstimatePoses, but from poses of all images: tracks are triangulated and everything is
// adjusted, first with observations up to eight times options.max_error away, then with ever closer
// ones; then tracks are extended where images have descriptors and the options say so.
// World: that of the poses, whose first image and one component of the farthest camera's centre are
// held. Structure::failure says why nothing was found.
// On a rig (options.rig) the poses must be in its units, which it keeps: one image's pose is held.
// Bodies without a pose are placed by what one of their cameras sees, and bring all their images.
// Args: pairs: verified matches; camera_from_world: one an image; registered: which of them are
//   known, all of a body or none (empty: all); options: lens_free says what of the lenses is
//   adjusted; without covariances it is for a trial and ends at a rougher tolerance; on_progress:
//   as for EstimatePoses.
// Throws InputError for an index out of range, fewer than two images, or images without a pose that
//   are on no rig.
Structure RefineStructure(const std::vector<Camera>& cameras,
                          const std::vector<ImageFeatures>& images,
                          std::span<const VerifiedPair> pairs,
                          const std::vector<Pose>& camera_from_world,
                          const std::vector<std::uint8_t>& registered,
                          const StructureOptions& options,
                          const std::function<bool(const StructureProgress&)>& on_progress);

}  // namespace gsut
