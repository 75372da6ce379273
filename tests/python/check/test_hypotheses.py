"""What poses and lenses may have been meant to be is named; exact data stay quiet."""

import dataclasses
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import gsut
from gsut.check import photographs
from gsut.check.agreement import find_far_views
from gsut.check.evidence import gather_evidence
from gsut.check.matches import ImagePair, choose_pairs
from gsut.check.photographs import check_photographs
from gsut.data.poses import OPENGL_FROM_OPENCV
from gsut.judge import HYPOTHESES, Dataset, list_signed_permutations
from gsut.judge.hypotheses import Variant, climb
from gsut.judge.lens_errors import LENS_ERRORS
from gsut.judge.path_errors import shift_frames

PARAMS = [165.0, 165.0, 129.5, 98.0, -0.3, 0.11, 1e-3, -1e-3, -0.02]
LENS = gsut.Camera("opencv5", PARAMS, 240, 180)
NOISE = 0.2  # pixels
POINTS = 600
MOMENTS = 16


def make_walk(count=24, bend=0.08):
    """Poses (count, 4, 4) world_from_camera of a walk forwards, which turns by radians a step."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    for k in range(1, count):
        turn = bend * np.array([0.25 * np.sin(k), np.cos(k / 4), 0.5 * np.cos(k)])
        step = gsut.exp_pose([0.05 * np.sin(k), 0.05 * np.cos(2 * k), 0.15, *turn])
        poses[k] = poses[k - 1] @ step
    return poses


def observe(poses, rng, readout=0.0):
    """Pixels (V, P, 2) of points through poses, a line each where read out; NaN: not seen."""
    points = rng.normal(size=(POINTS, 3))
    points *= rng.uniform(3.0, 8.0, (POINTS, 1)) / np.linalg.norm(points, axis=1, keepdims=True)
    along = (np.arange(MOMENTS) + 0.5) / MOMENTS - 0.5
    data = Dataset(poses[:, None], (LENS,), np.zeros(len(poses), int), np.eye(3),
                   [list(range(len(poses)))])  # fmt: skip
    table = shift_frames(data, readout * along).poses
    pixels = np.full((len(poses), POINTS, 2), np.nan)
    for view in range(len(poses)):
        moment = np.full(POINTS, MOMENTS // 2)
        for _ in range(6):
            pose = table[view, moment]
            seen = np.einsum("pji,pj->pi", pose[:, :3, :3], points - pose[:, :3, 3])
            found, valid = LENS.project(seen)
            line = MOMENTS * np.nan_to_num(found[:, 1]) / LENS.height
            moment = np.clip(line, 0, MOMENTS - 1).astype(int)
        inside = np.asarray(valid) & ((found > 0) & (found < [240, 180])).all(axis=1)
        pixels[view, inside] = found[inside] + NOISE * rng.normal(size=(inside.sum(), 2))
    return pixels


def make_scene(poses, lens=LENS):
    images = [np.zeros((lens.height, lens.width, 3), np.uint8)] * len(poses)
    return gsut.scene_from_arrays(images, lens, np.linalg.inv(poses), test_every=0)


def gather(poses, pixels, lens=LENS):
    """Evidence of matches beside given poses and a lens."""
    scene, pairs = make_scene(poses, lens), []
    for a, b in choose_pairs(scene):
        both = np.isfinite(pixels[[a, b]]).all(axis=(0, 2))
        if both.sum() >= 16:
            pairs.append(ImagePair(a, b, pixels[[a, b]][:, both][:, :24]))
    return gather_evidence(scene, pairs)


def say(poses, pixels, lens=LENS):
    said = check_photographs(make_scene(poses, lens), gather(poses, pixels, lens))
    return [each for each in said if each.severity != "info"]


def add_steps(poses, change):
    """Sums a path anew from its steps, each changed by a function of the step and its number."""
    new = poses.copy()
    for k in range(1, len(poses)):
        new[k] = new[k - 1] @ change(np.linalg.inv(poses[k - 1]) @ poses[k], k)
    return new


def scale_step(step, factor):
    moved = step.copy()
    moved[:3, 3] *= factor
    return moved


def reorder(pose):
    vector = cv2.Rodrigues(pose[:3, :3])[0].ravel()
    angle = np.linalg.norm(vector)
    x, y, z = np.sin(angle / 2) * vector / max(angle, 1e-12)
    q = np.array([x, y, z, np.cos(angle / 2)])  # x y z w, read as w x y z
    turn = 2 * np.arctan2(np.linalg.norm(q[1:]), q[0])
    other = pose.copy()
    other[:3, :3] = cv2.Rodrigues(turn * q[1:] / max(np.linalg.norm(q[1:]), 1e-12))[0]
    return other


TURN = gsut.exp_pose([0, 0, 0, 0, np.radians(15 / 23), 0])
TILT = gsut.exp_pose([0, 0, 0, 0.2, -0.15, 0.1])
# Changes of the poses, and the words of what is said.
POSES = {
    "inverted": (np.linalg.inv, "read as world-to-camera"),
    "OpenGL axes": (lambda m: m @ OPENGL_FROM_OPENCV, "with OpenGL camera axes"),
    "quaternions": (lambda m: np.array([reorder(pose) for pose in m]), "quaternions"),
    "mirrored": (lambda m: m * np.array([1, 1, 1, -1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1.0])
                 .reshape(4, 4), "positions mirrored"),
    "transposed": (lambda m: np.array([
        np.block([[pose[:3, :3].T, pose[:3, 3:]], [pose[3:]]]) for pose in m]), "transposed"),
    "body": (lambda m: m @ np.linalg.inv(TILT), "a body's on which"),
    "frames": (lambda m: m[np.minimum(np.arange(len(m)) + 2, len(m) - 1)], "2 frames"),
    "heading": (lambda m: add_steps(m, lambda step, _: TURN @ step), "accumulate"),
    "heading of a part": (
        lambda m: add_steps(m, lambda step, k: TURN @ step if k < 17 else step), "accumulate",
    ),
    "scale": (lambda m: add_steps(m, lambda step, k: scale_step(step, 1 + k / 6)), "drift by"),
    "half the scale": (
        lambda m: add_steps(m, lambda step, k: scale_step(step, 1.5 if k > 12 else 1.0)),
        "change by a factor of",
    ),
    "another scene": (lambda m: m[::-1] @ TILT @ TILT @ m, "do not agree"),
    "one wrong": (lambda m: np.concatenate([m[:9], m[9:10] @ TILT @ TILT, m[10:]]),
                  "do not agree: 000009 contradict"),
}  # fmt: skip
# Lenses given instead of the right one, and what is said.
LENSES = {
    "order": ([*PARAMS[:6], *np.array(PARAMS)[[8, 6, 7]]], "in the order k1 k2 k3 p1 p2"),
    "focal length": ([170.0, 170.0, *PARAMS[2:]], "a focal length times 0.9"),
    "centre": ([*PARAMS[:2], 119.5, 95.0, *PARAMS[4:]], "cx +10"),
    "size": ([2 * v for v in PARAMS[:4]] + PARAMS[4:], "images of another size"),
    "sign": ([*PARAMS[:4], *[-v for v in PARAMS[4:]]], "of the other sign"),
}


@pytest.fixture(autouse=True)
def one_shuffle(monkeypatch):
    """What chance explains is another test's subject (test_chance.py): one shuffle will do here."""
    monkeypatch.setattr("gsut.check.agreement._SHUFFLES", 1)


