"""A panoramic scene trains end to end: across the seam as well as anywhere else."""

import numpy as np
import pytest

import gsut
import tolerances
from box_room import plan_walk, write_box_room

WIDTH, HEIGHT = 160, 80
STEPS = 260
SEAM_COLUMNS = 8  # on either side of the seam


@pytest.fixture(scope="module")
def panorama_data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("panorama") / "hall"
    camera = gsut.Camera("equirectangular", [], WIDTH, HEIGHT)
    return write_box_room(folder, camera, plan_walk(14), test=(1, 4, 8, 11))


def psnr(image, truth, chosen):
    return -10 * np.log10(np.mean((np.clip(image, 0, 1) - truth)[chosen] ** 2))


def test_panorama_trains_across_the_seam(panorama_data):
    scene = gsut.load_dataset(panorama_data)
    assert scene.cameras[0].model == "equirectangular"
    options = gsut.TrainOptions(steps=STEPS, max_gaussians=5000, sh_degree=1, seed=1)
    trained = gsut.train(scene, options, progress=False)
    at_seam, elsewhere, jumps = [], [], []
    columns = np.arange(WIDTH)
    near = (columns < SEAM_COLUMNS) | (columns >= WIDTH - SEAM_COLUMNS)
    for index in scene.test_indices:
        view = scene.views[index]
        image = gsut.render(trained.gaussians, scene.camera(index), view.camera_from_world).image
        truth = scene.image(index) / 255.0
        mask = scene.mask(index)
        at_seam.append(psnr(image, truth, mask & near))
        elsewhere.append(psnr(image, truth, mask & ~near))
        # The step across the seam, beside the step between its neighbours.
        across = np.abs(image[:, 0] - image[:, -1])[mask[:, 0]].mean()
        beside = np.abs(np.diff(image, axis=1))[:, near[1:]][mask[:, 0]].mean()
        jumps.append(across / beside)
    print(
        f"{trained.metrics['psnr']:.2f} dB; at the seam {np.mean(at_seam):.2f} dB, "
        f"elsewhere {np.mean(elsewhere):.2f} dB; step across it {np.mean(jumps):.2f}"
    )
    assert trained.metrics["psnr"] > tolerances.PANORAMA_PSNR
    assert np.mean(at_seam) > np.mean(elsewhere) - tolerances.PANORAMA_SEAM_DB
    assert np.mean(jumps) < tolerances.PANORAMA_SEAM_STEP


@pytest.mark.parametrize("width", [1, 2, 4, 8, 16, 32, 48, 64])
def test_tiny_panorama_renders_or_says_what_to_do(width):
    camera = gsut.Camera("equirectangular", [], width, max(1, width // 2))
    g = gsut.Gaussians(
        [[0.3, 0.2, -2.0]], [[1.0, 0, 0, 0]], np.log([[0.5] * 3]), [1.0], np.zeros((1, 1, 3))
    )
    expected = gsut.render(g, camera, np.eye(4), dtype="float64").alpha
    try:
        found = gsut.render(g, camera, np.eye(4)).alpha
    except gsut.InputError as error:
        assert width < 64
        assert "too small for its field of view" in str(error) and "float64" in str(error)
        return
    assert np.abs(found - expected).max() < tolerances.HARD_ALPHA
