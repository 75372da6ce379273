// Depth order and tile lists: deterministic, stable, the same on any number of threads.
#pragma once

#include "gsut/raster/frame.h"
#include "gsut/raster/tile_grid.h"

namespace gsut {

// From frame->rects and frame->order_key: slot_begin, order (nearest first, equal keys by index),
// pairs and tile_begin. Throws InputError if there are more than 2^32 - 1 pairs.
void BinTiles(const TileGrid& grid, Frame* frame);

}  // namespace gsut
