"""Four 220-degree fisheyes on a body: from OCamCalib's files to poses, training and depth."""

import json

import numpy as np
import pytest

import gsut
import tolerances
from gsut.cli import main
from gsut.demo import make_demo_rig
from gsut.demo.rig import make_rig
from gsut.sfm import compare_datasets

FRAMES, SIZE, PATH_SHARE = 4, 128, 0.1


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    """As `gsut demo --rig 4` makes it, but smaller."""
    folder = tmp_path_factory.mktemp("around") / "hall"
    return make_demo_rig(folder, FRAMES, SIZE, progress=False, path_share=PATH_SHARE, cameras=4)


@pytest.fixture(scope="module")
def poses(truth):
    """What `gsut poses --rig` makes of the photographs, the rig's file and four lens files."""
    out = truth.parent / "poses"
    words = ["poses", str(truth / "images"), "--rig", str(truth / "rig.json"), "--quiet"]
    assert main([*words, "-o", str(out)]) == 0
    return out


def test_lenses_of_the_files_are_those_of_the_pictures(truth):
    for mounted in make_rig(4, SIZE):
        file = truth / mounted.name / "calib_results.txt"
        assert 'affine parameters "c", "d", "e"' in file.read_text()
        lens, made = gsut.load_camera(file), mounted.lens
        assert lens.model == "ocam"
        np.testing.assert_allclose(lens.params, made.params, rtol=tolerances.OCAM_FILE)
        rays, valid = made.rays()
        found, also = lens.rays()
        assert also[valid].all()
        worst = np.abs(found - rays)[valid].max()
        print(f"{worst:.1e}")
        assert worst < tolerances.OCAM_FILE
        assert np.degrees(np.arccos(rays[valid][:, 2].min())) > 109
        # Square, upright pixels put the rim elsewhere: the affine part is kept, and matters.
        params = np.array(made.params)
        params[2:5] = 1, 0, 0
        pixels, seen = made.with_params(params).project(rays[valid])
        there = made.project(rays[valid])[0]
        assert np.linalg.norm(pixels - there, axis=1)[seen].max() > 0.1


def test_poses_of_all_images_come_out_in_metres(truth, poses):
    errors = compare_datasets(truth, poses)
    assert errors.images == 4 * FRAMES
    print(errors.scale_error_percent, errors.metric_ate, np.median(errors.rotation_degrees))
    assert abs(errors.scale_error_percent) < tolerances.AROUND_SCALE_PERCENT
    assert errors.metric_ate < tolerances.AROUND_METRES
    lenses = {gsut.load_dataset(poses).camera(row).model for row in range(4 * FRAMES)}
    assert lenses == {"ocam"}


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
