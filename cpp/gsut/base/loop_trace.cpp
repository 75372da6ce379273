// Records what parallel loops take chunk by chunk, to forecast them on more cores.
#include "gsut/base/loop_trace.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <ctime>
#include <mutex>
#include <utility>

namespace gsut {
namespace {

std::atomic<bool> traced = false;
std::mutex loops_mutex;

std::vector<TracedLoop>& Loops() {
  static auto& loops = *new std::vector<TracedLoop>;
  return loops;
}

// Processor seconds of this thread, which other processes do not change; where a system has no such
// clock, seconds.
double ReadClock() {
#if defined(CLOCK_THREAD_CPUTIME_ID)
  timespec time{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
#else
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
#endif
}

}  // namespace

void TraceLoops(bool on) { traced = on; }

bool LoopsAreTraced() { return traced.load(std::memory_order_relaxed); }

std::vector<TracedLoop> TakeTracedLoops() {
  const std::lock_guard<std::mutex> lock(loops_mutex);
  return std::exchange(Loops(), {});
}

void RunTraced(std::int64_t chunks, const std::function<void(std::int64_t)>& run_chunk) {
  TracedLoop loop;
  loop.chunks = chunks;
  loop.begin = ReadClock();
  std::array<std::vector<double>, kForecastCores.size()> busy;  // of each core, seconds
  for (std::size_t i = 0; i < busy.size(); ++i) busy[i].resize(kForecastCores[i]);
  double before = loop.begin;
  for (std::int64_t chunk = 0; chunk < chunks; ++chunk) {
    run_chunk(chunk);
    const double now = ReadClock(), seconds = now - std::exchange(before, now);
    loop.longest = std::max(loop.longest, seconds);
    for (std::vector<double>& cores : busy)
      *std::min_element(cores.begin(), cores.end()) += seconds;
  }
  for (std::size_t i = 0; i < busy.size(); ++i) {
    loop.seconds[i] = *std::max_element(busy[i].begin(), busy[i].end());
  }
  loop.end = ReadClock();
  const std::lock_guard<std::mutex> lock(loops_mutex);
  Loops().push_back(loop);
}

}  // namespace gsut
