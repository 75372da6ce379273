// Feeds the parsers with damaged files, under whatever sanitizer this is built with: a file is read
// or refused by InputError. GSUT_FUZZ_FILES: how many of each file; GSUT_FUZZ_SEED: of the damage.
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <utility>

#include "gsut/base/errors.h"
#include "gsut/base/rng.h"
#include "parsers.h"

namespace gsut {
namespace {

using Parser = std::int64_t (*)(const std::string&, const std::string&);

std::uint64_t Setting(const char* name, std::uint64_t otherwise) {
  const char* text = std::getenv(name);
  return text == nullptr ? otherwise : std::strtoull(text, nullptr, 10);
}

std::string ContentOf(const std::filesystem::path& path) {
  std::ostringstream content;
  content << std::ifstream(path, std::ios::binary).rdbuf();
  return content.str();
}

class Damage {
 public:
  explicit Damage(std::uint64_t stream) : rng_(Setting("GSUT_FUZZ_SEED", 1), stream) {}

  std::string Of(std::string content) {
    const int changes = 1 + static_cast<int>(Below(4));
    for (int i = 0; i < changes; ++i) content = Changed(std::move(content));
    return content;
  }

 private:
  std::size_t Below(std::size_t count) {
    return static_cast<std::size_t>(rng_.Uniform(next_++) * static_cast<double>(count));
  }

  std::string Changed(std::string content) {
    static const std::array<const char*, 14> kWords = {"0",
                                                       "-1",
                                                       "nan",
                                                       "inf",
                                                       "1e308",
                                                       "1e-320",
                                                       "9223372036854775807",
                                                       "4294967296",
                                                       "\n",
                                                       "list uchar int",
                                                       "double",
                                                       "end_header\n",
                                                       "element vertex 9\n",
                                                       "]}("};
    const std::size_t begin = Below(content.size() + 1);
    constexpr std::array<std::size_t, 4> kLengths = {1, 4, 16, 200};
    const std::size_t length = std::min(content.size() - begin, kLengths[Below(4)]);
    switch (Below(7)) {
      case 0:
        return content.substr(0, begin);
      case 1:
        return content.erase(begin, length);
      case 2:
        return content.insert(begin, content.substr(begin, length));
      case 3:
        for (std::size_t i = 0; i < length; ++i) content[begin + i] = static_cast<char>(Below(256));
        return content;
      case 4:
        if (length > 0) content[begin] = static_cast<char>(content[begin] ^ (1 << Below(8)));
        return content;
      case 5:
        return content.replace(begin, length, kWords[Below(kWords.size())]);
      default: {  // a number becomes another
        const std::size_t digit = content.find_first_of("0123456789", begin);
        if (digit == std::string::npos) return content;
        const std::size_t end = content.find_first_not_of("0123456789.e+-", digit);
        return content.replace(digit, end == std::string::npos ? end : end - digit,
                               kWords[Below(8)]);
      }
    }
  }

  Rng rng_;
  std::uint64_t next_ = 0;
};

class FormatsFuzz : public testing::TestWithParam<std::pair<const char*, Parser>> {
 protected:
  std::string path_ = testing::TempDir() + "gsut_fuzz_" + std::to_string(getpid()) + ".ply";
  void TearDown() override { std::remove(path_.c_str()); }
};

// The corpus' files are read, those named found_... (by fuzzers) read or refused, and so is what
// damage makes of them: anything but InputError fails the test.
TEST_P(FormatsFuzz, DamagedFilesAreReadOrRefused) {
  const auto& [folder, parse] = GetParam();
  int files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(GSUT_CORPUS + std::string(folder))) {
    const std::string content = ContentOf(entry.path());
    Damage damage(++files);
    const std::uint64_t count = Setting("GSUT_FUZZ_FILES", 150);
    for (std::uint64_t i = 0; i <= count; ++i) {
      const bool whole = i == 0;
      try {
        EXPECT_LE(parse(whole ? content : damage.Of(content), path_), kMostRows);
      } catch (const InputError& error) {
        EXPECT_GT(std::string(error.what()).size(), 10U);
        EXPECT_TRUE(!whole || entry.path().filename().string().starts_with("found_")) << entry;
      }
    }
  }
  EXPECT_GE(files, 3);
}

INSTANTIATE_TEST_SUITE_P(Parsers, FormatsFuzz,
                         testing::Values(std::pair{"/gaussians", &ReadGaussians},
                                         std::pair{"/points", &ReadPoints},
                                         std::pair{"/cameramodel", &ReadCameraModel}),
                         [](const auto& info) { return std::string(info.param.first + 1); });

}  // namespace
}  // namespace gsut
