// Counter-based random numbers (Philox 4x32-10): a value depends on (seed, stream, index) only, so
// parallel code draws the same numbers on any number of threads and a resumed run goes on exactly.
// Source: Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>

namespace gsut {

class Rng {
 public:
  // seed: the run's seed; stream: what the numbers are for (one constant a use and step).
  constexpr Rng(std::uint64_t seed, std::uint64_t stream) : seed_(seed), stream_(stream) {}

  // Four independent uniform 32-bit words for a given index.
  constexpr std::array<std::uint32_t, 4> Words(std::uint64_t index) const {
    std::array<std::uint32_t, 4> c = {
        static_cast<std::uint32_t>(index), static_cast<std::uint32_t>(index >> 32),
        static_cast<std::uint32_t>(stream_), static_cast<std::uint32_t>(stream_ >> 32)};
    std::uint32_t k0 = static_cast<std::uint32_t>(seed_);
    std::uint32_t k1 = static_cast<std::uint32_t>(seed_ >> 32);
    for (int round = 0; round < kRounds; ++round) {
      const std::uint64_t p0 = kMultiplier0 * c[0];
      const std::uint64_t p1 = kMultiplier1 * c[2];
      c = {static_cast<std::uint32_t>(p1 >> 32) ^ c[1] ^ k0, static_cast<std::uint32_t>(p1),
           static_cast<std::uint32_t>(p0 >> 32) ^ c[3] ^ k1, static_cast<std::uint32_t>(p0)};
      k0 += kWeyl0;
      k1 += kWeyl1;
    }
    return c;
  }

  // Uniform in [0, 1) with 53 bits.
  constexpr double Uniform(std::uint64_t index) const {
    const auto w = Words(index);
    return ToUnit(w[0], w[1]);
  }

  // Two independent standard normal values (Box-Muller).
  std::array<double, 2> Normals(std::uint64_t index) const {
    const auto w = Words(index);
    constexpr double kTwoPi = 6.283185307179586476925;
    const double radius = std::sqrt(-2.0 * std::log1p(-ToUnit(w[0], w[1])));
    const double angle = kTwoPi * ToUnit(w[2], w[3]);
    return {radius * std::cos(angle), radius * std::sin(angle)};
  }

 private:
  static constexpr double ToUnit(std::uint32_t high, std::uint32_t low) {
    const std::uint64_t bits = (static_cast<std::uint64_t>(high) << 32 | low) >> 11;
    return static_cast<double>(bits) * 0x1.0p-53;
  }
  // Constants of the Philox 4x32 generator as published.
  static constexpr int kRounds = 10;
  static constexpr std::uint64_t kMultiplier0 = 0xD2511F53;
  static constexpr std::uint64_t kMultiplier1 = 0xCD9E8D57;
  static constexpr std::uint32_t kWeyl0 = 0x9E3779B9;
  static constexpr std::uint32_t kWeyl1 = 0xBB67AE85;

  std::uint64_t seed_;
  std::uint64_t stream_;
};

}  // namespace gsut
