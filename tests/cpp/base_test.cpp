// Tests gsut/base: parallel loops, random numbers; wrong arguments: sfm_wrong_arguments_test.
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <exception>
#include <stdexcept>
#include <thread>
#include <vector>

#include "gsut/base/interrupt.h"
#include "gsut/base/parallel.h"
#include "gsut/base/rng.h"

namespace gsut {
namespace {

TEST(ParallelForTest, EveryIndexOnce) {
  for (const int threads : {1, 2, 8}) {
    SetNumThreads(threads);
    std::vector<int> hits(1003, 0);
    ParallelFor(1003, 10, [&](std::int64_t begin, std::int64_t end) {
      EXPECT_EQ(begin % 10, 0);
      for (std::int64_t i = begin; i < end; ++i) ++hits[static_cast<std::size_t>(i)];
    });
    for (const int hit : hits) EXPECT_EQ(hit, 1);
  }
  SetNumThreads(0);
}

TEST(ParallelForTest, SumHasSameBitsOnAnyThreadCount) {
  std::vector<double> sums;
  for (const int threads : {1, 2, 8}) {
    SetNumThreads(threads);
    sums.push_back(ParallelSum(100000, 7, [](std::int64_t begin, std::int64_t end) {
      double sum = 0;
      for (std::int64_t i = begin; i < end; ++i) sum += 1.0 / static_cast<double>(i + 1);
      return sum;
    }));
  }
  SetNumThreads(0);
  EXPECT_EQ(sums[0], sums[1]);
  EXPECT_EQ(sums[0], sums[2]);
}

TEST(ParallelForTest, InterruptEndsALongLoopWithItsReason) {
  for (const int threads : {1, 3}) {
    SetNumThreads(threads);
    const InterruptCheck check([] { return std::make_exception_ptr(std::runtime_error("ended")); });
    std::atomic<std::int64_t> chunks = 0;
    constexpr std::int64_t kMany = 1 << 20;
    const auto loop = [&] {
      ParallelFor(kMany, 1, [&](std::int64_t, std::int64_t) {
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
        ++chunks;
      });
    };
    EXPECT_THROW(loop(), std::runtime_error);
    EXPECT_GT(chunks, 0);
    EXPECT_LT(chunks, kMany / 8);
    EXPECT_THROW(CheckInterrupt(), std::runtime_error);  // once wanted, always
  }
  SetNumThreads(0);
}

TEST(ParallelForTest, InterruptOfOneThreadLeavesTheOthersLoops) {
  SetNumThreads(3);
  std::atomic<bool> going = true;
  std::thread other([&] {
    const InterruptCheck check([] { return std::make_exception_ptr(std::runtime_error("ended")); });
    EXPECT_THROW(ParallelFor(1 << 20, 1,
                             [&](std::int64_t, std::int64_t) {
                               std::this_thread::sleep_for(std::chrono::milliseconds(1));
                             }),
                 std::runtime_error);
    going = false;
  });
  while (going) {
    std::atomic<int> calls = 0;
    ParallelFor(20, 1, [&](std::int64_t, std::int64_t) { ++calls; });
    ASSERT_EQ(calls, 20);
  }
  other.join();
  SetNumThreads(0);
}

TEST(RngTest, PhiloxMatchesPublishedVectors) {
  // Known answers of Random123 for philox4x32-10 with counter and key all zero.
  const auto words = Rng(0, 0).Words(0);
  EXPECT_EQ(words[0], 0x6627e8d5u);
  EXPECT_EQ(words[1], 0xe169c58du);
  EXPECT_EQ(words[2], 0xbc57ac4cu);
  EXPECT_EQ(words[3], 0x9b00dbd8u);
}

TEST(RngTest, MomentsOfUniformAndNormal) {
  const Rng rng(7, 3);
  constexpr int kCount = 200000;
  double sum = 0, normal = 0, square = 0;
  for (int i = 0; i < kCount; ++i) {
    const double u = rng.Uniform(i);
    ASSERT_GE(u, 0.0);
    ASSERT_LT(u, 1.0);
    sum += u;
    const auto n = rng.Normals(i);
    normal += n[0] + n[1];
    square += n[0] * n[0] + n[1] * n[1];
  }
  EXPECT_NEAR(sum / kCount, 0.5, 0.003);
  EXPECT_NEAR(normal / (2 * kCount), 0.0, 0.006);
  EXPECT_NEAR(square / (2 * kCount), 1.0, 0.01);
}

}  // namespace
}  // namespace gsut
