"""The C++ core in somebody else's CMake project: by FetchContent and from an installed prefix."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MAIN = """
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
target_link_libraries(app PRIVATE gsut::cameras)
get_target_property(flags gsut::cameras INTERFACE_COMPILE_OPTIONS)
if(flags)
  message(FATAL_ERROR "gsut forces flags on its user: ${{flags}}")
endif()
"""
FETCH = f"""
include(FetchContent)
FetchContent_Declare(gsut SOURCE_DIR "{ROOT}")
set(GSUT_BUILD_SFM OFF)
set(GSUT_INSTALL ON)
FetchContent_MakeAvailable(gsut)
"""

pytestmark = pytest.mark.skipif(not shutil.which("cmake"), reason="needs cmake")


def call(*command: object) -> str:
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def build_and_run(folder: Path, find: str, *defines: str) -> str:
    folder.mkdir()
    (folder / "main.cpp").write_text(MAIN)
    (folder / "CMakeLists.txt").write_text(PROJECT.format(find=find))
    call("cmake", "-S", folder, "-B", folder / "build", "-DCMAKE_BUILD_TYPE=Debug",
         "-DCMAKE_CXX_FLAGS=-DGSUT_FEWER_TARGETS", *defines)  # fmt: skip
    call("cmake", "--build", folder / "build", "--target", "app", "--parallel", 2)
    return call(folder / "build/app")


@pytest.mark.slow
def test_core_is_built_by_fetch_content_and_found_where_it_is_installed(tmp_path):
    assert build_and_run(tmp_path / "fetched", FETCH) == "1 42 44"
    prefix = tmp_path / "prefix"
    for component in ("base", "cameras"):
        call("cmake", "--install", tmp_path / "fetched/build", "--component", component,
             "--prefix", prefix)  # fmt: skip
    found = "find_package(gsut REQUIRED COMPONENTS cameras)"
    assert build_and_run(tmp_path / "found", found, f"-DCMAKE_PREFIX_PATH={prefix}") == "1 42 44"
    with pytest.raises(AssertionError, match="installed without the component sfm"):
        wanted = found.replace("cameras", "sfm")
        build_and_run(tmp_path / "missing", wanted, f"-DCMAKE_PREFIX_PATH={prefix}")
