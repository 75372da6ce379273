"""The number of Gaussians that a run chooses by predicting views set aside."""

import json

import numpy as np
import pytest

import gsut
from gsut import TrainOptions
from gsut.run import PRESETS
from gsut.training import Complexity, choose_complexity, complexity
from random_scenes import arrays_of
from rendered_dataset import write_dataset


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("complexity") / "data"
    return gsut.load_dataset(write_dataset(folder, np.random.default_rng(20260821)))


@pytest.fixture
def small(monkeypatch):
    """Pilots and runs of a few steps and Gaussians."""
    monkeypatch.setitem(PRESETS["balanced"], "max_gaussians", 600)
    for name, value in (("_FEWEST_STEPS", 40), ("_STEPS", 12), ("_LEAST", 60)):
        monkeypatch.setattr(complexity, name, value)


def predict_from(monkeypatch, table):
    """Pilots that predict as a table {Gaussians: dB} says; returns what they were given."""
    given = []

    def predict(scene, options, on_progress):
        given.append((scene, options))
        return table[options.max_gaussians * 4]

    monkeypatch.setattr(complexity, "_predict", predict)
    return given


@pytest.mark.parametrize(
    ("table", "chosen", "tried"),
    [
        ({200_000: 30.0, 66_668: 29.0}, 200_000, 2),
        ({200_000: 30.0, 66_668: 30.1}, 200_000, 2),  # no clear gain
        ({200_000: 18.0, 66_668: 19.0, 22_224: 18.5}, 66_668, 3),
        ({200_000: 10.0, 66_668: 11.0, 22_224: 12.0, 7_408: 13.0}, 7_408, 4),  # and no further
    ],
)
def test_choice_goes_down_while_fewer_predict_better(scene, monkeypatch, table, chosen, tried):
    given = predict_from(monkeypatch, table)
    found = choose_complexity(scene.centred, TrainOptions().resolved())
    # Pilots have a quarter of the pixels, and of the Gaussians, rounded.
    assert found.max_gaussians == pytest.approx(chosen, abs=2)
    numbers = [row["max_gaussians"] for row in found.pilots]
    assert numbers == pytest.approx(list(table)[:tried], abs=2)
    assert Complexity.from_dict(json.loads(json.dumps(found.as_dict()))) == found
    assert len(given) == tried


def test_pilots_see_neither_views_set_aside_nor_test_views(scene, monkeypatch):
    given = predict_from(monkeypatch, {200_000: 30.0, 66_668: 29.0})
    found = choose_complexity(scene.centred, TrainOptions().resolved())
    names = [view.name for view in scene.views]
    for pilot, options in given:
        assert [names[i] for i in pilot.test_indices] == list(found.aside)
        assert set(pilot.train_indices) | set(pilot.test_indices) == set(scene.train_indices)
        assert not set(pilot.train_indices) & set(pilot.test_indices)
        assert options.steps == 300
        assert (
            options
            == TrainOptions(
                steps=300, max_gaussians=options.max_gaussians, eval_every=30
            ).resolved()
        )


@pytest.mark.parametrize(
    ("options", "most"),
    [({"max_gaussians": 500}, 500), ({"preset": "fast"}, 50_000), ({"steps": 999}, 200_000)],
)
def test_nothing_is_tried_where_the_number_is_given_or_the_run_is_short(
    scene, monkeypatch, options, most
):
    given = predict_from(monkeypatch, {})
    assert choose_complexity(scene, TrainOptions(**options).resolved()) == Complexity(most)
    few = scene.replace(train_indices=scene.train_indices[:3])
    assert choose_complexity(few, TrainOptions().resolved()) == Complexity(200_000)
    monkeypatch.setattr(complexity, "_MOST_VIEWS", len(scene.train_indices) - 1)
    assert choose_complexity(scene, TrainOptions().resolved()) == Complexity(200_000)
    assert given == []


def test_training_chooses_trains_on_all_views_and_resumes_to_the_same_bits(scene, tmp_path, small):
    options = TrainOptions(steps=40, checkpoint_every=10, eval_every=0)
    whole = gsut.train(scene, options, out=tmp_path / "a", progress=False)
    found = whole.metrics["complexity"]
    assert len(found["pilots"]) >= 2
    assert len(whole.gaussians) == found["max_gaussians"] <= 600
    assert any("training views set aside" in note for note in whole.metrics["notes"])
    assert json.loads((tmp_path / "a" / "complexity.json").read_text()) == found
    fixed = TrainOptions(steps=40, max_gaussians=found["max_gaussians"])
    same = gsut.train(scene, fixed, progress=False)
    assert arrays_of(same.gaussians) == arrays_of(whole.gaussians)
    # Stopped half-way and resumed.
    stop = {"watch": lambda loop, row: loop.step < 20, "progress": False}
    gsut.train(scene, options, out=tmp_path / "b", **stop)
    (tmp_path / "b" / "metrics.json").unlink()
    again = gsut.train(scene, options, out=tmp_path / "b", resume=True, progress=False)
    assert arrays_of(again.gaussians) == arrays_of(whole.gaussians)
