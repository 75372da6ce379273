// The threads behind parallel.h. One of two files implements them, which CMake's GSUT_THREADS
// chooses: threads_tbb.cpp over oneTBB, threads_plain.cpp over the standard library alone.
#pragma once

#include <cstdint>
#include <functional>

namespace gsut {

// Sets the number of threads, which may exceed the number of processors; 0: the default.
void SetThreads(int count);
int CountThreads();

// Calls run_chunk(0) ... run_chunk(chunks - 1), each once, in any order and on any thread; on one
// thread in order. nested: the caller itself runs a chunk of a loop.
void RunChunks(std::int64_t chunks, bool nested,
               const std::function<void(std::int64_t chunk)>& run_chunk);

// Calls work() on this thread. While it waits for a loop in it, the thread takes up no work of
// other loops, which could wait for what this thread holds.
void RunIsolated(const std::function<void()>& work);

}  // namespace gsut
