"""Poses of a video by the colours of Gaussians that grow image by image."""

import json

import numpy as np
import pytest

import gsut
from box_room import make_fisheye, plan_walk, write_box_room
from gsut.cli import main
from gsut.gaussians import measure_rotation_angles
from gsut.sfm.mapping import PosesLog
from gsut.sfm.matches.matching import PairMatches
from gsut.sfm.photographs.features import Features
from gsut.sfm.photographs.options import PosesOptions
from gsut.sfm.photographs.stages import FOLDER
from gsut.sfm.points.bearing_points import BearingPoints
from gsut.sfm.world.comparison import compare_poses
from gsut.training import photometric_poses

pytestmark = pytest.mark.quick

FRAMES, SIZE, SHARE = 12, 96, 0.0012  # frames, pixels, share of the demo's path a frame


def posed_rays(rng, images=4, points=60):
    """Cameras along a line, points around them, and their exact features and matches."""
    camera = gsut.Camera(
        "kannala_brandt", [60, 61, 100, 99, 0.02, -0.01, 0.002, 0], 200, 200, valid_field_angle=1.6
    )
    positions = rng.normal(size=(points, 3)) * 0.8 + [0, 0, 4]
    poses = []
    for i in range(images):
        pose = np.eye(4)
        pose[:3, 3] = [-0.4 * i, 0.05 * i, 0.02 * i]
        poses.append(pose)
    features = []
    for pose in poses:
        pixels, valid = camera.project(positions @ pose[:3, :3].T + pose[:3, 3])
        assert valid.all()
        colors = np.tile(np.arange(points, dtype=np.uint8)[:, None], 3)
        features.append(
            Features(pixels, np.ones(points, np.float32), np.zeros((points, 128), np.uint8), colors)
        )
    both = np.tile(np.arange(points, dtype=np.int32)[:, None], 2)
    pairs = [
        PairMatches(a, b, both, np.eye(4), 0, 0.1)
        for a in range(images)
        for b in range(a + 1, images)
    ]
    return camera, positions, np.array(poses), features, pairs


def test_bearing_points_of_exact_poses_are_exact_and_one_a_track(rng):
    camera, positions, poses, features, pairs = posed_rays(rng)
    points = BearingPoints([camera] * 4, features, pairs, 0.5, np.radians(1.0))
    for image in range(4):
        points.add_image(image, poses)
    assert len(points.positions) == len(positions)
    assert len(points.observations) == 4 * len(positions)
    order = points.colors[:, 0]
    np.testing.assert_allclose(points.positions, positions[order], atol=1e-9)
    moved = points.positions + 0.01 * rng.normal(size=points.positions.shape)
    points.positions = moved
    points.adjust(poses)
    np.testing.assert_allclose(points.positions, positions[order], atol=1e-9)


def test_bearing_points_leave_out_wrong_matches_and_thin_angles(rng):
    camera, positions, poses, features, pairs = posed_rays(rng, images=2)
    wrong = pairs[0].matches.copy()
    wrong[:10, 1] = wrong[np.arange(1, 11) % 10, 1]  # ten matches of wrong features
    pair = PairMatches(0, 1, wrong, np.eye(4), 0, 0.1)
    points = BearingPoints([camera] * 2, features, [pair], 0.5, np.radians(1.0))
    for image in range(2):
        points.add_image(image, poses)
    assert len(positions) - 10 <= len(points.positions) < len(positions)
    assert set(range(10, len(positions))) <= set(points.colors[:, 0].tolist())
    none = BearingPoints([camera] * 2, features, pairs, 0.5, np.radians(60.0))
    none.add_image(0, poses)
    none.add_image(1, poses)
    assert len(none.positions) == 0


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """A dataset of a short video through a fisheye, in the order of names."""
    folder = tmp_path_factory.mktemp("video") / "data"
    return write_box_room(folder, make_fisheye(SIZE), plan_walk(FRAMES, FRAMES * SHARE))


@pytest.fixture(scope="module")
def count_images():
    """The images that `gsut poses --photometric` has posed one by one, appended as it goes."""
    posed: list[int] = []
    add_next = photometric_poses.VideoScene.add_next

    def counted(growth):
        posed.append(growth.next)
        add_next(growth)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(photometric_poses.VideoScene, "add_next", counted)
        yield posed


@pytest.fixture(scope="module")
def registered(video, count_images, tmp_path_factory):
    """Folder of `gsut poses --photometric`, its solution, and the images posed one by one."""
    out, results = tmp_path_factory.mktemp("registered") / "poses", []

    def find(*args, **kwargs):
        results.append(photometric_poses.find_video_poses(*args, **kwargs))
        return results[-1]

    count_images.clear()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gsut.training.find_video_poses", find)
        assert main(["poses", str(video), "--photometric", "-o", str(out), "--quiet"]) == 0
    return out, results[0].solution, list(count_images)


def test_a_video_is_registered_by_its_colours(video, registered):
    out = registered[0]
    figures = json.loads((out / "poses.json").read_text())
    assert figures["registered"] == FRAMES
    poses = [
        np.array([view.camera_from_world for view in gsut.load_dataset(folder).views])
        for folder in (out, video)
    ]
    # The centres lie almost on a line, so turns are compared from the first image's on.
    turns = [p[:, :3, :3] @ p[0, :3, :3].T for p in poses]
    off = np.degrees(measure_rotation_angles(np.einsum("nij,nkj->nik", *turns)))
    assert off.max() < 0.4  # degrees; worst observed: 0.14
    assert compare_poses(*poses).ate_percent < 1.5  # worst observed: 0.54
    assert (out / "report.html").is_file()


@pytest.mark.slow
def test_a_killed_run_goes_on_from_its_last_images_to_the_same_bits(
    video, registered, count_images, tmp_path
):
    _, whole, posed_by_whole = registered
    assert posed_by_whole == [8, 9, 10, 11]
    options = PosesOptions(threads=1)  # the whole run had all

    def run(on_progress=None):
        count_images.clear()
        return photometric_poses.find_video_poses(
            video, tmp_path / "part", options=options, log=PosesLog(on_progress)
        ).solution

    class Killed(Exception):
        pass

    def kill(stage, done, total, text):
        if len(count_images) == 3:
            raise Killed

    with pytest.raises(Killed):
        run(kill)
    assert count_images == [8, 9, 10]  # kept after image 9
    resumed = run()
    assert count_images == [10, 11]
    assert not (tmp_path / "part" / FOLDER).exists()
    np.testing.assert_array_equal(resumed.camera_from_world, whole.camera_from_world)
    np.testing.assert_array_equal(resumed.points, whole.points)
    np.testing.assert_array_equal(resumed.covariances, whole.covariances)
    # A damaged file is made again.
    broken = tmp_path / "broken" / FOLDER
    broken.mkdir(parents=True)
    (broken / "growth.npz").write_bytes(b"PK")
    assert photometric_poses._read_kept(broken / "growth.npz") is None


def test_photometric_without_a_lens_is_refused(video, tmp_path, capsys):
    code = main(["poses", str(video), "--photometric", "--unknown-lens", "-o", str(tmp_path / "x")])
    assert code == 2
    assert "--photometric needs a known lens; give it by --camera" in capsys.readouterr().err
