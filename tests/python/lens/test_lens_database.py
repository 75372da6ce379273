"""The database of calibrated lenses: names found, junk doubted, sizes fitted, shipped as packed."""

import gzip
import json
import math
import runpy
from pathlib import Path

import numpy as np
import pytest

import gsut
import tolerances as tol
from gsut.cli import main
from gsut.lens import find_lens, find_lenses, is_lens_name, load_lens, measure_field_of_view
from gsut.lens.database import LensProfile, load_profiles
from gsut.lens.plausible import MOST_STRETCH
from gsut.sfm.photographs.listing import find_photographs

ROOT = Path(__file__).resolve().parents[3]
PROFILES = ROOT.parent / "shared/data/lens_database/profiles.jsonl.gz"


def test_every_profile_makes_a_camera_and_most_are_not_doubted():
    profiles = load_profiles()
    assert len(profiles) > 9700
    sound = [profile for profile in profiles if not profile.doubts]
    assert 0.8 < len(sound) / len(profiles) < 0.9
    assert all(profile.fov_degrees is not None for profile in sound)


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ("GoPro HERO9 Black, Max Wide", "GoPro HERO9 Black, Max Wide, NO-EIS"),
        ("gopro hero 5 black WIDE no-eis", "GoPro HERO5 Black, Wide, NO-EIS"),
        ("hero9 linear", "GoPro HERO9 Black, Linear"),
    ],
)
def test_words_find_the_lens_whatever_their_case_and_spaces(words, name):
    assert find_lens(words).name == name
    assert not find_lens(words).doubts


def test_an_outlier_with_small_residuals_is_not_the_first():
    found = find_lenses("GoPro HERO9 Black, Max Wide")
    smallest = min(found, key=lambda profile: profile.rms)
    assert smallest.fov_degrees < 75  # a calibration that contradicts the others
    assert 100 < found[0].fov_degrees < 120


def test_the_pictures_size_decides_between_settings():
    assert find_lens("hero9 wide", (5312, 3984)).height == 3984
    assert find_lens("hero9 wide", (1920, 1080)).height == 2160


@pytest.mark.parametrize("word", ["nope", "roblack"])
def test_words_across_the_gaps_of_a_name_find_nothing(word):
    with pytest.raises(gsut.InputError, match=f"none has '{word}'"):
        load_lens(word)


def test_unknown_words_are_named():
    with pytest.raises(gsut.InputError, match="none has 'hero99'"):
        find_lens("GoPro HERO99")
    with pytest.raises(gsut.InputError, match="give words"):
        find_lenses(" , ")


def _profile(**changes):
    values = {
        "brand": "B", "model": "M", "lens": "", "setting": "", "note": "", "digital_lens": "",
        "official": False, "width": 1000, "height": 750, "fps": 30.0,
        "params": (500.0, 501.0, 510.0, 370.0, 0.01, 0.0, 0.0, 0.0), "rms": 0.5, "images": 15,
        "radial_limit": None, "readout_ms": -16.0, "sizes": ((2000, 1000),),
    }  # fmt: skip
    return LensProfile(**(values | changes))


@pytest.mark.parametrize(
    ("changes", "doubt"),
    [
        ({"rms": 4.2}, "residuals of 4.2 px"),
        ({"digital_lens": "gopro_superview"}, "warped in the camera"),
        ({"images": 2}, "made from 2 images"),
        ({"params": (500.0, 501.0, 700.0, 370.0, 0, 0, 0, 0)}, "centre off by 20 %"),
        ({"params": (500.0, 600.0, 510.0, 370.0, 0, 0, 0, 0)}, "pixels not square"),
        ({"params": (500.0, 501.0, 510.0, 370.0, -0.5, 0, 0, 0)}, "ends inside the picture"),
    ],
)
def test_junk_is_doubted(changes, doubt):
    assert _profile().doubts == ()
    assert any(text.startswith(doubt) for text in _profile(**changes).doubts)


