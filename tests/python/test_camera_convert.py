"""Tests gsut.camera_convert: one lens fitted by another, and its error by field angle."""

import numpy as np
import pytest

import tolerances as tol
from gsut import InputError, _core
from gsut.camera_convert import convert_camera, format_conversion
from gsut.cameras import Camera, load_camera
from gsut.cli import main


def example(model: str, index: int = 0) -> Camera:
    _, params, width, height = _core.camera_examples(model)[index]
    return Camera(model, params, width, height)


# Lenses that the other model holds exactly.
EXACT = [
    ("pinhole", "opencv4"),
    ("opencv4", "opencv5"),
    ("opencv5", "opencv8"),
    ("unified", "extended_unified"),
    ("extended_unified", "extended_unified"),
    ("kannala_brandt", "kannala_brandt"),
    ("fisheye624", "fisheye624"),
    ("division", "division"),
]


@pytest.mark.parametrize(("model", "other"), EXACT)
def test_convert_to_a_model_that_holds_the_lens_is_exact(model, other):
    conversion = convert_camera(example(model), other)
    assert conversion.camera.model == other
    assert conversion.worst < tol.CONVERT_EXACT
    assert sum(ring.points for ring in conversion.rings) > 500


def test_convert_real_fisheye_prints_errors_that_project_confirms():
    camera = example("kannala_brandt")
    conversion = convert_camera(camera, "double_sphere")
    assert 0.001 < conversion.rms < 0.5 < 10 * conversion.worst
    # The image's corner lies in the last ring.
    rays, _ = camera.unproject(np.array([[0.5, 0.5], [256.0, 256.0]]))
    pixels, _ = conversion.camera.project(rays)
    assert np.linalg.norm(pixels[0] - 0.5) <= conversion.rings[-1].worst * 1.001
    text = format_conversion(conversion)
    assert len(text.splitlines()) == 2 + len(conversion.rings)
    assert f"{conversion.worst:.3g}" in text


def test_convert_keeps_field_angle_and_size_and_leaves_out_what_is_beyond():
    camera = example("kannala_brandt").with_valid_field_angle(1.0)
    conversion = convert_camera(camera, "opencv8", max_angle=0.9)
    assert conversion.camera.valid_field_angle == 1.0
    assert (conversion.camera.width, conversion.camera.height) == (camera.width, camera.height)
    assert conversion.rings[-1].to_degrees <= np.degrees(0.9) + 1e-6
    assert conversion.worst < 0.5


def test_convert_command_writes_the_lens_and_prints_the_worst_error(tmp_path, capsys):
    lens, out = tmp_path / "lens.yaml", tmp_path / "out.cameramodel"
    example("opencv4").save(lens)
    assert main(["camera", "convert", str(lens), "opencv8", "-o", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "opencv4 -> opencv8" in printed and "worst (px)" in printed
    assert load_camera(out).model == "opencv8"
    assert main(["camera", "convert", str(lens), "nonsense"]) == 2
    assert "unknown camera model 'nonsense'" in capsys.readouterr().err


def test_convert_to_a_lens_that_cannot_be_fitted_raises():
    with pytest.raises(InputError, match="'equirectangular' cannot be fitted; lenses that can"):
        convert_camera(example("pinhole"), "equirectangular")
    with pytest.raises(InputError, match="does not take 9 parameters"):
        convert_camera(example("pinhole"), "opencv4", num_params=9)
