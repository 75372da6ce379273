// Records what parallel loops take chunk by chunk, to forecast them on more cores.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <vector>

namespace gsut {

// Numbers of cores that loops are forecast for.
inline constexpr std::array<int, 4> kForecastCores = {2, 4, 8, 16};

// Times are processor seconds of the thread that ran the loop.
struct TracedLoop {
  double begin = 0.0, end = 0.0;
  double longest = 0.0;  // of the chunks
  std::int64_t chunks = 0;
  // Of the loop on each number of cores, where each core takes the next chunk once it is free.
  std::array<double, kForecastCores.size()> seconds{};
};

// While tracing is on, every outermost loop runs on its calling thread alone, chunk after chunk.
void TraceLoops(bool on);
bool LoopsAreTraced();
// The loops since the last call, in the order in which they ended.
std::vector<TracedLoop> TakeTracedLoops();
// Runs and records a loop; see RunChunks.
void RunTraced(std::int64_t chunks, const std::function<void(std::int64_t chunk)>& run_chunk);

}  // namespace gsut
