"""Rigs in `gsut poses`: scale and poses from exact and noisy tracks, missing images, wrong rigs."""

import dataclasses
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import gsut
import tolerances
from disturbances import disturb_rig
from gsut import _core
from gsut.data.poses import find_centers, invert_pose
from gsut.data.rigs import measure_changes, read_rig, write_rig
from gsut.sfm.matches.matching import choose_pairs
from gsut.sfm.photographs.features import Features, make_no_features
from gsut.sfm.photographs.options import PosesOptions
from gsut.sfm.report.verdict import list_notes
from gsut.sfm.rig.fit import solve_rig
from gsut.sfm.rig.images import find_rig_photographs
from gsut.sfm.rig.start import place_rig
from gsut.sfm.solution import Adjustment
from gsut.sfm.solution.adjustment import RigConstraint
from gsut.sfm.solution.result import FEATURE_VARIANCE
from gsut.sfm.solution.solver import adjust_poses
from gsut.sfm.world.comparison import compare_poses
from synthetic_rig import BACKWARD, STEREO, SyntheticRig, pose_of

STRETCHED = np.diag([1.0, 2.0, 1.0, 1.0]).tolist()
RUNS = 12  # of scenes from seeds, where a spread is on trial
ROOT = Path(__file__).resolve().parents[3]


def solved(scene, rig=None, **settings):
    mapping = scene.mapping(rig=rig or scene.rig, **settings)
    mapping = solve_rig(mapping)
    return mapping.solved, mapping.found.rig


def with_second(rig, pose):
    """The rig of two cameras with another pose of the second."""
    return dataclasses.replace(rig, camera_from_reference=np.stack([np.eye(4), pose]))


# --- poses and scale ------------------------------------------------------------------------------


@pytest.mark.parametrize("mount", [STEREO, BACKWARD], ids=["stereo", "back to back"])
def test_solve_rig_exact_tracks_gives_the_rigs_unit_exactly(rng, mount):
    scene = SyntheticRig(rng, mount)
    solution, fit = solved(scene)
    assert solution.registered.all()
    apart, turned = scene.worst(solution)  # no scale taken out
    assert apart < tolerances.RIG_EXACT
    assert turned < tolerances.RIG_EXACT
    assert fit.figures["scale_from_frames"] == 10
    np.testing.assert_array_equal(fit.rig.camera_from_reference, scene.rig.camera_from_reference)


@pytest.mark.parametrize("mount", [STEREO, BACKWARD], ids=["stereo", "back to back"])
def test_solve_rig_noisy_tracks_keeps_the_rig_and_the_scale(rng, mount):
    scene = SyntheticRig(rng, mount, noise=0.2)
    solution, fit = solved(scene)
    apart, turned = scene.worst(solution)
    assert apart < tolerances.RIG_UNITS
    assert turned < tolerances.RIG_DEGREES
    for frame in range(10):  # left and right of a frame, as the rig has them
        left, right = solution.camera_from_world[2 * frame : 2 * frame + 2]
        assert np.abs(right @ invert_pose(left) - mount).max() < tolerances.RIG_HELD
    assert len(fit.notes) == 1  # how images were paired, and no complaint


def test_solve_rig_reference_away_from_every_camera_and_three_cameras(rng):
    elsewhere = pose_of([0.2, -0.1, 0.3], [0.5, 0.4, -0.2])
    scene = SyntheticRig(rng, STEREO, BACKWARD, elsewhere=elsewhere)
    solution, fit = solved(scene)
    assert len(solution.registered) == 30
    assert solution.registered.all()
    apart, turned = scene.worst(solution)
    assert apart < tolerances.RIG_EXACT
    assert turned < tolerances.RIG_EXACT
    wrong = disturb_rig(scene.rig)
    noisy = SyntheticRig(rng, STEREO, BACKWARD, elsewhere=elsewhere, noise=0.2)
    _, fit = solved(noisy, wrong, refine_rig=True)
    changes = measure_changes(scene.rig, fit.rig.camera_from_reference)
    assert np.degrees(max(turn for turn, _ in changes)) < tolerances.RIG_REFINED_DEGREES
    assert size_of(fit.rig) == pytest.approx(size_of(wrong), rel=tolerances.RIG_SIZE)


def size_of(rig):
    """Root mean square distance of its cameras from their middle."""
    centers = find_centers(rig.camera_from_reference)
    return np.sqrt(((centers - centers.mean(axis=0)) ** 2).sum(axis=1).mean())


def test_solve_rig_image_without_features_is_no_frame(rng):
    scene = SyntheticRig(rng, noise=0.2, blind=[(5, 1)], few=0)
    solution, _ = solved(scene)
    (place,) = np.flatnonzero(~solution.registered)
    assert solution.names[place] == "right/005.png"


