"""Evidence against poses counts beyond chance only: exact data stay quiet however thin they are."""

import dataclasses
import json

import numpy as np
import pytest

import gsut
from box_room import plan_walk, write_box_room
from changed_copy import copy_of, write
from demo_hall import write_hall
from gsut.check import check_scene
from gsut.check.chance import Judgement, PairVerdict, judge_pairs
from gsut.check.evidence import gather_evidence
from gsut.check.lens_fit import convert_to_normal
from gsut.check.others import Other, is_proved, is_sure


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    folder = tmp_path_factory.mktemp("chance")
    return write_hall(folder / "hall", views=20, test_views=2, size=160)


def thin(data, folder, step, phase):
    values = copy_of(data, folder)
    frames = sorted(values["frames"], key=lambda frame: frame["file_path"])
    values["frames"] = frames[phase::step]
    for key in ("train_filenames", "test_filenames", "val_filenames"):
        values.pop(key, None)
    return write(values, folder, with_points=False)


def test_thinned_exact_views_are_not_accused(hall, tmp_path):
    for step in (2, 3, 5):
        for phase in range(0, step, 2):
            scene = gsut.load_dataset(thin(hall, tmp_path / f"{step}{phase}", step, phase))
            said = [str(f) for f in check_scene(scene) if f.severity != "info"]
            assert [text for text in said if "photograph" in text or "contradict" in text] == []


def make_verdict(free, given, free_by_chance=5.0, given_by_chance=1.0):
    return PairVerdict(0, np.eye(3), free, given, free_by_chance, given_by_chance)


@pytest.mark.parametrize(
    ("free", "given", "supports", "contradicts"),
    [(40, 40, True, False), (40, 5, False, True), (9, 2, False, False), (9, 10, True, False)],
)
def test_a_pair_is_evidence_only_beyond_chance(free, given, supports, contradicts):
    verdict = make_verdict(free, given)
    assert (verdict.supports, verdict.contradicts) == (supports, contradicts)


def test_few_contradictions_beside_support_are_repeated_things(hall):
    good, bad = make_verdict(40, 40), make_verdict(40, 5)
    assert not Judgement([good] * 2, [bad], []).is_contradiction
    assert not Judgement([], [bad] * 2, []).is_contradiction
    assert Judgement([], [bad] * 5, []).is_contradiction
    assert Judgement([good], [bad] * 8, []).is_contradiction


@pytest.mark.parametrize(
    ("pairs", "cost", "proved"), [(2, 0.7, False), (12, 0.7, True), (2, 0.4, True)]
)
def test_a_reading_that_leaves_most_matches_open_needs_many_pairs(pairs, cost, proved, rng):
    other = Other(cost + 0.05 * rng.standard_normal(pairs), "with a turn", "turn it back", "poses")
    assert is_proved(other, np.full(pairs, 0.95)) == proved


@pytest.mark.parametrize(
    ("given", "sure"),
    [
        ([0.95] * 3, False), ([0.95] * 4, True), ([0.95] * 4 + [0.1], False),
        ([0.95] * 11 + [0.1], True), ([0.95] * 3 + [0.4] * 9, False),
    ],
)  # fmt: skip
def test_a_reading_that_repeated_things_could_explain_is_no_error(given, sure):
    other = Other(np.full(len(given), 0.4), "mirrored", "mirror them back", "poses")
    assert is_sure(other, np.array(given)) == sure
    assert is_sure(dataclasses.replace(other, cameras=[]), np.array(given))


def test_shuffled_matches_say_nothing(hall, rng):
    evidence = gather_evidence(gsut.load_dataset(hall).move_origin((0.0, 0.0, 0.0)))
    right = judge_pairs(evidence)
    pairs = [
        dataclasses.replace(p, pixels=np.stack([p.pixels[0], rng.permutation(p.pixels[1])]))
        for p in evidence.pairs
    ]
    wrong = judge_pairs(gather_evidence(evidence.scene, pairs))
    print(len(right.supports), "support,", len(wrong.supports), len(wrong.contradicts), "shuffled")
    assert len(right.supports) > len(pairs) / 2 and not right.contradicts
    assert not wrong.supports and not wrong.contradicts


def test_a_large_ratio_of_few_pairs_is_no_rare_one():
    assert convert_to_normal(np.array(9.0), 2) < 3
    assert abs(convert_to_normal(np.array(3.0), 10_000) - 3) < 0.01


@pytest.mark.slow
def test_coefficients_in_another_order_are_named(tmp_path):
    """k3 before p1: written in the order of MATLAB's or a table's columns, read in OpenCV's."""
    lens = gsut.Camera("opencv5", [90, 90, 80, 80, -0.25, 0.06, 0.002, -0.001, -0.04], 160, 160)
    data = write_box_room(tmp_path / "room", lens, plan_walk(18))
    values = json.loads((data / "transforms.json").read_text())
    assert values["camera_model"] == "OPENCV"
    values["p1"], values["p2"], values["k3"] = values["k3"], values["p1"], values["p2"]
    (data / "transforms.json").write_text(json.dumps(values))
    said = [str(f) for f in check_scene(gsut.load_dataset(data)) if f.severity == "error"]
    assert any("k1 k2 k3 p1 p2, not k1 k2 p1 p2 k3" in text for text in said), said
