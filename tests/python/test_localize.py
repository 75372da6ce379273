"""`gsut localize`: the pose of a photograph in the scene of a run, from the command line."""

import json

import numpy as np
import pytest

import gsut
import tolerances
from gsut import TrainOptions
from gsut.cli import main
from gsut.pictures import to_uint8, write_png
from gsut.run_folder import SCENE
from random_scenes import pinhole
from rendered_dataset import poses, truth, write_dataset


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A finished run whose Gaussians are the truth, and the truth in the dataset's coordinates."""
    folder = tmp_path_factory.mktemp("localize")
    rng = np.random.default_rng(20260821)
    scene = gsut.load_dataset(write_dataset(folder / "data", rng))
    options = TrainOptions(steps=20, max_gaussians=100, eval_every=20, checkpoint_every=20)
    gsut.train(scene, options, out=folder / "run", progress=False)
    g = truth(np.random.default_rng(20260821)).astype(np.float32)
    moved = gsut.Gaussians(
        (g.means - scene.world_offset).astype(np.float32),
        *(getattr(g, name) for name in ("quats", "log_scales", "opacity_logits", "sh")),
    )
    (folder / "run" / SCENE).unlink()
    gsut.save_ply(folder / "run" / SCENE, moved)
    return folder / "run", g


def photograph(path, g, pose, width=96):
    write_png(path, to_uint8(gsut.render(g, pinhole(width), pose).image))
    return path


def test_localize_finds_a_pose_between_the_training_views(run, tmp_path, capsys):
    folder, g = run
    pose = gsut.exp_pose([0.1, -0.05, 0.1, 0.03, -0.05, 0.02]) @ poses()[4]
    image = photograph(tmp_path / "photo.png", g, pose, 48)
    assert main(["localize", str(image), "--run", str(folder), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    center = -pose[:3, :3].T @ pose[:3, 3]
    error = np.linalg.norm(np.array(found["center"]) - center)
    print(f"{error:.2e} units, std {found['center_std']}")
    assert error < tolerances.LOCALIZED_UNITS
    np.testing.assert_allclose(found["camera_from_world"], pose, atol=tolerances.LOCALIZED_UNITS)
    assert np.linalg.eigvalsh(found["covariance"]).min() > 0
    assert main(["localize", str(image), "--run", str(folder)]) == 0
    assert "centre:" in capsys.readouterr().out


def test_localize_shrinks_a_larger_photograph(run, tmp_path, capsys):
    folder, g = run
    image = photograph(tmp_path / "large.png", g, poses()[3], 144)
    assert main(["localize", str(image), "--run", str(folder), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(
        found["camera_from_world"], poses()[3], atol=tolerances.LOCALIZED_SHRUNK_UNITS
    )


def test_localize_refuses_other_shapes_and_masks(run, tmp_path, capsys):
    folder, g = run
    image = tmp_path / "wide.png"
    write_png(image, np.zeros((40, 90, 3), np.uint8))
    assert main(["localize", str(image), "--run", str(folder)]) == 2
    assert "90 x 40" in capsys.readouterr().err
    photo = photograph(tmp_path / "photo.png", g, poses()[1], 48)
    assert main(["localize", str(photo), "--run", str(folder), "--mask", str(image)]) == 2
    assert "a mask has its image's size" in capsys.readouterr().err
