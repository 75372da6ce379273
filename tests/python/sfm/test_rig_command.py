"""`gsut poses --rig` on a made scene with known truth: files, scale, training, bad flags."""

import json

import cv2
import numpy as np
import pytest

import gsut
import tolerances
from box_room import make_rig_of_two, place_right, plan_walk, write_box_rig
from gsut.cli import main
from gsut.data.colmap import read_frames, read_images, read_rigs
from gsut.sfm import compare_datasets, compare_poses

FRAMES, SIZE = 6, 200
PATH_SHARE = 0.15  # of the walk: neighbours see the same


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """A folder with rig_hall, as `gsut demo --rig` writes it, but smaller."""
    folder = tmp_path_factory.mktemp("rig")
    write_box_rig(folder / "rig_hall", make_rig_of_two(SIZE), plan_walk(FRAMES, PATH_SHARE))
    return folder


@pytest.fixture(scope="module")
def poses(demo):
    """What `gsut poses --rig` wrote."""
    truth = demo / "rig_hall"
    words = ["poses", str(truth / "images"), "--rig", str(truth / "rig.json"), "--quiet"]
    assert main([*words, "-o", str(demo / "rig_poses")]) == 0
    return demo / "rig_poses"


def test_poses_with_a_rig_finds_all_images_in_metres(demo, poses):
    errors = compare_datasets(demo / "rig_hall", poses)
    assert errors.images == 2 * FRAMES
    assert abs(errors.scale_error_percent) < tolerances.RIG_DEMO_SCALE_PERCENT
    assert errors.metric_ate < tolerances.RIG_DEMO_METRES
    figures = json.loads((poses / "poses.json").read_text())
    rig = figures["rig"]
    assert rig["frames_registered"] == rig["frames_total"] == FRAMES
    assert rig["frames"][0] == ["left/000.png", "right/000.png"]
    assert [c["name"] for c in rig["cameras"]] == ["left", "right"]
    assert rig["cameras"][1]["turned_degrees"] == 0.0
    assert not rig["refined"]
    assert "rig's pose at one frame is held" in figures["covariance_of"]
    assert figures["notes"] == ["12 images of 2 cameras in 6 frames, paired by name"]


def test_poses_with_a_rig_writes_both_lenses_in_all_forms(demo, poses):
    frames = json.loads((poses / "transforms.json").read_text())["frames"]
    assert len({frame["fl_x"] for frame in frames}) == 2
    lines = (poses / "sparse" / "0" / "cameras.txt").read_text().splitlines()
    assert [line.split()[0] for line in lines if not line.startswith("#")] == ["1", "2"]
    model = poses / "sparse" / "0"
    (rig,), taken = read_rigs(model / "rigs.txt"), read_frames(model / "frames.txt")
    assert list(rig.cameras) == [1, 2]
    assert [frame.images for frame in taken] == [
        [(1, 2 * i + 1), (2, 2 * i + 2)] for i in range(FRAMES)
    ]
    images = read_images(model / "images.txt")
    assert {(row.camera_id, row.name.split("/")[0]) for row in images} == {
        (1, "left"), (2, "right")
    }  # fmt: skip
    again = json.loads((poses / "rig.json").read_text())["cameras"]["right"]
    assert np.abs(np.array(again["camera_from_reference"]) - place_right()).max() < 1e-12
    assert (poses / again["file"]).resolve() == (demo / "rig_hall" / "right.yaml").resolve()
    page = (poses / "report.html").read_text()
    assert "6 of 6 frames" in page
    assert "camera right" in page


def test_poses_with_a_rig_refuses_a_camera_beside_it(demo, tmp_path, capsys):
    truth = demo / "rig_hall"
    words = ["--rig", str(truth / "rig.json"), "--camera", "left.yaml", "-o", str(tmp_path / "out")]
    assert main(["poses", str(truth / "images"), *words]) == 2
    assert "--camera contradicts --rig" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.fixture
def two_cameras(demo, tmp_path):
    """The rig's images as those of two cameras, the right one's half as large again."""
    larger = round(1.5 * SIZE)
    for camera, size in (("left", SIZE), ("right", larger)):
        folder = tmp_path / "in" / "images" / camera
        folder.mkdir(parents=True)
        for path in (demo / "rig_hall" / "images" / camera).iterdir():
            picture = cv2.resize(cv2.imread(str(path)), (size, size), interpolation=cv2.INTER_CUBIC)
            cv2.imwrite(str(folder / path.name), picture)
        lens = gsut.load_camera(demo / "rig_hall" / f"{camera}.yaml").resize(size, size)
        gsut.save_camera(lens, tmp_path / "in" / f"{camera}.lens.json")
    return tmp_path / "in"


@pytest.mark.slow
def test_poses_command_of_two_cameras_uses_the_lens_file_of_each(demo, two_cameras, tmp_path):
    out = tmp_path / "out"
    assert main(["poses", str(two_cameras), "-o", str(out), "--quiet"]) == 0
    figures = json.loads((out / "poses.json").read_text())
    assert figures["lens"] == "known" and figures["registered"] == 2 * FRAMES
    files = [gsut.load_camera(two_cameras / f"{name}.lens.json") for name in ("left", "right")]
    found = gsut.load_dataset(out, test_every=0)
    for index, view in enumerate(found.views):
        assert repr(found.camera(index)) == repr(files["right" in view.name])
    truth = gsut.load_dataset(demo / "rig_hall", test_every=0)
    where = [
        {"/".join(view.name.split("/")[-2:]): view.camera_from_world for view in scene.views}
        for scene in (found, truth)
    ]
    assert where[0].keys() == where[1].keys()
    names = sorted(where[0])
    errors = compare_poses(*(np.array([poses[name] for name in names]) for poses in where))
    assert np.median(errors.rotation_degrees) < 1  # observed 0.4; small pictures
    assert errors.ate < 0.01 * errors.extent  # observed 0.0012
