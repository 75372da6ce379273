"""Tests gsut.camera_convert: one lens fitted by another, and its error by field angle."""

import numpy as np
import pytest

import tolerances as tol
from gsut import InputError
from gsut.cli import main
from gsut.lens import Camera, camera_models, load_camera, save_camera
from gsut.lens.convert import convert_camera
from lens_cases import examples, traits


def example(model: str, index: int = 0) -> Camera:
    return examples(model)[index]


# Beside every model, which holds its own lenses: other models that hold a lens exactly.
EXACT = [
    ("pinhole", "opencv4"),
    ("opencv4", "opencv5"),
    ("opencv5", "opencv8"),
    ("opencv5", "brown_conrady"),
    ("unified", "extended_unified"),
    ("kannala_brandt", "brown_fisheye"),
    ("kannala_brandt", "thin_prism_fisheye"),
]


def is_exact(camera: Camera, other: str) -> bool:
    """Whether the model holds this lens up to rounding."""
    angle = 0.9 * min(camera.max_angle, 1.5)
    distance = 2.0 if camera.is_parallel else None
    conversion = convert_camera(camera, other, angle, len(camera.params), distance=distance)
    print(camera.model, other, conversion.rms, conversion.worst)
    assert conversion.camera.model == other
    assert sum(ring.points for ring in conversion.rings) > 100
    return conversion.worst < tol.CONVERT_EXACT


@pytest.mark.parametrize("model", camera_models())
def test_convert_to_its_own_model_is_exact(model):
    if traits(model).has_table:  # nearest by its control points: see below
        return
    assert is_exact(example(model), model)


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
    text = conversion.format_rings()
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
    save_camera(example("opencv4"), lens)
    assert main(["camera", "convert", str(lens), "opencv8", "-o", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "opencv4 -> opencv8" in printed and "worst (px)" in printed
    assert load_camera(out).model == "opencv8"
    assert main(["camera", "convert", str(lens), "opencv4", "-o", str(lens)]) == 2
    assert f"{lens} exists; give another name with -o" in capsys.readouterr().err
    assert main(["camera", "convert", str(lens), "nonsense"]) == 2
    assert "unknown camera model 'nonsense'" in capsys.readouterr().err


@pytest.mark.parametrize("model", camera_models())
def test_convert_fits_every_model_to_a_fisheye_and_prints_its_error_by_field_angle(model):
    camera = example("kannala_brandt")
    conversion = convert_camera(
        camera, model, 0.9, distance=2.0 if traits(model).is_parallel else None
    )
    print(model, conversion.rms, conversion.worst)
    assert conversion.camera.model == model
    assert conversion.worst < tol.CONVERT_TARGETS.get(model, tol.CONVERT_OTHERS)
    assert np.all(np.diff([ring.to_degrees for ring in conversion.rings]) > 0)
    assert max(ring.worst for ring in conversion.rings if ring.points) == conversion.worst
    assert sum(ring.points for ring in conversion.rings) > 400
    # Its inverse is a lens, too.
    rays, valid = conversion.camera.unproject(np.array([[256.0, 256.0], [300.0, 280.0]]))
    assert valid.all() and np.isfinite(rays).all()


def test_convert_to_splines_gains_with_every_control_point_and_keeps_the_whole_image():
    camera = example("kannala_brandt")
    worst = {}
    for columns in (8, 16):
        conversion = convert_camera(camera, "splined_stereographic", columns=columns)
        assert list(conversion.camera.params[:2]) == [3, columns]
        worst[columns] = conversion.worst
    print(worst)
    assert worst[16] < worst[8] / 16
    assert worst[16] < tol.CONVERT_SPLINE
    with pytest.raises(InputError, match="at least 4 control points across, found 3"):
        convert_camera(camera, "splined_stereographic", columns=3)
    with pytest.raises(InputError, match="at most 168 degrees from the axis"):
        convert_camera(example("equirectangular"), "splined_stereographic")


def test_convert_lenses_whose_rays_do_not_meet_at_a_distance():
    telecentric, rover = example("orthographic"), example("cahvore")
    assert convert_camera(telecentric, "orthographic", distance=3.0).worst < tol.CONVERT_EXACT
    # Seen at one distance only, a telecentric lens is a pinhole.
    assert convert_camera(telecentric, "pinhole", distance=3.0).worst < tol.CONVERT_EXACT
    for model in ("pinhole", "orthographic"):
        source = telecentric if model == "pinhole" else rover
        with pytest.raises(InputError, match="agree at one distance only"):
            convert_camera(source, model)
    # Far away it has one centre and the pupil is nobody's business; near it is found.
    far = convert_camera(rover, "cahvore", 0.7)
    assert far.worst < tol.CONVERT_EXACT and np.all(far.camera.params[9:12] == 0)
    near = convert_camera(rover, "cahvore", 0.7, distance=0.2)
    assert near.worst < tol.CONVERT_PUPIL
    np.testing.assert_allclose(near.camera.params[9], rover.params[9], rtol=0.2)
    assert convert_camera(rover, "splined_stereographic", 0.7).worst < tol.CONVERT_SPLINE


def test_convert_f_theta_keeps_the_polynomials_of_one():
    camera = example("ftheta")
    conversion = convert_camera(camera, "ftheta")
    assert conversion.worst < tol.CONVERT_EXACT
    # Pixel to angle is the inverse of angle to pixel, near enough to start from.
    params = conversion.camera.params
    radius = np.polynomial.polynomial.polyval(0.8, params[9:15])
    assert np.polynomial.polynomial.polyval(radius, params[3:9]) == pytest.approx(0.8, abs=0.01)


def test_convert_to_what_is_no_lens_raises():
    with pytest.raises(InputError, match="does not take 9 parameters"):
        convert_camera(example("pinhole"), "opencv4", num_params=9)
    with pytest.raises(InputError, match="more than 64 fit nothing but noise"):
        convert_camera(example("pinhole"), "kannala_brandt", num_params=1_000_000)
    with pytest.raises(InputError, match="distance must be a positive number, found -1"):
        convert_camera(example("pinhole"), "orthographic", distance=-1.0)
