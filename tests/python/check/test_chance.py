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
from gsut.check.agreement import Agreement, PairVerdict, find_agreement
from gsut.check.evidence import gather_evidence


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
    return PairVerdict((0, 1), np.eye(3), free, given, free_by_chance, given_by_chance)


@pytest.mark.parametrize(
    ("free", "given", "supports", "contradicts"),
    [(40, 40, True, False), (40, 5, False, True), (9, 2, False, False), (9, 10, True, False)],
)
def test_a_pair_is_evidence_only_beyond_chance(free, given, supports, contradicts):
    verdict = make_verdict(free, given)
    assert (verdict.supports, verdict.contradicts) == (supports, contradicts)


def test_few_contradictions_beside_support_are_repeated_things(hall):
    good, bad = make_verdict(40, 40), make_verdict(40, 5)
    assert not Agreement([good] * 2, [bad], []).is_contradiction
    assert not Agreement([], [bad] * 2, []).is_contradiction
    assert Agreement([], [bad] * 5, []).is_contradiction
    assert Agreement([good], [bad] * 8, []).is_contradiction


def test_shuffled_matches_say_nothing(hall, rng):
    evidence = gather_evidence(gsut.load_dataset(hall).move_origin((0.0, 0.0, 0.0)))
    right = find_agreement(evidence)
    pairs = [
        dataclasses.replace(p, pixels=np.stack([p.pixels[0], rng.permutation(p.pixels[1])]))
        for p in evidence.pairs
    ]
    wrong = find_agreement(gather_evidence(evidence.scene, pairs))
    print(len(right.supports), "support,", len(wrong.supports), len(wrong.contradicts), "shuffled")
    assert len(right.supports) > len(pairs) / 2 and not right.contradicts
    assert not wrong.supports and not wrong.contradicts


@pytest.mark.slow
def test_coefficients_in_another_order_are_named(tmp_path):
    """k3 before p1: written in the order of MATLAB's or a table's columns, read in OpenCV's."""
    lens = gsut.Camera("opencv5", [90, 90, 80, 80, -0.25, 0.06, 0.002, -0.001, -0.04], 160, 160)
    data = write_box_room(tmp_path / "room", lens, plan_walk(18))
    values = json.loads((data / "transforms.json").read_text())
    assert values["camera_model"] == "OPENCV"
    values["p1"], values["p2"], values["k3"] = values["k3"], values["p1"], values["p2"]
    (data / "transforms.json").write_text(json.dumps(values))
    said = [str(f) for f in check_scene(gsut.load_dataset(data)) if f.severity != "info"]
    assert any("k1 k2 k3 p1 p2, not k1 k2 p1 p2 k3" in text for text in said), said