def test_solve_rig_image_of_another_place_gets_no_pose_from_its_frame(rng):
    scene = SyntheticRig(rng, noise=0.2)
    (stranger,) = [i for i, n in enumerate(scene.photographs.names) if n == "right/005.png"]
    features = scene.features[stranger]
    lens = scene.photographs.cameras[stranger]
    # Descriptors of the scene, everywhere: what is near a projection is chance.
    dense = rng.integers(0, len(features), 40 * len(features))
    scene.features[stranger] = Features(
        rng.uniform(0, [lens.width, lens.height], (len(dense), 2)), features.sizes[dense],
        features.descriptors[dense], features.colors[dense],
    )  # fmt: skip
    scene.pairs = [p for p in scene.pairs if stranger not in (p.first, p.second)]
    solution, fit = solved(scene)
    assert np.flatnonzero(~solution.registered).tolist() == [stranger]
    assert not (solution.observations[:, 1] == stranger).any()
    assert fit.figures["unmatched"] == ["right/005.png"]
    assert "1 of them share no point with other images and have no pose" in fit.notes[1]


@pytest.mark.parametrize("mount", [STEREO, BACKWARD], ids=["stereo", "back to back"])
def test_solve_rig_frames_that_do_not_connect_become_a_model_in_the_rigs_unit(rng, mount):
    scene = SyntheticRig(rng, mount, noise=0.2)
    early = scene.photographs.frames < 4
    scene.pairs = [p for p in scene.pairs if early[p.first] == early[p.second]]
    mapping = scene.mapping(rig=scene.rig)
    mapping = solve_rig(mapping)
    (other,) = mapping.found.models
    assert mapping.solved.registered.tolist() == (~early).tolist()  # the larger one first
    assert other.registered.tolist() == early.tolist()
    for model in (mapping.solved, other):
        apart, turned = scene.worst(model)
        assert apart < tolerances.RIG_UNITS
        assert turned < tolerances.RIG_DEGREES
    assert mapping.found.rig.figures["frames_registered"] == 6
    mapping = mapping.add_findings({"lens": "known"})
    assert not [note for note in list_notes(mapping) if "without a pose" in note]


@pytest.mark.slow
def test_solve_rig_standard_error_of_lengths_is_that_of_many_runs():
    errors, told = [], []
    for seed in range(RUNS):
        scene = SyntheticRig(np.random.default_rng(seed), noise=0.2, frames=8, points=400)
        solution, fit = solved(scene)
        errors.append(compare_poses(solution.camera_from_world, scene.poses).scale_error_percent)
        told.append(fit.figures["scale_sigma_percent"])
    # The features' noise is independent here: without the factor for photographs' features.
    told = np.array(told) / np.sqrt(FEATURE_VARIANCE)
    ratio = np.sqrt(np.mean((np.array(errors) / told) ** 2))
    assert 1 / tolerances.RIG_SCALE_SIGMA < ratio < tolerances.RIG_SCALE_SIGMA


def test_solve_rig_images_that_fail_alone_get_their_pose_from_their_mates(rng):
    scene = SyntheticRig(rng, noise=0.2, absent=[(3, 0), (5, 1)], blind=[(7, 1), (8, 0)])
    solution, fit = solved(scene)
    assert len(solution.registered) == 18
    assert solution.registered.all()
    assert set(fit.figures["placed_by_their_frame"]) == {"right/007.png", "left/008.png"}
    apart, turned = scene.worst(solution)
    assert apart < tolerances.RIG_UNITS
    assert turned < tolerances.RIG_DEGREES
    assert fit.figures["frames"][3] == [None, "right/003.png"]
    assert "2 without the image of a camera" in fit.notes[0]
    for name in ("right/007.png", "left/008.png"):  # and a covariance of its own
        i = scene.photographs.names.index(name)
        assert np.linalg.eigvalsh(solution.covariances[i]).min() > 0


def test_refine_on_a_rig_places_a_frame_without_poses(rng):
    scene = SyntheticRig(rng)
    photographs = scene.photographs
    known = photographs.frames != 4
    start = np.where(known[:, None, None], scene.poses, np.eye(4))
    rig = RigConstraint(photographs.frames, photographs.rig_cameras - 1, STEREO[None], known)
    solution = adjust_poses(
        scene.mapping().images, scene.pairs, list(start), PosesOptions(),
        adjustment=Adjustment(rig=rig),
    )  # fmt: skip
    assert solution.registered.all()
    assert scene.worst(solution)[0] < tolerances.RIG_EXACT


