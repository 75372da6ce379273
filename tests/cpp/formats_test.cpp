// Files that C++ writes: whole or not at all, and nobody else's.
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/formats/ply.h"
#include "gsut/formats/whole_file.h"

namespace gsut {
namespace {

namespace fs = std::filesystem;

// A folder that is removed at the end.
class Folder {
 public:
  Folder() : path_(fs::temp_directory_path() / ("gsut-formats-" + std::to_string(Next()))) {
    fs::remove_all(path_);
    fs::create_directory(path_);
  }
  ~Folder() { fs::remove_all(path_); }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  std::string At(const std::string& name) const { return (path_ / name).string(); }
  std::size_t Count() const {
    return static_cast<std::size_t>(
        std::distance(fs::directory_iterator(path_), fs::directory_iterator()));
  }

 private:
  static int Next() {
    static int number = 0;
    return ++number;
  }
  fs::path path_;
};

std::string Content(const std::string& path) {
  std::ostringstream text;
  text << std::ifstream(path, std::ios::binary).rdbuf();
  return text.str();
}

void Put(const std::string& path, const std::string& content) {
  std::ofstream(path, std::ios::binary) << content;
}

TEST(WholeFile, AppearsOnCommitAlone) {
  const Folder folder;
  Put(folder.At("a"), "old");
  {
    WholeFile file(folder.At("a"));
    file.Write("new", 3);
    EXPECT_EQ(Content(folder.At("a")), "old");
  }
  EXPECT_EQ(Content(folder.At("a")), "old");
  WholeFile file(folder.At("a"));
  file.Write("new", 3);
  file.Commit();
  EXPECT_EQ(Content(folder.At("a")), "new");
  EXPECT_EQ(folder.Count(), 1u);
}

TEST(WholeFile, LinkStaysAndItsTargetIsReplaced) {
  const Folder folder;
  Put(folder.At("target"), "old");
  fs::create_symlink("target", folder.At("link"));
  WholeFile file(folder.At("link"));
  file.Write("new", 3);
  file.Commit();
  EXPECT_TRUE(fs::is_symlink(folder.At("link")));
  EXPECT_EQ(Content(folder.At("target")), "new");
}

TEST(WholeFile, WhatIsNoFileIsRefused) {
  const Folder folder;
  EXPECT_THROW(WholeFile(folder.At("")), InputError);
  EXPECT_THROW(WholeFile(folder.At("none/a")), InputError);
  EXPECT_THROW(WholeFile(folder.At(std::string("a\0b", 3))), InputError);
}

TEST(WritePly, LeavesFilesBesideItAlone) {
  const Folder folder;
  Put(folder.At("mine"), "mine");
  fs::create_symlink("mine", folder.At("a.ply.partial"));
  const std::vector<float> values(4, 1.0f);
  WritePly(folder.At("a.ply"),
           {1, 1, values.data(), values.data(), values.data(), values.data(), values.data()});
  EXPECT_EQ(Content(folder.At("mine")), "mine");
  EXPECT_TRUE(fs::is_symlink(folder.At("a.ply.partial")));
  EXPECT_EQ(PlyGaussianReader(folder.At("a.ply")).size(), 1);
}

}  // namespace
}  // namespace gsut
