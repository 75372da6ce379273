"""Layouts of robotics: EuRoC, TUM-VI, TUM, KITTI, plain and described folders; mistakes in them."""

import re
import shutil

import numpy as np
import pytest

import gsut
import small_datasets as small
import small_recordings as made
import tolerances
from gsut.data.layouts import list_layouts
from gsut.data.poses import invert_pose
from gsut.data.scene import read_depth
from raising import raises_saying

JITTER = 500_000  # nanoseconds


def assert_truth(scene: gsut.Scene, cameras=(0, 1), stamps=None, count=small.VIEWS) -> None:
    """All views of these cameras have the poses of their times."""
    assert len(scene) == count * len(cameras)
    for view in scene.views:
        camera = next((c for c in cameras if f"cam{c}" in view.name), cameras[0])
        stem = view.image_path.stem
        time = int(stem) if stamps is None else stamps[stem]
        made.assert_pose(view, camera, time)


# --- what is read


def test_euroc_gives_each_camera_its_pose_on_the_body(tmp_path):
    scene = gsut.load_dataset(made.write_euroc(tmp_path))
    assert_truth(scene)
    assert scene.views[0].name == f"mav0/cam0/data/{made.START}.png"
    assert scene.cameras[0].model == "opencv4"
    np.testing.assert_allclose(
        scene.cameras[0].params[:4], [small.FX, small.FY, small.CX, small.CY], rtol=1e-15
    )


@pytest.mark.parametrize("place", ["mav0/cam1", "mav0"])
def test_euroc_is_found_from_inside_and_a_camera_is_chosen_by_its_folder(place, tmp_path):
    made.write_euroc(tmp_path)
    assert_truth(gsut.load_dataset(tmp_path / place), (1,) if "cam1" in place else (0, 1))


def test_tumvi_takes_lenses_and_places_from_the_camchain(tmp_path):
    assert_truth(gsut.load_dataset(made.write_tumvi(tmp_path)))


def test_pictures_and_table_that_disagree_are_told(tmp_path):
    made.write_euroc(tmp_path)
    pictures = sorted((tmp_path / "mav0/cam1/data").iterdir())
    pictures[2].rename(pictures[2].with_name("77.png"))
    table = f"{tmp_path}/mav0/cam1/data.csv"
    notes = gsut.load_dataset(tmp_path).notes
    assert f"{table}: 1 pictures do not exist and are left out: {pictures[2].name}" in notes
    assert f"{table}: 1 pictures are not in it and are left out: 77.png" in notes


def test_camchain_without_imu_of_the_second_camera_goes_through_the_first(tmp_path):
    made.write_tumvi(tmp_path)
    chain = tmp_path / "dso/camchain.yaml"
    first, second = chain.read_text().split("cam1:")
    second = re.sub(r"  T_cam_imu:\n(  - .*\n){4}", "", second)
    chain.write_text(first + "cam1:" + second)
    assert_truth(gsut.load_dataset(tmp_path))


def test_camchain_time_shift_is_added_to_the_pictures_clock(tmp_path):
    made.write_tumvi(tmp_path)
    (tmp_path / "dso/camchain.yaml").write_text(made.camchain(shift=0.03))
    moved = [t + 30_000_000 for t in made.times()]
    made.write_states(tmp_path / "mav0/mocap0/data.csv", moved)
    stamps = {str(t): t + 30_000_000 for t in made.times()}
    assert_truth(gsut.load_dataset(tmp_path), stamps=stamps)


def test_poses_of_a_vicon_marker_go_through_its_place_on_the_body(tmp_path):
    made.write_euroc(tmp_path)
    states = tmp_path / "mav0/state_groundtruth_estimate0"
    states.rename(tmp_path / "mav0/vicon0")
    place = np.eye(4)
    place[:3, 3] = [0.0, 0.2, 0.1]
    (tmp_path / "mav0/vicon0/sensor.yaml").write_text(
        f"T_BS:\n  cols: 4\n  rows: 4\n  data: {made.matrix_text(place)}\n"
    )
    scene = gsut.load_dataset(tmp_path)
    view = scene.views[0]
    body = made.world_from_body(made.START) @ invert_pose(place)
    expected = invert_pose(body @ made.body_from_cameras()[0])
    np.testing.assert_allclose(
        view.camera_from_world, expected, rtol=0, atol=tolerances.LAYOUT_POSE
    )


