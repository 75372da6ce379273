// Writes a temporary file, flushes it and renames it.
//
// What must hold at any moment, for whoever kills the process or pulls the plug:
//   1. the file of the wanted name is the old one or the whole new one;
//   2. no other file is opened for writing, whatever it is called: names are new ("x" of fopen,
//      O_EXCL of the system), and a link of that name is not followed;
//   3. the disk has all bytes before the name points to them.
// Python's files have the same in gsut.files.
#include "gsut/formats/whole_file.h"

// The standard library has neither the number of a process nor a flush to the disk.
#ifdef _WIN32
#include <io.h>
#include <process.h>
#else
#include <fcntl.h>
#include <unistd.h>
#endif

#include <atomic>
#include <cerrno>
#include <cstring>
#include <system_error>

#include "gsut/base/errors.h"

namespace gsut {
namespace {

// Opens a file that does not exist yet: neither a file nor a link of that name is followed.
std::FILE* OpenNew(const std::filesystem::path& path) {
#ifdef _WIN32
  return _wfopen(path.c_str(), L"wbx");
#else
  return std::fopen(path.c_str(), "wbx");
#endif
}

// Part of the temporary name: processes may write to one folder at once.
long ProcessNumber() {
#ifdef _WIN32
  return _getpid();
#else
  return getpid();
#endif
}

// From the buffer to the system, and from there to the disk.
bool FlushToDisk(std::FILE* file) {
  if (std::fflush(file) != 0) return false;
#ifdef _WIN32
  return _commit(_fileno(file)) == 0;
#else
  return fsync(fileno(file)) == 0;
#endif
}

// Makes a rename last through a power cut, where the system can.
void FlushFolder(const std::filesystem::path& folder) {
#ifndef _WIN32
  const int opened = open(folder.empty() ? "." : folder.c_str(), O_RDONLY | O_DIRECTORY);
  if (opened < 0) return;
  fsync(opened);
  close(opened);
#else
  (void)folder;
#endif
}

}  // namespace

std::filesystem::path ToPath(const std::string& name) {
#ifdef _WIN32
  return std::filesystem::path(std::u8string(name.begin(), name.end()));
#else
  return name;  // whatever bytes it has
#endif
}

void RequireWholeName(const std::string& path) {
  if (path.find('\0') != std::string::npos) {
    throw InputError(std::string(path.c_str()) + "...: the name holds a zero byte; give another");
  }
}

// One sentence, with the name that the caller gave.
void WholeFile::Fail(const std::string& why) const {
  throw InputError(path_ + ": cannot be written: " + why);
}

// Looks first at what is there: a folder, a pipe or a device is not replaced. Where a link leads to
// is what is written, so that the link stays.
WholeFile::WholeFile(const std::string& path) : path_(path) {
  RequireWholeName(path);
  std::error_code error;
  const std::filesystem::path given = ToPath(path);
  const std::filesystem::file_status status = std::filesystem::status(given, error);
  if (std::filesystem::exists(status) && !std::filesystem::is_regular_file(status)) {
    Fail("it is not a file; give another name");
  }
  target_ = std::filesystem::weakly_canonical(given, error);
  if (error || target_.empty()) target_ = given;
  // Threads of one process count on; a name left by an older process of this number is passed over.
  static std::atomic<unsigned> count = 0;
  do {
    temporary_ = target_;
    temporary_ += ".writing-" + std::to_string(ProcessNumber()) + "-" + std::to_string(count++);
    file_ = OpenNew(temporary_);
  } while (file_ == nullptr && errno == EEXIST);
  if (file_ == nullptr) Fail(std::strerror(errno));
}

// Nothing is left where Commit was not reached.
WholeFile::~WholeFile() {
  if (file_ != nullptr) std::fclose(file_);
  std::error_code ignored;
  if (!temporary_.empty()) std::filesystem::remove(temporary_, ignored);
}

// The buffer of the C library does; blocks of a megabyte pass it by.
void WholeFile::Write(const char* data, std::size_t size) {
  if (std::fwrite(data, 1, size, file_) != size) Fail(std::strerror(errno));
}

// Closing may be what reports a full disk, on file systems of other machines.
void WholeFile::Commit() {
  const bool is_flushed = FlushToDisk(file_);
  std::error_code error(errno, std::generic_category());
  const bool is_closed = std::fclose(file_) == 0;
  file_ = nullptr;
  if (!is_flushed) Fail(error.message());
  if (!is_closed) Fail(std::strerror(errno));
  std::filesystem::rename(temporary_, target_, error);
  if (error) Fail(error.message());
  temporary_.clear();
  FlushFolder(target_.parent_path());
}

}  // namespace gsut
