"""The C++ core in somebody else's CMake project: by FetchContent and from an installed prefix."""

import re
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest

import gsut
from gsut import formats
from random_scenes import gaussians_in_view, rng_of
from tolerances.cmake_package import GREY_LEVEL, PRINTED_PIXEL

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build"  # of ./run setup
INSTALLED = ("base", "geometry", "cameras", "gaussians", "projection", "raster", "loss", "optimize",
             "surface", "formats")  # fmt: skip
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

pytestmark = [
    pytest.mark.slow,  # compiles examples, and each header alone
    pytest.mark.skipif(not shutil.which("cmake"), reason="needs cmake"),
]


def call(*command: object, stdin: str = "") -> str:
    words = [str(word) for word in command]
    done = subprocess.run(words, input=stdin, capture_output=True, text=True)
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


def install(prefix: Path, *components: str) -> Path:
    if not (BUILD / "gsutConfig.cmake").exists():
        pytest.skip("needs a build with tests")
    for component in components:
        call("cmake", "--install", BUILD, "--component", component, "--prefix", prefix)
    return prefix


@pytest.fixture(scope="module")
def prefix(tmp_path_factory):
    """Every library installed, but for sfm."""
    return install(tmp_path_factory.mktemp("prefix"), *INSTALLED)


def find_components(prefix: Path, *names: str) -> tuple[str, str]:
    """Returns the call of find_package and the argument that says where to look."""
    found = f"find_package(gsut 0.1 REQUIRED COMPONENTS {' '.join(names)})"
    return found, f"-DCMAKE_PREFIX_PATH={prefix}"


def test_core_is_found_where_it_is_installed(tmp_path, prefix):
    found, there = find_components(prefix, "cameras")
    assert build_and_run(tmp_path / "found", found, "cameras", CAMERAS, there) == "1 42 44"


def test_build_of_the_module_installs_libraries_where_asked(tmp_path):
    call("cmake", "-S", ROOT, "-B", tmp_path, "-DSKBUILD=2", "-DGSUT_BUILD_PYTHON=OFF",
         "-DGSUT_INSTALL=ON")  # fmt: skip
    with pytest.raises(AssertionError, match=r"cannot find[\s\S]*libgsut_base\.a"):  # not built
        call("cmake", "--install", tmp_path, "--prefix", tmp_path / "prefix")


@pytest.mark.parametrize(
    ("component", "message"),
    [
        ("sfm", "installed without the component sfm"),
        ("render", r"no component render;[\s\S]*raster"),
    ],
)
def test_component_that_is_not_there_is_named(tmp_path, prefix, component, message):
    found, there = find_components(prefix, component)
    with pytest.raises(AssertionError, match=message):
        build_and_run(tmp_path / "missing", found, component, CAMERAS, there)


@pytest.fixture(scope="module")
def examples(tmp_path_factory):
    """The folder of the built programs of docs/examples/cpp."""
    if not (BUILD / "libgsut_sfm.a").exists():
        pytest.skip("needs a build with structure from motion")
    prefix = install(tmp_path_factory.mktemp("whole"), *INSTALLED, "sfm")
    folder = tmp_path_factory.mktemp("examples")
    call("cmake", "-S", ROOT / "docs/examples/cpp", "-B", folder, f"-DCMAKE_PREFIX_PATH={prefix}",
         "-DCMAKE_CXX_FLAGS=-O0 -Wall -Wextra -Werror")  # fmt: skip
    call("cmake", "--build", folder, "--parallel", 2)
    return folder


def test_example_projects_points_as_the_module_does(tmp_path, examples):
    camera = gsut.Camera("opencv5", [300, 310, 320, 240, 0.1, -0.05, 1e-3, 2e-3, 0.01], 640, 480)
    lens = tmp_path / "lens.cameramodel"
    gsut.save_camera(camera, lens)
    points = np.array([[0.1, -0.2, 1.0], [0.5, 0.3, 2.0]])
    said = call(examples / "project_points", lens, stdin=" ".join(map(str, points.ravel())))
    pixels = [[float(x) for x in row.split()[:2]] for row in said.splitlines()[1:]]
    np.testing.assert_allclose(pixels, camera.project(points)[0], atol=PRINTED_PIXEL)


def test_example_renders_a_file_as_the_module_does(tmp_path, examples):
    camera = gsut.Camera("stereographic", [40, 40, 32, 24], 64, 48)
    gaussians = gaussians_in_view(rng_of("example"), camera, np.eye(4), 60)
    lens, scene, picture = (tmp_path / name for name in ("lens.cameramodel", "a.ply", "a.png"))
    gsut.save_camera(camera, lens)
    formats.save_ply(scene, gaussians)
    call(examples / "render_ply", scene, lens, picture)
    expected = gsut.render(formats.load_ply(scene), camera, np.eye(4)).image
    seen = cv2.imread(str(picture))[..., ::-1] / 255.0
    np.testing.assert_allclose(seen, np.clip(expected, 0, 1), atol=GREY_LEVEL)


def test_example_finds_a_pose_by_its_gradient(examples):
    first, last = re.findall(r"by ([0-9.]+)", call(examples / "pose_gradient"))
    assert float(last) < float(first) / 100


def test_example_adjusts_a_rolling_shutter(examples):
    words = re.search(r"off by ([0-9.]+) -> ([0-9.]+)", call(examples / "rolling_bundle"))
    assert float(words[2]) < float(words[1]) / 5


def test_promised_headers_compile_alone(prefix, tmp_path):
    headers = re.findall(r"^\| `(gsut/.*?\.h)`", (ROOT / "docs/cpp.md").read_text(), re.MULTILINE)
    assert len(headers) == 20
    sources = [tmp_path / f"{i}.cpp" for i in range(len(headers))]
    for source, header in zip(sources, headers, strict=True):
        source.write_text(f"#include <{header}>\n")
    folders = [f"-I{prefix}/include", f"-I{ROOT}/cpp", "-isystem", "/usr/include/eigen3"]
    flags = ["-std=c++20", "-fsyntax-only", "-Wall", "-Wextra", "-Werror", *folders]
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda source: call("c++", *flags, source), sources))