@pytest.fixture(scope="module")
def walk():
    poses = make_walk()
    return poses, observe(poses, np.random.default_rng(0))


def test_exact_poses_and_lens_are_not_accused(walk, rng):
    assert say(*walk) == []
    for readout, poses in ((0.0, make_walk(7)), (0.0, np.tile(np.eye(4), (9, 1, 1)))):
        assert say(poses, observe(poses, rng, readout)) == []


def test_one_turned_pose_of_a_long_walk_is_named(rng):
    poses, view = make_walk(48), 20
    pixels = observe(poses, rng)
    turned = poses.copy()
    turned[view] = turned[view] @ gsut.exp_pose([0, 0, 0, 0, np.radians(30), 0])
    (said,) = say(turned, pixels)
    assert "000020 contradict" in said.what, said


def test_three_views_of_rooms_that_look_alike_are_not_accused(rng, monkeypatch):
    """One pair may agree with its poses, or better with a crop, where two show another room."""
    poses = make_walk(3)
    other, backwards = poses.copy(), poses.copy()
    other[0] = other[0] @ gsut.exp_pose([0.5, 0.3, 0, 0, 0, 0])
    backwards[:, :3, 3] *= -1  # the next window of a row is taken for each
    for seen in (other, backwards):
        assert say(poses, observe(seen, rng)) == []
    scores = {"given": np.array([-0.3, 0.1, 3.7]), "cropped": np.array([-0.4, 0.0, 5.1])}
    crop = SimpleNamespace(is_gross=False, is_everywhere=False, free=2)
    monkeypatch.setattr(photographs, "prefer", lambda *_: SimpleNamespace(is_rival=True))
    monkeypatch.setattr(
        photographs, "find_best_variants", lambda *_: [(crop, Variant("", "", "cropped"))]
    )
    for shares, is_found in (([0.12, 0.18, 0.97], False), ([0.12, 0.97, 0.97], True)):
        evidence = SimpleNamespace(
            given="given", score=scores.get, make_structure=lambda *_: None, matches=None,
            best_score=5.0, sample=SimpleNamespace(score=None),
            find_shares=lambda _, own=shares: np.array(own),
        )  # fmt: skip
        monkeypatch.setattr(photographs, "HYPOTHESES", (crop,))
        assert (photographs.find_explanation(evidence) is not None) == is_found


