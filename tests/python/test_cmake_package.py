"""The C++ core in somebody else's CMake project: by FetchContent and from an installed prefix."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build"  # of ./run setup
BASE = """
#include <gsut/base/parallel.h>

#include <cstdio>

int main() {
  gsut::SetNumThreads(2);
  const double sum = gsut::ParallelSum(
      100, 10, [](std::int64_t begin, std::int64_t end) { return double(end - begin); });
  std::printf("%g", sum);
}
"""
CAMERAS = """
#include <gsut/cameras/camera.h>

#include <cstdio>

int main() {
  const gsut::Camera camera("pinhole", {100.0, 100.0, 32.0, 24.0}, 64, 48);
  const double point[3] = {1.0, 2.0, 10.0};
  double pixel[2];
  std::uint8_t valid = 0;
  camera.Project(1, point, pixel, &valid);
  std::printf("%d %g %g", valid, pixel[0], pixel[1]);
}
"""
PROJECT = """
cmake_minimum_required(VERSION 3.22)
project(app LANGUAGES CXX)
{find}
add_executable(app main.cpp)
target_link_libraries(app PRIVATE gsut::{library})
get_target_property(flags gsut::{library} INTERFACE_COMPILE_OPTIONS)
if(flags)
  message(FATAL_ERROR "gsut forces flags on its user: ${{flags}}")
endif()
"""
FETCH = f"""
include(FetchContent)
FetchContent_Declare(gsut SOURCE_DIR "{ROOT}")
FetchContent_MakeAvailable(gsut)
"""

pytestmark = pytest.mark.skipif(not shutil.which("cmake"), reason="needs cmake")


def call(*command: object) -> str:
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def build_and_run(folder: Path, find: str, library: str, main: str, *defines: str) -> str:
    folder.mkdir()
    (folder / "main.cpp").write_text(main)
    (folder / "CMakeLists.txt").write_text(PROJECT.format(find=find, library=library))
    call("cmake", "-S", folder, "-B", folder / "build", "-DCMAKE_BUILD_TYPE=Debug",
         "-DCMAKE_DISABLE_PRECOMPILE_HEADERS=ON", *defines)  # fmt: skip
    call("cmake", "--build", folder / "build", "--target", "app", "--parallel", 2)
    return call(folder / "build/app")


def test_core_is_built_by_fetch_content(tmp_path):
    # Its smallest library: each other one is made by the same function of CMakeLists.txt.
    assert build_and_run(tmp_path / "fetched", FETCH, "base", BASE) == "100"


@pytest.mark.skipif(not (BUILD / "gsutConfig.cmake").exists(), reason="needs a build with tests")
def test_core_is_found_where_it_is_installed(tmp_path):
    prefix = tmp_path / "prefix"
    for component in ("base", "cameras"):
        call("cmake", "--install", BUILD, "--component", component, "--prefix", prefix)
    found = "find_package(gsut REQUIRED COMPONENTS {})"
    there = f"-DCMAKE_PREFIX_PATH={prefix}"
    app = build_and_run(tmp_path / "found", found.format("cameras"), "cameras", CAMERAS, there)
    assert app == "1 42 44"
    with pytest.raises(AssertionError, match="installed without the component sfm"):
        build_and_run(tmp_path / "missing", found.format("sfm"), "sfm", CAMERAS, there)