def test_solve_rig_places_a_frame_by_few_points_in_each_camera(rng):
    scene = SyntheticRig(rng, noise=0.2, blind=[(6, 0), (6, 1)], few=10)  # 15 are needed
    solution, fit = solved(scene)
    assert fit.figures["placed_by_their_frame"] == ["left/006.png", "right/006.png"]
    assert solution.registered.all()
    apart, turned = scene.worst(solution)
    assert apart < tolerances.RIG_FEW_UNITS
    assert turned < tolerances.RIG_FEW_DEGREES


# --- a rig that is a little wrong -----------------------------------------------------------------


def test_solve_rig_refines_a_disturbed_rig_and_keeps_its_size(rng):
    scene = SyntheticRig(rng, noise=0.2)
    wrong = disturb_rig(scene.rig)
    solution, fit = solved(scene, wrong, refine_rig=True)
    assert fit.rig.baseline == pytest.approx(wrong.baseline, rel=tolerances.RIG_SIZE)
    _, (turned, shifted) = measure_changes(scene.rig, fit.rig.camera_from_reference)
    assert np.degrees(turned) < tolerances.RIG_REFINED_DEGREES  # was 0.5
    assert shifted < tolerances.RIG_REFINED_SHARE * wrong.baseline  # was 0.01
    apart, turned = scene.worst(solution)
    assert apart < tolerances.RIG_UNITS
    assert turned < tolerances.RIG_DEGREES
    change = fit.figures["cameras"][1]
    assert change["turned_degrees"] == pytest.approx(0.5, abs=tolerances.RIG_REFINED_DEGREES)


def test_solve_rig_says_that_a_held_rig_is_turned_otherwise(rng):
    scene = SyntheticRig(rng, noise=0.2)
    _, fit = solved(scene, disturb_rig(scene.rig))
    assert any(
        "the rotation between two cameras differs" in n and "--refine-rig" in n for n in fit.notes
    )
    assert fit.figures["turn_against_file_degrees"] == pytest.approx(0.5, abs=0.05)


# --- the start: scale and poses of frames --------------------------------------------------------


def place_in_world(scene, poses=None, registered=None, rig=None):
    photographs = scene.photographs
    return place_rig(
        scene.poses if poses is None else poses,
        np.ones(len(scene.poses), bool) if registered is None else registered,
        photographs.frames, photographs.rig_cameras, rig or scene.rig,
        np.array([len(f) for f in scene.features]),
    )  # fmt: skip


def test_place_rig_finds_scale_and_overrules_a_misplaced_image(rng):
    scene = SyntheticRig(rng)
    poses = scene.poses.copy()
    poses[:, :3, 3] *= 2.5  # a map in another unit
    right = 9  # of frame 4: sees fewer points than its mate
    assert len(scene.features[right]) < len(scene.features[right - 1])
    poses[right] = pose_of([1.0, 0, 0], [3, 3, 3])
    start = place_in_world(scene, poses)
    assert start.scale == pytest.approx(0.4, rel=tolerances.RIG_EXACT)
    assert np.abs(start.camera_from_world - scene.poses).max() < tolerances.RIG_EXACT
    assert start.known.all()


def test_place_rig_needs_a_frame_with_two_images(rng):
    scene = SyntheticRig(rng)
    left = scene.photographs.rig_cameras == 0
    with pytest.raises(gsut.SolveError, match="sets no scale: 10 of 20 images were placed"):
        place_in_world(scene, registered=left)


def test_place_rig_knows_swapped_folders_and_a_pose_the_wrong_way_round(rng):
    scene = SyntheticRig(rng, pose_of([0.0, 0.01, 0.0], [0.3, 0, 0]))
    swapped = with_second(scene.rig, invert_pose(scene.rig.camera_from_reference[1]))
    with pytest.raises(gsut.SolveError, match="left and right swapped"):
        place_in_world(scene, rig=swapped)
    scene = SyntheticRig(rng, pose_of([0.0, 0.3, 0.0], [0.3, 0, 0]))
    turned = with_second(scene.rig, invert_pose(scene.rig.camera_from_reference[1]))
    with pytest.raises(gsut.SolveError, match=r"by 34 degrees from .* the right way round"):
        place_in_world(scene, rig=turned)