def test_euroc_points_are_read(tmp_path):
    made.write_euroc(tmp_path)
    cloud = tmp_path / "mav0/pointcloud0/data.ply"
    cloud.parent.mkdir()
    small.write_ply(cloud, *small.points())
    assert len(gsut.load_dataset(tmp_path).points) == len(small.points()[0])


def write_pieces(folder, text: str) -> None:
    """Pictures of cam0, a camchain and a trajectory that lie apart."""
    made.write_pictures(folder / "pictures/cam0", 0)
    (folder / "calibration").mkdir()
    (folder / "calibration/chain.yaml").write_text(made.camchain())
    (folder / "slam.txt").write_text(made.trajectory(made.times()))
    (folder / "dataset.yaml").write_text(text)


DESCRIPTION = "images: pictures/cam0\nlens: calibration/chain.yaml\nposes: slam.txt\n"


def test_description_brings_pieces_together(tmp_path):
    write_pieces(tmp_path, DESCRIPTION)
    assert_truth(gsut.load_dataset(tmp_path), (0,))
    assert_truth(gsut.load_dataset(tmp_path / "dataset.yaml"), (0,))


def test_description_of_another_name_is_found_again_by_its_own(tmp_path):
    write_pieces(tmp_path, DESCRIPTION)
    (tmp_path / "dataset.yaml").rename(tmp_path / "morning.yaml")
    scene = gsut.load_dataset(tmp_path / "morning.yaml")
    assert scene.path == tmp_path / "morning.yaml"
    assert_truth(scene, (0,))


def test_description_replaces_the_poses_of_a_known_layout(tmp_path):
    made.write_euroc(tmp_path / "set")
    (tmp_path / "slam.txt").write_text(made.trajectory(made.times()[:4]))
    (tmp_path / "dataset.yaml").write_text("images: set\nposes: slam.txt\ncameras: [cam1]\n")
    scene = gsut.load_dataset(tmp_path)
    assert_truth(scene, (1,), count=4)
    assert any("6 of 10 images have no pose within 0.02 s" in note for note in scene.notes)


def test_poses_between_pictures_are_interpolated_at_their_times(tmp_path):
    """Jitter of 0.5 ms: the pose of a picture's own time, not that of the nearest line."""
    write_pieces(tmp_path, DESCRIPTION)
    random = np.random.default_rng(0)
    at = [t + int(random.integers(-JITTER, JITTER)) for t in made.times()]
    at[0], at[-1] = at[0] - JITTER, at[-1] + JITTER  # beyond the first and the last picture
    (tmp_path / "slam.txt").write_text(made.trajectory(at))
    scene = gsut.load_dataset(tmp_path)
    assert len(scene) == small.VIEWS
    for view in scene.views:
        expected = invert_pose(made.world_from_camera(0, int(view.image_path.stem)))
        np.testing.assert_allclose(
            view.camera_from_world, expected, rtol=0, atol=tolerances.LAYOUT_INTERPOLATED
        )


def test_nanosecond_names_are_told_apart_beyond_float64(tmp_path):
    """Poses 1 ns apart: as floating-point numbers their times are equal."""
    write_pieces(tmp_path, DESCRIPTION)
    first = made.times()[0]
    assert float(first) == float(first + 1)
    at = [first, first + 1, *made.times()[1:]]
    lines = made.trajectory(at).splitlines()
    fields = lines[2].split()
    lines[2] = " ".join([fields[0], "77", *fields[2:]])
    (tmp_path / "slam.txt").write_text("\n".join(lines) + "\n")
    assert_truth(gsut.load_dataset(tmp_path), (0,))


def test_description_chooses_cameras(tmp_path):
    made.write_euroc(tmp_path / "set")
    (tmp_path / "dataset.yaml").write_text("images: set\ncameras: cam0\n")
    assert_truth(gsut.load_dataset(tmp_path), (0,))


