"""Photographs that are cut out: nothing is where alpha is 0."""

import cv2
import numpy as np
import pytest

import gsut
import tolerances
from gsut.training.photograph import CutOut
from rendered_dataset import truth, write_dataset

OPTIONS = gsut.TrainOptions(steps=150, max_gaussians=1500, sh_degree=0, seed=0)


@pytest.fixture
def cut_out(tmp_path):
    """A dataset of blobs whose images are transparent where there are none, and alpha itself."""
    blobs = truth(np.random.default_rng(0))
    path = write_dataset(tmp_path / "blobs", np.random.default_rng(0))
    scene = gsut.load_dataset(path)
    alphas = {}
    for number in range(len(scene.views)):
        file = scene.views[number].image_path
        pose = scene.views[number].camera_from_world
        shown = gsut.render(blobs, scene.camera(number), pose)
        alphas[number] = shown.alpha
        opaque = 255 * (shown.alpha > 0.5)  # the colours are those of the blobs alone
        colors = 255 * np.clip(shown.image / np.maximum(shown.alpha, 1e-6)[..., None], 0, 1)
        cv2.imwrite(str(file), np.dstack([colors[..., ::-1], opaque]).round().astype(np.uint8))
    return gsut.load_dataset(path), alphas


def measure_alpha_outside(scene, alphas, gaussians):
    """Mean alpha in the test views' pixels that meet nothing."""
    outside = []
    for index in scene.test_indices:
        pose = scene.views[index].camera_from_world
        alpha = gsut.render(gaussians, scene.camera(index), pose).alpha
        outside.append(alpha[alphas[index] < 1e-3])
    return float(np.concatenate(outside).mean())


def test_training_of_cut_out_photographs_leaves_nothing_beside_the_object(cut_out, monkeypatch):
    scene, alphas = cut_out
    result = gsut.train(scene, OPTIONS, progress=False)
    monkeypatch.setattr(CutOut, "find", classmethod(lambda cls, scene: None))
    ignored = gsut.train(scene, OPTIONS, progress=False)
    outside = measure_alpha_outside(scene, alphas, result.gaussians)
    before = measure_alpha_outside(scene, alphas, ignored.gaussians)
    print(outside, before, result.metrics["psnr"], ignored.metrics["psnr"])
    assert outside < tolerances.CUT_OUT_ALPHA
    assert outside < before / 4
    assert result.metrics["psnr"] > ignored.metrics["psnr"] - tolerances.CUT_OUT_PSNR


def test_circle_that_is_transparent_in_all_photographs_is_no_cut_out(cut_out):
    scene, _ = cut_out
    for number in range(len(scene.views)):
        file = str(scene.views[number].image_path)
        image = cv2.imread(file, cv2.IMREAD_UNCHANGED)
        height, width = image.shape[:2]
        y, x = np.mgrid[:height, :width]
        image[..., 3] = 255 * (np.hypot(x - width / 2, y - height / 2) < 0.35 * width)
        cv2.imwrite(file, image)
    assert CutOut.find(gsut.load_dataset(scene.path)) is None
