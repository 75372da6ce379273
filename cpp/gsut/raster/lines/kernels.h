// The calls into the vectorised kernels for lines of the active instruction set.
#pragma once

#include <cstdint>

#include "gsut/gaussians/gaussians.h"
#include "gsut/projection/project.h"
#include "gsut/raster/frame.h"
#include "gsut/raster/line_grid.h"
#include "gsut/raster/task.h"

namespace gsut {

// Records, order keys and tiles of the Gaussians [begin, end), begin a multiple of 16; also their
// distance and status in `splats`, which have no pixels here.
void LineRecordsKernel(const RasterTask& task, const LineGrid& grid, std::int64_t begin,
                       std::int64_t end, Frame* frame, Splats* splats);

// As ForwardKernel.
void LineForwardKernel(const RasterTask& task, const LineGrid& grid, int tile, Frame* frame,
                       float* image, float* alpha, float* depth, float* distortion);

// As BackwardKernel; to_lines: null, or 5 x 256 floats for the gradients to a, b, s, t and slide of
// the tile's lines, swizzled.
void LineBackwardKernel(const RasterTask& task, const LineGrid& grid, int tile,
                        const ImageGradients& gradients, Frame* frame, float* to_lines);

// As GradientsKernel; adds to dshading[6], the gradients to the reference's centre and axis.
void LineGradientsKernel(const RasterTask& task, bool is_parallel, const Frame& frame,
                         std::int64_t begin, std::int64_t end, const GradientRows& to,
                         double* dshading);

// As LineForwardKernel, and blends task.channels into channels (H, W, D).
void LineChannelsForwardKernel(const RasterTask& task, const LineGrid& grid, int tile, Frame* frame,
                               float* image, float* alpha, float* depth, float* distortion,
                               float* channels);

// As LineBackwardKernel with gradients to the channels' pixels. to_channels: those of the values of
// the tile's pairs, an entry a row of D.
void LineChannelsBackwardKernel(const RasterTask& task, const LineGrid& grid, int tile,
                                const ImageGradients& gradients, Frame* frame, float* to_rays,
                                float* to_channels);

// Sums of blend weight x map (H, W, count) over the pixels of a kept tile: a row of `count` an
// entry.
void LineLiftKernel(const RasterTask& task, const LineGrid& grid, int tile, const float* map,
                    int count, Frame* frame, float* out);

// For OrderKey::kRay, after LineRecordsKernel: order keys that bound where any line is nearest to a
// Gaussian from below, less the distance from the reference at which a line may start, for the
// Gaussians [begin, end), begin a multiple of 16.
void LineRayOrderKeysKernel(const RasterTask& task, bool is_parallel, std::int64_t begin,
                            std::int64_t end, Frame* frame);

// As LineForwardKernel, of lists by those keys: each pixel blends in the order of its own line.
// Leaves no entries.
void LineRayOrderForwardKernel(const RasterTask& task, const LineGrid& grid, int tile, Frame* frame,
                               float* image, float* alpha, float* depth, float* distortion);

// As LineBackwardKernel, of a tile that LineRayOrderForwardKernel has blended.
void LineRayOrderBackwardKernel(const RasterTask& task, const LineGrid& grid, int tile,
                                const ImageGradients& gradients, Frame* frame, float* to_lines);

}  // namespace gsut
