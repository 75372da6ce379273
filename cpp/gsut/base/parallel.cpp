// Parallel loops over the threads of threads.h.
#include "gsut/base/parallel.h"

#include <atomic>
#include <functional>
#include <string>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/base/interrupt.h"
#include "gsut/base/threads.h"

#if defined(__SSE2__)
#include <xmmintrin.h>
#endif

namespace gsut {
namespace {

// Whether this thread runs a chunk of a loop: what it starts is run by the same arena.
thread_local bool within_loop = false;

class WithinLoop {
 public:
  WithinLoop() : before_(within_loop) { within_loop = true; }
  ~WithinLoop() { within_loop = before_; }
  WithinLoop(const WithinLoop&) = delete;
  WithinLoop& operator=(const WithinLoop&) = delete;

 private:
  bool before_;
};

}  // namespace

void SetNumThreads(int num_threads) {
  if (num_threads < 0) {
    throw InputError("number of threads is " + std::to_string(num_threads) +
                     "; give 0 (all processors) or a positive number");
  }
  SetThreads(num_threads);
}

int NumThreads() { return CountThreads(); }

void ParallelFor(std::int64_t count, std::int64_t grain,
                 const std::function<void(std::int64_t, std::int64_t)>& body) {
  if (count <= 0) return;
  if (grain < 1) grain = 1;
  // Chunks depend on count and grain only, never on the number of threads: a loop that sums within
  // a chunk gives the same bits on any machine.
  const std::int64_t chunks = (count + grain - 1) / grain;
  // Only the calling thread polls for an interrupt. While it waits it may run chunks of other
  // loops, which an interrupt of this one does not end.
  InterruptCheck* const check = chunks == 1 ? nullptr : InterruptCheck::OfThisThread();
  std::atomic<bool> ended = false;
  const auto run_chunk = [&](std::int64_t chunk) {
    if (check != nullptr) {
      if (ended.load(std::memory_order_relaxed)) return;
      if (check == InterruptCheck::OfThisThread() && check->IsWanted()) {
        ended.store(true, std::memory_order_relaxed);
        return;
      }
    }
    // This chunk may run on any thread: the mode is set and restored around it.
    const WithinLoop within;
    const FlushDenormals flush;
    const std::int64_t begin = chunk * grain;
    body(begin, begin + grain < count ? begin + grain : count);
  };
  if (chunks == 1) {  // also within another loop: takes no lock
    run_chunk(0);
    return;
  }
  RunChunks(chunks, within_loop, std::ref(run_chunk));
  if (ended) check->Throw();
}

double ParallelSum(std::int64_t count, std::int64_t grain,
                   const std::function<double(std::int64_t, std::int64_t)>& partial) {
  if (count <= 0) return 0.0;
  if (grain < 1) grain = 1;
  // One sum a chunk, added in order afterwards: the same bits on any number of threads.
  std::vector<double> sums(static_cast<std::size_t>((count + grain - 1) / grain));
  ParallelFor(count, grain, [&](std::int64_t begin, std::int64_t end) {
    sums[static_cast<std::size_t>(begin / grain)] = partial(begin, end);
  });
  double total = 0.0;
  for (const double sum : sums) total += sum;
  return total;
}

// Gradients of almost transparent Gaussians are denormal numbers, each of which costs processors
// some hundred cycles. Bits 15 and 6 of MXCSR flush results and operands to zero.
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
