// Parallel loops with work split into chunks that do not depend on the thread count.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

namespace gsut {

// Number of threads used by all parallel loops; 0 resets to the number of processors the process
// may use. Throws InputError if negative.
void SetNumThreads(int num_threads);
int NumThreads();

// Calls body(begin, end) for consecutive chunks [0, grain), [grain, 2 grain), ... that cover
// [0, count), in any order and on any thread. The chunks depend on count and grain only, so a
// reduction that stores one partial result per chunk (index begin / grain) and adds them up in
// order gives the same bits for any number of threads. Worker threads flush denormal floats to
// zero while the body runs. The body must not throw.
void ParallelFor(std::int64_t count, std::int64_t grain,
                 const std::function<void(std::int64_t begin, std::int64_t end)>& body);

// Sum over chunks of partial(begin, end), added in chunk order: the same bits on any thread count.
double ParallelSum(std::int64_t count, std::int64_t grain,
                   const std::function<double(std::int64_t begin, std::int64_t end)>& partial);

// Flushes denormal floats to zero for the life of the object (x86: FTZ and DAZ), then restores.
class FlushDenormals {
 public:
  FlushDenormals();
  ~FlushDenormals();
  FlushDenormals(const FlushDenormals&) = delete;
  FlushDenormals& operator=(const FlushDenormals&) = delete;

 private:
  [[maybe_unused]] unsigned saved_;  // on x86
};

}  // namespace gsut