@pytest.mark.parametrize(
    ("body", "mount", "known", "message"),
    [
        ([0, 0], [-1, 1], [1, 1], "mount 1"),
        ([0, 5], [-1, 0], [1, 1], "body 5"),
        ([0, 0], [-1, 0], [1, 0], "some images of a body"),
        ([0], [-1], [1, 1], "one body and one mount"),
        ([], [], [1, 0], "on a rig only"),
        ([0, 0], [-1, 0], [1], "one flag an image"),
    ],
)
def test_refine_structure_refuses_a_rig_that_does_not_fit(body, mount, known, message):
    lens = gsut.Camera("pinhole", [100, 100, 50, 50], 100, 100)
    rig = {
        "body_of_image": body, "mount_of_image": mount, "camera_from_body": [STEREO],
        "refine": False,
    }  # fmt: skip
    with pytest.raises(gsut.InputError, match=message):
        _core.refine_structure(
            [lens], [0, 0], [np.zeros((0, 2))] * 2, [], [np.eye(4)] * 2, {}, None, known,
            rig if body else None,
        )  # fmt: skip


def test_choose_pairs_of_many_frames_compares_neighbours_of_all_cameras():
    count = 200
    frames = np.repeat(np.arange(count // 2), 2)
    names = [f"{'left' if i % 2 == 0 else 'right'}/{m}.png" for i, m in enumerate(frames)]
    features = [make_no_features() for _ in names]
    pairs = {tuple(p) for p in choose_pairs(names, features, PosesOptions(), frames)}
    for first in range(count - 8):
        near = {(first, second) for second in range(first + 1, count) if
                frames[second] - frames[first] <= 2}  # fmt: skip
        assert near <= pairs


# --- files and folders ----------------------------------------------------------------------------


@pytest.fixture
def rig_folder(tmp_path):
    """rig.json of two lenses, and a function that makes empty images."""
    lens = gsut.Camera("kannala_brandt", [60, 60, 40, 40, 0, 0, 0, 0], 80, 80)
    cameras = {}
    for name, pose in (("left", np.eye(4)), ("right", STEREO)):
        gsut.save_camera(lens, tmp_path / f"{name}.yaml")
        cameras[name] = {"file": f"{name}.yaml", "camera_from_reference": pose.tolist()}
    (tmp_path / "rig.json").write_text(json.dumps({"cameras": cameras}))

    def make(*names):
        for name in names:
            path = tmp_path / "images" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), np.zeros((80, 80, 3), np.uint8))
        return tmp_path / "images"

    return tmp_path, make


def test_find_rig_photographs_pairs_by_name_in_order_of_frames(rig_folder):
    folder, make = rig_folder
    images = make("left/10.png", "left/9.png", "right/9.jpg", "right/11.jpg", "left/mask.png")
    found = find_rig_photographs(images, read_rig(folder / "rig.json"))
    assert found.names == ["left/9.png", "right/9.jpg", "left/10.png", "right/11.jpg"]
    assert found.frames.tolist() == [0, 0, 1, 2]
    assert found.rig_cameras.tolist() == [0, 1, 0, 1]
    assert found.paired_by == "name"
    assert [mask is not None for mask in found.masks] == [True, False, True, False]


@pytest.mark.parametrize(
    ("names", "frames", "by"),
    [
        (["left/left1.png", "left/left2.png", "right/right2.png"], [0, 1, 1], "name"),
        (
            ["left/a9.png", "right/b107.png", "left/a10.png", "right/b108.png"],
            [0, 0, 1, 1],
            "order",
        ),
    ],
)
def test_find_rig_photographs_pairs_other_names_by_their_ends_or_in_order(
    rig_folder, names, frames, by
):
    folder, make = rig_folder
    found = find_rig_photographs(make(*names), read_rig(folder / "rig.json"))
    assert (found.names, found.frames.tolist(), found.paired_by) == (names, frames, by)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["left/1.png"], "no folder right .* folders there: left"),
        (["left/1.png", "right/1.png", "middle/1.png"], "no camera middle; it has left, right"),
        (["left/1.png", "left/2.png", "right/7.png"], r"numbers differ \(left 2, right 1\)"),
        (["left/1.png", "right/mask.png"], "right holds no images"),
        (["left/1.png", "left/1.jpg", "right/1.png"], "one image of a camera"),
    ],
)
def test_find_rig_photographs_refuses_folders_that_do_not_fit(rig_folder, names, message):
    folder, make = rig_folder
    images = make(*names)
    with pytest.raises(gsut.InputError, match=message):
        find_rig_photographs(images, read_rig(folder / "rig.json"))


