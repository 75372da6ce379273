"""Tests .cameramodel files of CAHVORE and the other configured lenses, against mrcal itself."""

import numpy as np
import pytest

import calib_fakes  # noqa: F401  # puts calib/ on the path
import tolerances as tol
from calib.solve.mrcal_process import ask, has_mrcal
from gsut import CalibrationError
from gsut.lens import Camera, load_camera, save_camera, spread_pixels
from lens_cases import examples, polar_grid

# As mrcal 2.2 writes it.
CAHVORE = """{
    'lensmodel':  'LENSMODEL_CAHVORE_linearity=0.37',

    # intrinsics are fx,fy,cx,cy,distortion0,distortion1,....
    'intrinsics': [ 330, 329, 320, 241.5, 0.011, -0.007, 0.0004, -0.012, 0.003, 0.004, -0.002, 0.0005,],

    # extrinsics are rt_fromref
    'extrinsics': [ 0, 0.1, 0.2, 0.3, 0.4, 0.5,],

    'imagersize': [ 640, 480,],


}
"""  # noqa: E501
PARAMS = [330, 329, 320.5, 242, 0.011, -0.007, 0.0004, -0.012, 0.003, 0.004, -0.002, 0.0005, 0.37]


def test_cahvore_file_of_mrcal_is_read(tmp_path):
    path = tmp_path / "lens.cameramodel"
    path.write_text(CAHVORE)
    camera = load_camera(path)
    assert camera == Camera("cahvore", PARAMS, 640, 480)
    np.testing.assert_array_equal(camera.extrinsics, [0, 0.1, 0.2, 0.3, 0.4, 0.5])


def test_copied_file_keeps_what_its_uncertainty_needs_and_a_changed_lens_drops_it(tmp_path):
    path, copy = tmp_path / "lens.cameramodel", tmp_path / "copy.cameramodel"
    solved = "    'icam_intrinsics': 1,\n    'optimization_inputs': b'UEsDB+/=',\n"
    path.write_text(CAHVORE.replace("\n\n}", f"\n{solved}}}"))
    camera = load_camera(path)
    save_camera(camera, copy)
    assert solved in copy.read_text() and load_camera(copy) == camera
    save_camera(camera.resize(320, 240), copy)
    assert "optimization_inputs" not in copy.read_text()


def test_cahvore_writes_every_digit_of_its_linearity(tmp_path):
    for linearity in (0.375, -0.1, 1.0, 0.0, 1 / 3):
        camera = Camera("cahvore", [*PARAMS[:-1], linearity], 640, 480)
        path = tmp_path / "lens.cameramodel"
        save_camera(camera, path)
        assert load_camera(path).params[-1] == linearity


@pytest.mark.parametrize(
    "name", ["CAHVORE", "CAHVORE_linearity=", "CAHVORE_linearity=0.3_x=1", "CAHVORE_order=3"]
)
def test_cahvore_name_without_its_linearity_is_refused(tmp_path, name):
    path = tmp_path / "lens.cameramodel"
    path.write_text(CAHVORE.replace("CAHVORE_linearity=0.37", name))
    with pytest.raises(CalibrationError, match=r"line 2, key 'lensmodel': .*LENSMODEL_CAHVORE"):
        load_camera(path)


needs_mrcal = pytest.mark.skipif(
    not has_mrcal(), reason="mrcal is not installed: apt-get install mrcal python3-mrcal"
)


@needs_mrcal
def test_real_files_and_their_copies_project_in_mrcal_as_in_gsut(shared, tmp_path):
    files = sorted((shared / "data" / "lenses" / "mrcal").glob("*.cameramodel"))
    for path in files:
        camera, copy = load_camera(path), tmp_path / path.name
        pixels = spread_pixels(camera.width, camera.height).reshape(-1, 2)
        rays, valid = camera.unproject(pixels)
        found = camera.project(rays[valid])[0]
        save_camera(camera, copy)
        for text in (path.read_text(), copy.read_text()):
            question = {"do": "project", "model": text, "points": rays[valid].tolist()}
            expected = np.array(ask(question)["pixels"]) + 0.5
            assert np.abs(found - expected).max() < tol.LENS_MRCAL_PIXELS, path
        again = load_camera(copy)
        assert again == camera
        np.testing.assert_array_equal(again.extrinsics, camera.extrinsics)
        assert valid.mean() > 0.5
    assert len(files) >= 6


@needs_mrcal
def test_written_lenses_project_in_mrcal_as_in_gsut(tmp_path):
    lenses = examples("cahvore", "cahvor", "splined_stereographic", "opencv12", "latlon")
    checked = 0
    for camera in lenses:
        path = tmp_path / "lens.cameramodel"
        save_camera(camera, path)
        # Distance 1: mrcal ignores the distance of a point before a cahvore lens.
        points = polar_grid(min(0.9 * camera.max_angle, 1.4), 12, 16)
        pixels, valid = camera.project(points)
        question = {"do": "project", "model": path.read_text(), "points": points.tolist()}
        expected = np.array(ask(question)["pixels"]) + 0.5
        assert valid.sum() > 100
        error = np.abs(pixels[valid] - expected[valid]).max()
        assert error < tol.LENS_ORACLE_PIXELS, camera
        checked += 1
    assert checked == len(lenses) == 9