@pytest.mark.parametrize("name", POSES)
def test_poses_that_were_misread_are_named(name, walk):
    change, words = POSES[name]
    poses, pixels = walk
    (said,) = say(change(poses), pixels)
    assert words in said.what and said.subject == "poses" and said.advice, said


def test_slight_turns_of_one_half_of_a_path_are_no_drift_of_all(walk):
    poses, pixels = walk
    slight = gsut.exp_pose([0, 0, 0, 0, np.radians(3 / 23), 0])
    assert say(add_steps(poses, lambda step, k: slight @ step if k < 12 else step), pixels) == []


@pytest.mark.parametrize("name", LENSES)
def test_lens_that_was_misread_is_named(name, walk):
    params, words = LENSES[name]
    (said,) = say(*walk, gsut.Camera("opencv5", params, 240, 180))
    assert words in said.what and said.subject == "lens", said


@pytest.mark.parametrize("readout", [0.4, -0.3])
def test_rolling_shutter_taken_for_a_global_one_is_named(readout, rng):
    poses = make_walk()
    (said,) = say(poses, observe(poses, rng, readout))
    way = "first to the last" if readout > 0 else "last to the first"
    assert "a rolling shutter" in said.what and way in said.what, said


def test_far_cameras_are_accused_unless_photographs_support_them(rng):
    poses = np.tile(np.eye(4), (12, 1, 1))
    poses[:, 0, 3] = 0.1 * np.arange(12) + 2.0 * (np.arange(12) > 10)
    poses[:, 1, 3] = 0.1 * np.sin(np.arange(12))
    pixels = observe(poses, rng)
    assert find_far_views(make_scene(poses))[0] == [11]
    assert say(poses, pixels) == []
    wrong = poses.copy()
    wrong[[3, 11], :3, 3] += [[0.0, 30.0, 20.0], [-25.0, 10.0, 40.0]]
    said = " ".join(each.what for each in say(wrong, pixels))
    assert "000003, 000011 stand farther from all other cameras" in said


def test_lenses_exchanged_between_cameras_are_named(walk):
    poses, pixels = walk
    other = gsut.Camera("opencv5", [150.0, 150.0, *PARAMS[2:]], 240, 180)
    evidence = gather(poses, pixels)
    given = dataclasses.replace(evidence.given, cameras=(other, LENS))
    wrong = dataclasses.replace(evidence, given=given)
    (said,) = [each for each in check_photographs(wrong.scene, wrong) if each.severity != "info"]
    assert "0 and 1 exchanged" in said.what, said


def test_lens_hypotheses_of_a_panorama_suppose_nothing():
    panorama = gsut.Camera("equirectangular", [], 320, 160)
    poses = make_walk()
    data = Dataset(poses[:, None], (panorama,), np.zeros(len(poses), int), np.eye(3),
                   [list(range(len(poses)))])  # fmt: skip
    assert len(LENS_ERRORS) >= 10
    for hypothesis in LENS_ERRORS:
        assert not list(hypothesis.suppose(data, lambda data: np.zeros(1)))


def test_each_hypothesis_has_a_sentence_and_a_cure():
    for row in HYPOTHESES:
        assert row.sentence and row.cure and row.subject in ("poses", "lens")
    assert len({row.suppose for row in HYPOTHESES}) == len(HYPOTHESES) >= 20
    assert len(list(list_signed_permutations())) == 48


def test_climb_finds_the_best_numbers():
    def rate(x):
        return -np.abs(x - [0.7, -0.2])

    found = climb(lambda x: x, rate, [[0.0, 0.0], [2.0, 2.0]], [0.5, 0.5])
    np.testing.assert_allclose(found, [0.7, -0.2], atol=0.04)
