// The check of each thread.
#include "gsut/base/interrupt.h"

#include <utility>

namespace gsut {
namespace {

constexpr auto kInterval = std::chrono::milliseconds(100);
thread_local InterruptCheck* of_this_thread = nullptr;

}  // namespace

// Of nested checks the outermost one is asked: it belongs to the call that the user made.
InterruptCheck::InterruptCheck(std::function<std::exception_ptr()> ask)
    : ask_(std::move(ask)),
      next_(std::chrono::steady_clock::now() + kInterval),
      outermost_(of_this_thread == nullptr) {
  if (outermost_) of_this_thread = this;
}

InterruptCheck::~InterruptCheck() {
  if (outermost_) of_this_thread = nullptr;
}

InterruptCheck* InterruptCheck::OfThisThread() { return of_this_thread; }

// Asking takes Python's lock, so it is done at intervals; once wanted, an interrupt stays wanted.
bool InterruptCheck::IsWanted() {
  if (reason_ != nullptr) return true;
  const auto now = std::chrono::steady_clock::now();
  if (now < next_) return false;
  next_ = now + kInterval;
  reason_ = ask_();
  return reason_ != nullptr;
}

void InterruptCheck::Throw() const {
  if (reason_ != nullptr) std::rethrow_exception(reason_);
}

void CheckInterrupt() {
  if (of_this_thread != nullptr && of_this_thread->IsWanted()) of_this_thread->Throw();
}

}  // namespace gsut