def test_time_offset_moves_the_pictures_clock(tmp_path):
    write_pieces(tmp_path, DESCRIPTION + "time_offset: 100\n")
    at = made.times()
    lines = made.trajectory(at, label=lambda t: str(t + 100 * 10**9)).splitlines()
    (tmp_path / "slam.txt").write_text("\n".join(lines) + "\n")
    assert_truth(gsut.load_dataset(tmp_path), (0,))


def test_poses_of_a_camera_go_through_the_chain_to_the_other(tmp_path):
    for number, name in enumerate(made.CAMERAS):
        made.write_pictures(tmp_path / "images" / name, number)
    (tmp_path / "camchain.yaml").write_text(made.camchain(with_imu=False))
    (tmp_path / "dataset.yaml").write_text(
        "images: {cam0: images/cam0, cam1: images/cam1}\nlens: camchain.yaml\n"
        "poses: slam.txt\nposes_of: cam0\n"
    )
    rows = ["# timestamp tx ty tz qw qx qy qz"]  # the heading says: w first
    for time in made.times():
        pose = made.world_from_camera(0, time)
        values = (*pose[:3, 3], *small.quaternion(pose[:3, :3]))
        rows.append(f"{time}" + "".join(f" {v:.17g}" for v in values))
    (tmp_path / "slam.txt").write_text("\n".join(rows) + "\n")
    assert_truth(gsut.load_dataset(tmp_path))


def test_plain_folder_of_a_rig_finds_folders_by_the_camchains_names(tmp_path):
    for number, name in enumerate(made.CAMERAS):
        made.write_pictures(tmp_path / "images" / name, number)
    (tmp_path / "camchain.yaml").write_text(made.camchain())
    (tmp_path / "trajectory.txt").write_text(made.trajectory(made.times()))
    assert_truth(gsut.load_dataset(tmp_path))


def write_tum(folder) -> None:
    def name(time):
        return f"{time // 10**9}.{time % 10**9:09d}.png"

    made.write_pictures(folder / "rgb", 0, name)
    rows = [f"{name(t)[:-4]} rgb/{name(t)}" for t in made.times()]
    (folder / "rgb.txt").write_text("# color images\n" + "\n".join(rows) + "\n")
    (folder / "lens.yaml").write_text(made.camchain(with_imu=False).split("cam1:")[0])
    (folder / "groundtruth.txt").write_text(camera_trajectory())


def camera_trajectory() -> str:
    rows = ["# timestamp tx ty tz qx qy qz qw"]
    for time in made.times():
        pose = made.world_from_camera(0, time)
        w, *xyz = small.quaternion(pose[:3, :3])
        values = "".join(f" {v:.17g}" for v in (*pose[:3, 3], *xyz, w))
        rows.append(f"{time // 10**9}.{time % 10**9:09d}{values}")
    return "\n".join(rows) + "\n"


def test_tum_layout_is_read(tmp_path):
    write_tum(tmp_path)
    stamps = {f"{t // 10**9}.{t % 10**9:09d}": t for t in made.times()}
    assert_truth(gsut.load_dataset(tmp_path), (0,), stamps)


def test_tum_associations_take_the_colour_pictures(tmp_path):
    write_tum(tmp_path)
    table = tmp_path / "rgb.txt"
    lines = [line for line in table.read_text().splitlines() if not line.startswith("#")]
    rows = [f"{line} {line.replace('rgb/', 'depth/')}" for line in lines]
    (tmp_path / "associations.txt").write_text("\n".join(rows) + "\n")
    table.unlink()
    assert len(gsut.load_dataset(tmp_path)) == small.VIEWS