def test_camera_is_scaled_cropped_and_turned_with_the_picture():
    profile = _profile()
    half = profile.make_camera(500, 375)
    assert half == profile.make_camera().resize(500, 375)
    cropped = profile.make_camera(2000, 1126)  # 16:9 of the same sensor: rows cut at top and bottom
    np.testing.assert_allclose(cropped.params[:4], [1000, 1002, 1020, 553])
    upright = profile.make_camera(750, 1000)
    np.testing.assert_allclose(upright.params[:4], [501, 500, 375, 500])
    assert (upright.width, upright.height) == (750, 1000)


def test_sizes_and_field_of_view_of_a_profile():
    profile = _profile()
    assert [profile.rate_size(*size) for size in ((2000, 1000), (400, 300), (400, 400))] == [
        0,
        1,
        2,
    ]
    assert profile.rate_size(1000, 2000) == 0  # held upright
    lens = gsut.Camera("pinhole", [50.0, 50.0, 50.0, 50.0], 100, 100)
    assert measure_field_of_view(lens) == pytest.approx(90)


def test_a_missing_lens_file_is_no_name(tmp_path):
    assert not any(map(is_lens_name, ("lens.yaml", "folder/hero9", "../hero9", str(tmp_path))))
    assert is_lens_name("GoPro HERO9 Black, Max Wide")
    with_slash = next(p.name for p in load_profiles() if "/" in p.name)
    assert is_lens_name(with_slash)
    assert find_lens(with_slash).name == with_slash
    with pytest.raises(FileNotFoundError):
        load_lens(tmp_path / "lens.yaml")
    camera = load_lens("hero9 linear", (640, 480))
    assert (camera.width, camera.height) == (640, 480)


def test_camera_find_prints_a_table_and_json(capsys):
    assert main(["camera", "find", "hero9", "max wide"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert 3 <= len(lines) <= 22
    assert "GoPro HERO9 Black, Max Wide" in lines[1]
    assert " lenses; " in lines[-1] and "--camera 'hero9 max wide'" in lines[-1]
    assert main(["camera", "find", "hero9", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert rows[0]["fov_degrees"] > 100 and len(rows[0]["params"]) == 8
    assert main(["camera", "find", "hero99"]) == 2
    assert "none has 'hero99'" in capsys.readouterr().err


def test_photographs_get_the_named_lens_as_candidate(tmp_path):
    for name in ("a.png", "b.png"):
        gsut.write_png(tmp_path / name, np.zeros((24, 32, 3), np.uint8))
    found = find_photographs(tmp_path, "GoPro HERO5 Black, Wide")
    assert not found.are_lenses_known
    assert found.profile.model.startswith("HERO5")
    assert [(c.width, c.height) for c in found.candidates] == [(32, 24)]


@pytest.mark.skipif(not PROFILES.is_file(), reason="needs ../shared")
def test_shipped_file_is_what_the_packer_makes():
    pack = runpy.run_path(str(ROOT / ".ci/pack_lens_profiles.py"))["pack"]
    with gzip.open(PROFILES, "rt", encoding="utf-8") as lines:
        rows = [json.loads(line) for line in lines]
    shipped = ROOT / "python/gsut/lens/profiles.json.xz"
    stretches = [row["fy"] * row["stretch"][0] / (row["fx"] * row["stretch"][1])
                 if min(row["fx"], row["fy"]) > 0 else 0 for row in rows]  # fmt: skip
    sound = [
        row
        for row, stretch in zip(rows, stretches, strict=True)
        if 1 / MOST_STRETCH <= stretch <= MOST_STRETCH
    ]
    profiles = load_profiles()
    assert len(profiles) == len(sound)
    for row, profile in list(zip(sound, profiles, strict=True))[::97]:
        assert profile.model == row["model"]
        focal = row["fx"] / row["stretch"][0]
        assert math.isclose(profile.params[0], focal, rel_tol=tol.LENS_DATABASE_DIGITS)
    assert shipped.stat().st_size < 400_000
    assert pack(rows[:2]) == pack(iter(rows[:2]))
