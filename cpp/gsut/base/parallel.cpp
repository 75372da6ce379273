// Parallel loops over oneTBB.
#include "gsut/base/parallel.h"

#include <tbb/global_control.h>
#include <tbb/info.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <memory>
#include <mutex>
#include <string>

#include "gsut/base/errors.h"

#if defined(__SSE2__)
#include <xmmintrin.h>
#endif
#if defined(__SANITIZE_THREAD__)
#include <atomic>
#include <thread>
#endif

namespace gsut {
namespace {

// An arena of exactly the wanted size, even beyond the number of processors (tests use that).
struct Threads {
  explicit Threads(int count)
      : control(tbb::global_control::max_allowed_parallelism, static_cast<std::size_t>(count)),
        arena(count) {}
  tbb::global_control control;
  tbb::task_arena arena;
};

std::mutex threads_mutex;
// To be read under the lock. Never destroyed: at the end of the process a statically linked oneTBB
// is gone before.
std::shared_ptr<Threads>& LastThreads() {
  static auto& threads = *new std::shared_ptr<Threads>;
  return threads;
}

std::shared_ptr<Threads> CurrentThreads() {
  const std::lock_guard<std::mutex> lock(threads_mutex);
  std::shared_ptr<Threads>& threads = LastThreads();
  if (threads == nullptr) threads = std::make_shared<Threads>(tbb::info::default_concurrency());
  return threads;
}

#if defined(__SANITIZE_THREAD__)
// The thread sanitizer does not see the order that oneTBB's library keeps: here are plain threads.
template <class RunChunk>
void RunChunks(tbb::task_arena* arena, std::int64_t chunks, const RunChunk& run_chunk) {
  std::atomic<std::int64_t> next = 0;
  std::vector<std::jthread> workers;
  for (int i = 0; i < arena->max_concurrency(); ++i) {
    workers.emplace_back([&] {
      for (std::int64_t chunk = next++; chunk < chunks; chunk = next++) run_chunk(chunk);
    });
  }
}
#else
template <class RunChunk>
void RunChunks(tbb::task_arena* arena, std::int64_t chunks, const RunChunk& run_chunk) {
  arena->execute([&] { tbb::parallel_for(std::int64_t{0}, chunks, run_chunk); });
}
#endif

}  // namespace

void SetNumThreads(int num_threads) {
  if (num_threads < 0) {
    throw InputError("number of threads is " + std::to_string(num_threads) +
                     "; give 0 (all processors) or a positive number");
  }
  const int count = num_threads == 0 ? tbb::info::default_concurrency() : num_threads;
  const std::lock_guard<std::mutex> lock(threads_mutex);
  std::shared_ptr<Threads>& threads = LastThreads();
  threads = nullptr;  // the old limit goes before the new one comes
  threads = std::make_shared<Threads>(count);
}

int NumThreads() { return CurrentThreads()->arena.max_concurrency(); }

void ParallelFor(std::int64_t count, std::int64_t grain,
                 const std::function<void(std::int64_t, std::int64_t)>& body) {
  if (count <= 0) return;
  if (grain < 1) grain = 1;
  const std::int64_t chunks = (count + grain - 1) / grain;
  const auto run_chunk = [&](std::int64_t chunk) {
    const FlushDenormals flush;
    const std::int64_t begin = chunk * grain;
    body(begin, begin + grain < count ? begin + grain : count);
  };
  if (chunks == 1) {  // also within another loop: takes no lock
    run_chunk(0);
    return;
  }
  const std::shared_ptr<Threads> current = CurrentThreads();
  if (current->arena.max_concurrency() == 1) {
    for (std::int64_t chunk = 0; chunk < chunks; ++chunk) run_chunk(chunk);
    return;
  }
  RunChunks(&current->arena, chunks, run_chunk);
}

double ParallelSum(std::int64_t count, std::int64_t grain,
                   const std::function<double(std::int64_t, std::int64_t)>& partial) {
  if (count <= 0) return 0.0;
  if (grain < 1) grain = 1;
  std::vector<double> sums(static_cast<std::size_t>((count + grain - 1) / grain));
  ParallelFor(count, grain, [&](std::int64_t begin, std::int64_t end) {
    sums[static_cast<std::size_t>(begin / grain)] = partial(begin, end);
  });
  double total = 0.0;
  for (const double sum : sums) total += sum;
  return total;
}

#if defined(__SSE2__)
FlushDenormals::FlushDenormals() : saved_(_mm_getcsr()) {
  constexpr unsigned kFlushToZeroAndDenormalsAreZero = 0x8040;
  _mm_setcsr(saved_ | kFlushToZeroAndDenormalsAreZero);
}
FlushDenormals::~FlushDenormals() { _mm_setcsr(saved_); }
#else
FlushDenormals::FlushDenormals() : saved_(0) {}
FlushDenormals::~FlushDenormals() = default;
#endif

}  // namespace gsut