@pytest.mark.parametrize("listed", ["depth.txt", "associations.txt"])
def test_tum_depths_are_z_of_five_thousand_levels_a_metre(tmp_path, listed):
    write_tum(tmp_path)
    levels = np.full((small.HEIGHT, small.WIDTH), 2 * 5000, np.uint16)
    (tmp_path / "depth").mkdir()
    rows = []
    for time in made.times()[1:]:
        stamp = f"{(time + 10**7) // 10**9}.{(time + 10**7) % 10**9:09d}"  # 10 ms later
        small.write_png(tmp_path / f"depth/{stamp}.png", levels)
        rows.append(f"{stamp} depth/{stamp}.png")
    colours = (tmp_path / "rgb.txt").read_text().splitlines()[1:]
    if listed == "associations.txt":
        pairs = [colours[0], *map(" ".join, zip(colours[1:], rows, strict=True))]
        (tmp_path / "rgb.txt").unlink()
        (tmp_path / listed).write_text("\n".join(pairs))
    else:
        (tmp_path / listed).write_text("# depth maps\n" + "\n".join(rows))
    scene = gsut.load_dataset(tmp_path)
    rays = np.asarray(scene.camera(1).rays()[0])
    expected = 2 * np.linalg.norm(rays, axis=2) / rays[..., 2]
    np.testing.assert_allclose(read_depth(scene, 1), expected, rtol=0, atol=tolerances.LAYOUT_POSE)
    assert scene.views[0].depth_path is None
    assert any("1 pictures have no depth" in note for note in scene.notes)


def write_kitti(folder) -> None:
    """Camera 2 stands 0.3 to the right of camera 0, whose poses are given."""
    sequence = folder / "sequences/04"
    places = {2: np.eye(4), 0: np.eye(4)}
    places[2][0, 3] = 0.3
    k = np.array([[small.FX, 0, LENS_X], [0, small.FY, LENS_Y], [0, 0, 1]])
    rows = []
    for number, place in places.items():
        for i, time in enumerate(made.times()):
            picture = small.render(made.world_from_camera(0, time) @ place)
            small.write_png(sequence / f"image_{number}/{i:06d}.png", picture)
        projection = k @ invert_pose(place)[:3]
        rows.append(f"P{number}: " + " ".join(f"{v:.17g}" for v in projection.ravel()))
    (sequence / "calib.txt").write_text("\n".join(rows) + "\n")
    (sequence / "times.txt").write_text("".join(f"{0.1 * i:e}\n" for i in range(small.VIEWS)))
    (folder / "poses").mkdir()
    (folder / "poses/04.txt").write_text(
        "".join(
            " ".join(f"{v:.17g}" for v in made.world_from_camera(0, t)[:3].ravel()) + "\n"
            for t in made.times()
        )
    )


LENS_X, LENS_Y = made.LENS[2:]


@pytest.mark.parametrize(("place", "shift"), [("", 0.3), ("sequences/04/image_0", 0.0)])
def test_kitti_sequence_is_read_with_the_cameras_offset(place, shift, tmp_path):
    write_kitti(tmp_path)
    scene = gsut.load_dataset(tmp_path / place)
    assert len(scene) == small.VIEWS and scene.cameras[0].model == "pinhole"
    assert scene.cameras[0].params[2] == pytest.approx(small.CX, rel=tolerances.DATA_ROUNDING)
    for i, view in enumerate(scene.views):
        pose = made.world_from_camera(0, made.times()[i])
        expected = pose[:3, 3] + shift * pose[:3, 0]
        np.testing.assert_allclose(
            view.camera_center, expected, rtol=0, atol=tolerances.LAYOUT_POSE
        )


# --- what is refused, and in which words


def pieces(change=None, text=DESCRIPTION):
    def write(folder) -> None:
        write_pieces(folder, text)
        if change is not None:
            change(folder)

    return write


def labels(make):
    return lambda folder: (folder / "slam.txt").write_text(made.trajectory(made.times(), make))


def line_of_slam(number: int, text: str):
    def change(folder) -> None:
        lines = (folder / "slam.txt").read_text().splitlines()
        lines[number - 1] = text
        (folder / "slam.txt").write_text("\n".join(lines) + "\n")

    return change


def without_imu(folder) -> None:
    made.write_tumvi(folder)
    (folder / "dso/camchain.yaml").write_text(made.camchain(with_imu=False))


