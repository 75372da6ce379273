// Stops a solver: after a number of steps that lowered the cost, or where the caller wants it.
#pragma once

#include <ceres/iteration_callback.h>

#include "gsut/base/interrupt.h"

namespace gsut {

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
