// What gsut asks of Ceres: no warnings on standard error, and when to stop.
#pragma once

#include <ceres/iteration_callback.h>
#include <glog/logging.h>

#include "gsut/base/interrupt.h"

namespace gsut {

// gsut reports errors by exceptions. While it lives, only errors are logged by this process' glog
// (which Ceres writes to). The small logger of a Ceres without glog is set to errors where it is
// compiled.
class [[maybe_unused]] QuietSolver {
#ifdef GOOGLE_STRIP_LOG  // defined by glog alone
 public:
  QuietSolver() : before_(FLAGS_minloglevel) {
    if (before_ < google::GLOG_ERROR) FLAGS_minloglevel = google::GLOG_ERROR;
  }
  ~QuietSolver() { FLAGS_minloglevel = before_; }
  QuietSolver(const QuietSolver&) = delete;
  QuietSolver& operator=(const QuietSolver&) = delete;

 private:
  int before_;
#endif
};

// Rejected steps allowed beyond the maximum of iterations: each at least halves the next step, and
// an undetermined lens parameter needs a factor of 2^10.
inline constexpr int kMostRejected = 10;

// Ends the solver after `steps` steps that lowered the cost. Ceres counts rejected ones too, and a
// lens whose parameters the colours hardly determine begins with several of those.
class StopAfter : public ceres::IterationCallback {
 public:
  explicit StopAfter(int steps) : left_(steps) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary& iteration) override {
    if (iteration.iteration > 0 && iteration.step_is_successful) --left_;
    return left_ > 0 ? ceres::SOLVER_CONTINUE : ceres::SOLVER_TERMINATE_SUCCESSFULLY;
  }

 private:
  int left_;
};

// Ends the solver where this thread's InterruptCheck wants it; CheckInterrupt then throws.
class StopWhenInterrupted : public ceres::IterationCallback {
 public:
  ceres::CallbackReturnType operator()(const ceres::IterationSummary&) override {
    InterruptCheck* const check = InterruptCheck::OfThisThread();
    const bool is_wanted = check != nullptr && check->IsWanted();
    return is_wanted ? ceres::SOLVER_ABORT : ceres::SOLVER_CONTINUE;
  }
};

}  // namespace gsut
