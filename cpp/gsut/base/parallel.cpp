// Parallel loops over oneTBB.
#include "gsut/base/parallel.h"

#include <tbb/global_control.h>
#include <tbb/info.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <atomic>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/base/interrupt.h"

#if defined(__SSE2__)
#include <xmmintrin.h>
#endif
#if defined(__SANITIZE_THREAD__)
#include <thread>
#endif

namespace gsut {
namespace {

// The number of threads, which may exceed the number of processors (tests use that), and oneTBB
// arenas of that size. Each outermost loop has an arena of its own: in one that other loops fill,
// its thread would only wait, and could not poll its InterruptCheck.
class Threads {
 public:
  explicit Threads(int count)
      : count_(count),
        control_(tbb::global_control::max_allowed_parallelism, static_cast<std::size_t>(count)) {}

  int count() const { return count_; }

  // Takes a free arena or makes one, and gives it back: there is one for each loop that runs at the
  // same time.
  template <class Work>
  void Execute(const Work& work) {
    std::unique_ptr<tbb::task_arena> arena;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (!free_.empty()) {
        arena = std::move(free_.back());
        free_.pop_back();
      }
    }
    if (arena == nullptr) arena = std::make_unique<tbb::task_arena>(count_);
    const auto give_back = [&] {
      const std::lock_guard<std::mutex> lock(mutex_);
      free_.push_back(std::move(arena));
    };
    try {
      arena->execute(work);
    } catch (...) {
      give_back();
      throw;
    }
    give_back();
  }

 private:
  int count_;
  tbb::global_control control_;
  std::mutex mutex_;
  std::vector<std::unique_ptr<tbb::task_arena>> free_;
};

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
void RunChunks(Threads* threads, std::int64_t chunks, const RunChunk& run_chunk) {
  std::atomic<std::int64_t> next = 0;
  const auto work = [&] {
    for (std::int64_t chunk = next++; chunk < chunks; chunk = next++) run_chunk(chunk);
  };
  std::vector<std::jthread> workers;
  for (int i = 1; i < threads->count(); ++i) workers.emplace_back(work);
  work();
}
#else
template <class RunChunk>
void RunChunks(Threads* threads, std::int64_t chunks, const RunChunk& run_chunk) {
  const auto loop = [&] { tbb::parallel_for(std::int64_t{0}, chunks, run_chunk); };
  within_loop ? loop() : threads->Execute(loop);
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
  // global_control takes the least of all limits alive.
  threads = nullptr;  // the old limit goes before the new one comes
  threads = std::make_shared<Threads>(count);
}

int NumThreads() { return CurrentThreads()->count(); }

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
    // oneTBB may run this chunk on any thread: the mode is set and restored around it.
    const WithinLoop within;
    const FlushDenormals flush;
    const std::int64_t begin = chunk * grain;
    body(begin, begin + grain < count ? begin + grain : count);
  };
  if (chunks == 1) {  // also within another loop: takes no lock
    run_chunk(0);
    return;
  }
  const std::shared_ptr<Threads> current = CurrentThreads();
  // One thread needs no arena, and runs chunks in order.
  if (current->count() == 1) {
    for (std::int64_t chunk = 0; chunk < chunks; ++chunk) run_chunk(chunk);
  } else {
    RunChunks(current.get(), chunks, run_chunk);
  }
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
