"""Four 220-degree fisheyes on a body: from OCamCalib's files to poses, training and depth."""

import json

import numpy as np
import pytest

import gsut
import tolerances
from box_room import plan_walk, write_box_rig
from gsut.cli import main
from gsut.sfm import compare_datasets

FRAMES, SIZE, PATH_SHARE = 4, 128, 0.1
# Name, then a0, cx and cy in image sizes, and c, d, e: pixels are not square and not upright, by as
# much as OCamCalib finds of real cameras. 220-degree circles.
AROUND = (
    ("front", 0.2445, 0.5012, 0.4983, 1.0024, 4.1e-4, -9.0e-4),
    ("right", 0.2461, 0.4978, 0.5031, 0.9981, -7.2e-4, 3.5e-4),
    ("back", 0.2452, 0.5025, 0.5014, 1.0037, 1.1e-3, 6.0e-4),
    ("left", 0.2438, 0.4969, 0.4976, 0.9969, -3.0e-4, -1.2e-3),
)
POLYNOMIAL = (-0.3333, 0.0040, -0.0318)  # a2 a0, a3 a0^2 and a4 a0^3


def make_rig():
    """Four cameras 12 cm from the body's middle, mounted up to 1 cm and 0.03 radians off."""
    rng = np.random.default_rng(4)
    rig, front = {}, None
    for number, (name, focal, cx, cy, *affine) in enumerate(AROUND):
        a0 = focal * SIZE
        poly = [value / a0**power for power, value in enumerate(POLYNOMIAL, start=1)]
        lens = gsut.Camera(
            "ocam", [cx * SIZE, cy * SIZE, *affine, a0, *poly], SIZE, SIZE,
            valid_field_angle=np.radians(110.0),
        )  # fmt: skip
        about = gsut.exp_pose([0.0, 0.0, 0.0, 0.0, -number * np.pi / 2, 0.0])  # y points down
        about[2, 3] = -0.12
        pose = gsut.exp_pose(rng.uniform(-1, 1, 6) * np.repeat([0.01, 0.03], 3)) @ about
        front = np.linalg.inv(pose) if front is None else front
        rig[name] = (lens, pose @ front, f"{name}/{name}.lens.json")
    return rig


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    """What the four cameras see on a walk, with exact depth."""
    folder = tmp_path_factory.mktemp("around") / "hall"
    return write_box_rig(folder, make_rig(), plan_walk(FRAMES, PATH_SHARE))


@pytest.fixture(scope="module")
def poses(truth):
    """What `gsut poses --rig` makes of the photographs, the rig's file and four lens files."""
    out = truth.parent / "poses"
    words = ["poses", str(truth / "images"), "--rig", str(truth / "rig.json"), "--quiet"]
    assert main([*words, "-o", str(out)]) == 0
    return out


def test_poses_of_all_images_come_out_in_metres(truth, poses):
    errors = compare_datasets(truth, poses)
    assert errors.images == 4 * FRAMES
    print(errors.scale_error_percent, errors.metric_ate, np.median(errors.rotation_degrees))
    assert abs(errors.scale_error_percent) < tolerances.AROUND_SCALE_PERCENT
    assert errors.metric_ate < tolerances.AROUND_METRES
    lenses = {gsut.load_dataset(poses).camera(row).model for row in range(4 * FRAMES)}
    assert lenses == {"ocam"}


@pytest.mark.slow
def test_training_on_them_tells_depth_beyond_ninety_degrees(truth, poses, tmp_path, capsys):
    run = tmp_path / "run"
    words = ["train", str(poses), "-o", str(run), "--preset", "fast", "--steps", "100", "--quiet"]
    assert main([*words, "--max-gaussians", "3000"]) == 0
    capsys.readouterr()
    assert main(["eval", str(run), "--geometry", str(truth / "depth"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["geometry"]["depth"]["expected"]
    wide = found["rings"][-1]
    print(found["abs_rel_median"], found["coverage"], wide)
    assert found["coverage"] > tolerances.AROUND_COVERED
    assert wide["from_degrees"] >= 80 and wide["pixels"] > 1000
    assert found["abs_rel_median"] < tolerances.AROUND_DEPTH
