// Seconds between laps, by the wall clock and as processor time of the whole process.
#pragma once

#include <chrono>
#include <ctime>

namespace gsut {

// Duration of a stage. Processor time, summed over threads, does not depend on what else runs.
struct StageTime {
  const char* stage = "";
  double wall_seconds = 0.0;
  double cpu_seconds = 0.0;
};

class Stopwatch {
 public:
  // Time since construction or the last lap.
  StageTime Lap(const char* stage) {
    const auto wall = std::chrono::steady_clock::now();
    const std::clock_t cpu = std::clock();
    const StageTime time = {stage, std::chrono::duration<double>(wall - wall_).count(),
                            static_cast<double>(cpu - cpu_) / CLOCKS_PER_SEC};
    wall_ = wall;
    cpu_ = cpu;
    return time;
  }

 private:
  std::chrono::steady_clock::time_point wall_ = std::chrono::steady_clock::now();
  std::clock_t cpu_ = std::clock();
};

}  // namespace gsut
