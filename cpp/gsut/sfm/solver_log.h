// Keeps Ceres from writing warnings to standard error: gsut reports errors by exceptions.
#pragma once

#include <glog/logging.h>

namespace gsut {

// While it lives, only errors are logged by this process' glog (which Ceres writes to). The small
// logger of a Ceres without glog is set to errors where it is compiled.
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

}  // namespace gsut
