"""Weights of residuals by the lens' uncertainty: read from lens files, applied in training."""

import json

import numpy as np
import pytest

import gsut
import tolerances
from gsut.lens.calibration_weights import CalibrationWeights
from gsut.lens.uncertainty import SIGMA_KEY, load_uncertainty, save_uncertainty, spread_pixels
from gsut.run import TrainOptions
from gsut.training.loop import TrainingLoop
from rendered_dataset import write_dataset

SIZE = 48


@pytest.fixture(params=["lens.cameramodel", "lens.yaml"])
def lens(request, tmp_path):
    """A lens file whose uncertainty is its pixels' column plus 0.1 times their row."""
    path = tmp_path / request.param
    gsut.save_camera(gsut.Camera("opencv4", [50, 50, 24, 24, 0, 0, 0, 0], SIZE, SIZE), path)
    pixels = spread_pixels(SIZE, SIZE)
    save_uncertainty(path, pixels[..., 0] + 0.1 * pixels[..., 1])
    return path


def test_uncertainty_stored_and_read_is_that_of_each_pixel(lens):
    found = load_uncertainty(lens)
    y, x = np.mgrid[0:SIZE, 0:SIZE] + 0.5
    sigma = found.resample(SIZE, SIZE)
    assert np.abs(sigma - (x + 0.1 * y)).max() < tolerances.UNCERTAINTY_STORED_PX
    assert gsut.load_camera(lens).model == "opencv4"  # still a lens file


def test_uncertainty_at_half_the_size_is_in_its_pixels(lens):
    y, x = np.mgrid[0 : SIZE // 2, 0 : SIZE // 2] * 2 + 1.0  # in pixels of the full image
    half = load_uncertainty(lens).resample(SIZE // 2, SIZE // 2)
    assert np.abs(half - (x + 0.1 * y) / 2).max() < tolerances.UNCERTAINTY_STORED_PX


def test_uncertainty_unknown_places_take_the_nearest(lens):
    sigma = np.full(spread_pixels(SIZE, SIZE).shape[:2], 2.0)
    sigma[0, 0] = np.nan
    save_uncertainty(lens.with_suffix(".yaml"), sigma)
    gsut.save_camera(gsut.load_camera(lens), lens.with_suffix(".yaml"))
    assert np.all(load_uncertainty(lens.with_suffix(".yaml")).resample(SIZE, SIZE) == 2.0)


def test_weights_one_pixel_of_uncertainty_counts_half(lens):
    sigma = np.zeros(spread_pixels(SIZE, SIZE).shape[:2])
    sigma[:, -1] = 1.0
    save_again(lens, sigma)
    gradient = np.ones((SIZE, SIZE, 3), np.float32)
    CalibrationWeights(lens, [gsut.load_camera(lens)]).apply(gradient)
    assert np.all(gradient[:, 0] == 1.0)
    assert np.all(gradient[:, -1] == 0.5)


def test_training_gradient_is_that_of_certain_pixels_only(rng, tmp_path, lens):
    scene = gsut.load_dataset(write_dataset(tmp_path / "data", rng))
    largest = {}
    for name, scale in (("certain", 0.0), ("uncertain", 1e9)):
        save_again(lens, np.full(spread_pixels(SIZE, SIZE).shape[:2], scale))
        options = TrainOptions(steps=3, calibration_weights=str(lens), max_gaussians=100)
        loop = TrainingLoop(scene, options.resolve())
        loop.advance()
        largest[name] = np.abs(loop._gradients.means).max()
    plain = TrainingLoop(scene, TrainOptions(steps=3, max_gaussians=100).resolve())
    plain.advance()
    assert largest["certain"] == np.abs(plain._gradients.means).max()
    assert largest["uncertain"] < 1e-12 * largest["certain"]


def save_again(lens, sigma):
    """The lens without its old map, with this one."""
    gsut.save_camera(gsut.load_camera(lens), lens)
    save_uncertainty(lens, sigma)


def test_weights_bad_input_is_one_sentence(tmp_path, lens):
    camera = gsut.load_camera(lens)
    with pytest.raises(gsut.InputError, match=r"the data has 2 lenses"):
        CalibrationWeights(lens, [camera, camera])
    with pytest.raises(gsut.InputError, match=r"images of 48 x 48 pixels, the images are 48 x 96"):
        CalibrationWeights(lens, [camera.resize(48, 96)])
    for name in ("plain.cameramodel", "plain.yaml"):
        gsut.save_camera(camera, tmp_path / name)
        with pytest.raises(gsut.InputError, match=r"plain\..* has no uncertainty"):
            CalibrationWeights(tmp_path / name, [camera])
    side = tmp_path / "plain.uncertainty.json"
    for text, sentence in (
        ("{", "not JSON"),
        (json.dumps({SIGMA_KEY: [[1, 2], [3]]}), "rows of numbers of one length"),
        (json.dumps({SIGMA_KEY: [[-1, -1], [-1, -1]]}), "unknown at every pixel"),
    ):
        side.write_text(text)
        with pytest.raises(gsut.InputError, match=rf"plain\.uncertainty\.json.*{sentence}"):
            CalibrationWeights(tmp_path / "plain.yaml", [camera])
