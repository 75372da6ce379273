// Threads of the standard library, started for each loop: for the thread sanitizer, which does not
// see the order that oneTBB keeps, and for WebAssembly, whose module has the thread that calls it
// alone.
#include <algorithm>
#include <atomic>
#include <thread>
#include <vector>

#include "gsut/base/threads.h"

namespace gsut {
namespace {

// A module without shared memory cannot start threads at all.
#if defined(__EMSCRIPTEN__) && !defined(__EMSCRIPTEN_PTHREADS__)
constexpr bool kOneThread = true;
#else
constexpr bool kOneThread = false;
#endif

int CountProcessors() { return std::max(1, static_cast<int>(std::thread::hardware_concurrency())); }

std::atomic<int> wanted = 0;  // 0: one for each processor

}  // namespace

void SetThreads(int count) { wanted = count; }

int CountThreads() {
  if (kOneThread) return 1;
  const int count = wanted;
  return count == 0 ? CountProcessors() : count;
}

void RunChunks(std::int64_t chunks, bool /*nested*/,
               const std::function<void(std::int64_t)>& run_chunk) {
  // Each thread takes the next chunk when it has finished one, since chunks differ in work. Which
  // thread runs a chunk changes no bit: chunks do not know of each other.
  std::atomic<std::int64_t> next = 0;
  const auto work = [&] {
    for (std::int64_t chunk = next++; chunk < chunks; chunk = next++) run_chunk(chunk);
  };
  std::vector<std::thread> workers;
  const int count = CountThreads();
  for (int i = 1; i < count; ++i) workers.emplace_back(work);
  work();
  for (std::thread& worker : workers) worker.join();
}

// The loops of this file wait for their own threads only, so that work is isolated by itself.
void RunIsolated(const std::function<void()>& work) { work(); }

}  // namespace gsut
