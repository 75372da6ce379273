// Threads over oneTBB.
#include <tbb/global_control.h>
#include <tbb/info.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include "gsut/base/threads.h"

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

std::mutex threads_mutex;
// To be read under the lock. Never destroyed: at the end of the process a statically linked oneTBB
// is gone before.
std::shared_ptr<Threads>& LastThreads() {
  static auto& threads = *new std::shared_ptr<Threads>;
  return threads;
}

// A copy: a loop that runs keeps its threads, also while another thread changes their number.
std::shared_ptr<Threads> CurrentThreads() {
  const std::lock_guard<std::mutex> lock(threads_mutex);
  std::shared_ptr<Threads>& threads = LastThreads();
  if (threads == nullptr) threads = std::make_shared<Threads>(tbb::info::default_concurrency());
  return threads;
}

}  // namespace

void SetThreads(int count) {
  if (count == 0) count = tbb::info::default_concurrency();
  const std::lock_guard<std::mutex> lock(threads_mutex);
  std::shared_ptr<Threads>& threads = LastThreads();
  // global_control takes the least of all limits alive.
  threads = nullptr;  // the old limit goes before the new one comes
  threads = std::make_shared<Threads>(count);
}

int CountThreads() { return CurrentThreads()->count(); }

void RunChunks(std::int64_t chunks, bool nested,
               const std::function<void(std::int64_t)>& run_chunk) {
  const std::shared_ptr<Threads> current = CurrentThreads();
  if (current->count() == 1) {  // one thread needs no arena
    for (std::int64_t chunk = 0; chunk < chunks; ++chunk) run_chunk(chunk);
    return;
  }
  // A loop inside another one stays in the arena of the outer loop, whose threads are there
  // already.
  const auto loop = [&] { tbb::parallel_for(std::int64_t{0}, chunks, run_chunk); };
  nested ? loop() : current->Execute(loop);
}

// While the calling thread waits in here, oneTBB gives it no task from outside.
void RunIsolated(const std::function<void()>& work) { tbb::this_task_arena::isolate(work); }

}  // namespace gsut
