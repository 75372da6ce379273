// Ends a long call early where its caller wants that.
#pragma once

#include <chrono>
#include <exception>
#include <functional>

namespace gsut {

// While it lives, what this thread calls asks every tenth of a second whether to end: ParallelFor
// before each of its chunks on this thread, solvers after each iteration, and CheckInterrupt. What
// was being made is lost then. One lives at a time on a thread; a second leaves the first in place.
class InterruptCheck {
 public:
  // ask: what to throw, or null to go on; called on this thread only.
  explicit InterruptCheck(std::function<std::exception_ptr()> ask);
  ~InterruptCheck();
  InterruptCheck(const InterruptCheck&) = delete;
  InterruptCheck& operator=(const InterruptCheck&) = delete;

  // That of this thread, or null.
  static InterruptCheck* OfThisThread();

  // Whether to end; asks if it is time to. Once true, always true.
  bool IsWanted();
  // Throws what was given as the reason, if IsWanted() was true.
  void Throw() const;

 private:
  std::function<std::exception_ptr()> ask_;
  std::exception_ptr reason_;
  std::chrono::steady_clock::time_point next_;
  bool outermost_;
};

// Throws what this thread's InterruptCheck says; without one it does nothing.
void CheckInterrupt();

}  // namespace gsut
