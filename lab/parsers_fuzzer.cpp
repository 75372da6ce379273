// libFuzzer over one parser, which GSUT_FUZZ_PARSER names: lab/run fuzz --cpp.
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <map>
#include <string>

#include "parsers.h"

namespace {

using Parser = std::int64_t (*)(const std::string&, const std::string&);

Parser Chosen() {
  static const std::map<std::string, Parser> kParsers = {{"gaussians", gsut::ReadGaussians},
                                                         {"points", gsut::ReadPoints},
                                                         {"cameramodel", gsut::ReadCameraModel}};
  const char* name = std::getenv("GSUT_FUZZ_PARSER");
  const auto found = kParsers.find(name == nullptr ? "" : name);
  if (found == kParsers.end()) {
    std::fputs("GSUT_FUZZ_PARSER: gaussians, points or cameramodel\n", stderr);
    std::abort();
  }
  return found->second;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const Parser kParser = Chosen();
  static const std::string kPath = "/dev/shm/gsut_fuzzer_" + std::to_string(getpid()) + ".ply";
  try {
    const std::string content(reinterpret_cast<const char*>(data), size);
    if (kParser(content, kPath) > gsut::kMostRows) std::abort();
  } catch (const gsut::InputError&) {  // refused in a sentence; anything else ends the run
  }
  return 0;
}