def spare_times(folder) -> None:
    write_pieces(folder, DESCRIPTION)
    at = [t + made.STEP // 2 for t in made.times()]
    (folder / "slam.txt").write_text(made.trajectory(at))


REFUSED = {
    "other_clock": (
        pieces(labels(lambda t: f"{(t - made.START) / 1e9 + 5:.9f}")),
        "slam.txt", "do not overlap", "1403636579.763555584 to 1403636580.663555593",
        "5.000000000 to 5.900000", "time_offset: -1403636574.7635",
    ),
    "nanoseconds_for_seconds": (
        pieces(labels(lambda t: f"{t}"), DESCRIPTION + "pose_times: s\n"),
        "they overlap if the times of poses are in ns", "pose_times: ns",
    ),
    "tolerance_too_small": (
        spare_times, "no picture has a pose within 0.02 s", "0.05 s away", "time_tolerance: 0.075",
    ),
    "no_imu": (without_imu, "camchain.yaml, camera cam0", "no T_cam_imu", "poses_of: cam0"),
    "quaternion_norm": (
        pieces(line_of_slam(3, "1403636579.9 1 2 3 0 0 0 2")), "slam.txt, line 3", "norm is 2",
        "check the order",
    ),
    "line_cut_off": (
        pieces(line_of_slam(4, "1403636579.9 1 2 3")), "slam.txt, line 4",
        "expected 'name tx ty tz qx qy qz qw'",
    ),
    "counted_names": (
        pieces(lambda folder: [p.rename(p.with_name(f"{i:03d}.png")) for i, p in
                               enumerate(sorted((folder / "pictures/cam0").iterdir()))]),
        "the pictures' names count them and are no times", "rgb.txt",
    ),
    "unknown_key": (
        pieces(text=DESCRIPTION + "tolerance: 1\n"), "dataset.yaml, line 4, 'tolerance'",
        "time_tolerance",
    ),
    "lens_absent": (
        pieces(text=DESCRIPTION.replace("chain.yaml", "chian.yaml")),
        "dataset.yaml, line 2, 'lens'", "chian.yaml does not exist",
    ),
    "wrong_unit": (
        pieces(text=DESCRIPTION + "pose_times: hours\n"), "line 4, 'pose_times'", "s, ms, us, ns",
    ),
    "unknown_camera": (
        pieces(text=DESCRIPTION + "cameras: [cam7]\n"), "no camera cam7, only cam0",
    ),
    "poses_of_nothing": (
        pieces(text=DESCRIPTION + "poses_of: lidar\n"), "`poses_of: lidar`", "body, camera, cam0",
    ),
    "time_offset_is_a_word": (
        pieces(text=DESCRIPTION + "time_offset: all\n"), "line 4, 'time_offset'", "a number",
    ),
    "no_poses": (
        lambda folder: shutil.rmtree(made.write_euroc(folder) / "mav0/state_groundtruth_estimate0"),
        "20 pictures and a lens, but no poses", "gsut poses",
    ),
    "kitti_count": (
        lambda folder: (write_kitti(folder), (folder / "sequences/04/image_2/000003.png").unlink()),
        "04.txt", "10 poses without times", "9 pictures of camera image_2",
    ),
    "kitti_no_projection": (
        lambda folder: (write_kitti(folder),
                        (folder / "sequences/04/calib.txt").write_text("P0: 1 2 3\n")),
        "calib.txt, line 1", "expected 'P0:' and 12 numbers",
    ),
    "two_sequences": (
        lambda folder: (write_kitti(folder),
                        shutil.copytree(folder / "sequences/04", folder / "sequences/05")),
        "2 sequences: 04, 05",
    ),
    "tum_line": (
        lambda folder: (write_tum(folder), (folder / "rgb.txt").write_text("1403636579.7\n")),
        "rgb.txt, line 1", "expected 'time rgb/FILE'",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_mistakes_in_recordings_are_one_clear_sentence(name, tmp_path):
    write, *parts = REFUSED[name]
    write(tmp_path)
    with raises_saying(parts):
        gsut.load_dataset(tmp_path)


def test_the_error_of_an_unknown_folder_names_every_layout_that_is_read(tmp_path):
    readable = [layout.name for layout in list_layouts() if layout.read or layout.record]
    assert len(readable) >= 7
    with raises_saying(readable):
        gsut.load_dataset(tmp_path)
