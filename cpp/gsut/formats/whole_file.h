// A file that appears whole or not at all, whatever happens while it is written.
#pragma once

#include <cstddef>
#include <cstdio>
#include <filesystem>
#include <string>

namespace gsut {

// Names are UTF-8 everywhere; Windows would take plain bytes for its own code page.
std::filesystem::path ToPath(const std::string& name);

// Throws InputError if the name holds a zero byte: the system would cut it off there.
void RequireWholeName(const std::string& path);

// Writes beside the file, under a name that nothing has, and takes its place on Commit. A link
// stays: what it leads to is replaced. All functions throw InputError naming the file and why.
class WholeFile {
 public:
  // Throws also if `path` is something other than a file.
  explicit WholeFile(const std::string& path);
  ~WholeFile();  // removes what was not committed
  WholeFile(const WholeFile&) = delete;
  WholeFile& operator=(const WholeFile&) = delete;

  void Write(const char* data, std::size_t size);
  // Flushes the file to the disk before it is renamed: a power cut leaves the old one or the new.
  void Commit();

 private:
  [[noreturn]] void Fail(const std::string& why) const;

  std::string path_;
  std::filesystem::path target_, temporary_;
  std::FILE* file_ = nullptr;
};

}  // namespace gsut
