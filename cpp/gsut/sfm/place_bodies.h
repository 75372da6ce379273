// Places a rig in frames that have no pose yet, by all that its cameras see.
#pragma once

#include "gsut/sfm/scene_map.h"

namespace gsut {

// Bodies whose images have no pose get one, and all their images, where enough points agree: P3P on
// what one image sees begins, then what all images of the body see decides. A few points in each
// camera are enough, where each alone would be too few.
// Args: options: max_error, min_inliers and seed; map: on a rig.
// Returns the number of images that were registered.
int PlaceBodies(const StructureOptions& options, SceneMap* map);

}  // namespace gsut
