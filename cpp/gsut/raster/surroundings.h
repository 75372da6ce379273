// What stands where no Gaussian was ever placed: a soft colour, carried in from all around.
#pragma once

#include <cstdint>

namespace gsut {

// The mean colour of what is covered around each pixel, weighted towards near it: a pull-push
// pyramid. An image and how much of it is covered are shrunk until one pixel is left; on the way
// back each level keeps what it knows and takes the rest from the coarser one.
// image (H, W, 3) over black; alpha (H, W) share that is covered; valid (H, W): 0 where a pixel has
// no ray; behind (H, W, 3): 0 where a pixel has no ray, black everywhere if nothing is covered.
// Returns false, and leaves `behind` alone, where all pixels are covered but for half a grey level.
// The same bits on any number of threads.
bool ComputeSurroundings(int width, int height, const float* image, const float* alpha,
                         const std::uint8_t* valid, float* behind);

}  // namespace gsut