def edited(folder, edit):
    values = json.loads((folder / "rig.json").read_text())
    values = edit(values) or values
    (folder / "rig.json").write_text(json.dumps(values))
    return folder / "rig.json"


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda v: v["cameras"]["right"].update(camera_from_reference=[0.1] + [0.0] * 5),
         "baseline, 0, sets no scale"),
        (lambda v: v["cameras"].pop("right") and None, "holds 1 camera"),
        (lambda v: v["cameras"]["right"].pop("camera_from_reference") and None, "is missing"),
        (lambda v: v["cameras"]["right"].update(camera_from_reference=[1, 2]), "six numbers"),
        (lambda v: v["cameras"]["right"].update(file="none.yaml"), "no lens file"),
        (lambda v: v["cameras"]["right"].pop("file") and None, "does not name its lens file"),
        (lambda v: v["cameras"]["right"].update(file=3), "does not name its lens file"),
        (lambda v: v["cameras"]["right"].update(shutter="down"), "down.* top_to_bottom"),
        (lambda v: v["cameras"]["right"].update(readout_seconds=0.02), 'needs "shutter"'),
        (lambda v: v["cameras"]["right"].update(shutter="top_to_bottom", readout_seconds=-1),
         "give seconds above 0"),
        (lambda v: [c.update(shutter="top_to_bottom") for c in v["cameras"].values()]
         and v["cameras"]["left"].update(readout_seconds=0.02), "all of them, or for none"),
        (lambda v: {"a": 1}, 'no object "cameras"'),
        (lambda v: v["cameras"]["left"].update(camera_from_reference=STRETCHED), "not a rotation"),
    ],
)  # fmt: skip
def test_read_rig_refuses_what_is_no_rig(rig_folder, edit, message):
    with pytest.raises(gsut.InputError, match=message):
        read_rig(edited(rig_folder[0], edit))


def test_write_rig_is_read_again(rig_folder):
    folder, _ = rig_folder
    rig = read_rig(folder / "rig.json")
    (folder / "out").mkdir()
    write_rig(rig, folder / "out" / "rig.json")
    again = read_rig(folder / "out" / "rig.json")
    assert again.names == rig.names
    assert again.cameras == rig.cameras
    change = np.abs(again.camera_from_reference - rig.camera_from_reference).max()
    assert change < tolerances.RIG_HELD  # rotations are made orthonormal once more


def test_read_rig_lens_null_is_to_be_estimated(rig_folder):
    folder, make = rig_folder
    rig = read_rig(edited(folder, lambda v: v["cameras"]["right"].update(file=None)))
    assert rig.unknown_lenses == [1] and rig.cameras[0] is not None
    found = find_rig_photographs(make("left/1.png", "left/2.png", "right/1.png"), rig)
    assert [camera is None for camera in found.cameras] == [False, True, False]
    ((name, images),) = [(group.name, group.images.tolist()) for group in found.groups]
    assert (name, images) == ("right", [1])
    write_rig(rig, folder / "again.json")
    assert read_rig(folder / "again.json").unknown_lenses == [1]
    assert read_rig(folder / "again.json").forget_lenses().unknown_lenses == [0, 1]


def test_read_rig_reads_what_calibrate_wrote_with_the_exact_lenses():
    report = ROOT / "calib" / "lenses" / "fisheye_stereo.report.json"
    rig = read_rig(report)
    assert rig.names == ("left", "right")
    assert [camera.model for camera in rig.cameras] == ["kannala_brandt"] * 2  # not the splined
    said = json.loads(report.read_text())["cameras"]["right"]["distance_to_reference"]
    assert rig.baseline == pytest.approx(said, abs=1e-6)  # the report has six digits


def test_read_rig_reads_a_camchain_of_kalibr(tmp_path):
    third = pose_of([0.0, -0.1, 0.0], [0.0, 0.2, 0.0])
    lines = []
    for number, step in enumerate((None, STEREO, third)):
        lines += [
            f"cam{number}:",
            "  camera_model: pinhole",
            "  distortion_model: equidistant",
            "  intrinsics: [300.0, 301.0, 320.0, 240.0]",
            f"  distortion_coeffs: [0.0{number}, 0.0, 0.0, 0.0]",
            "  resolution: [640, 480]",
        ]
        if step is not None:
            lines.append(f"  T_cn_cnm1: {step.tolist()}")
    path = tmp_path / "camchain.yaml"
    path.write_text("\n".join(lines) + "\n")
    rig = read_rig(path)
    assert rig.names == ("cam0", "cam1", "cam2")
    assert [c.params[4] for c in rig.cameras] == [0.0, 0.01, 0.02]
    np.testing.assert_allclose(rig.camera_from_reference[2], third @ STEREO, atol=1e-12)
    (tmp_path / "out").mkdir()
    write_rig(rig, tmp_path / "out" / "rig.json")  # names the camchain and the camera in it
    assert read_rig(tmp_path / "out" / "rig.json").cameras == rig.cameras
