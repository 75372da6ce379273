"""The degree of the harmonics by two short trainings: glossy and matt scenes, when none is made."""

import dataclasses

import numpy as np
import pytest

import gsut
from gsut import TrainOptions
from gsut.data import Scene
from gsut.training import choose_degree, degree_trial
from random_scenes import arrays_of, pinhole
from rendered_dataset import look_from, truth

VIEWS = 48
NOISE = 10.0  # standard deviation of the sensor in grey levels: what harmonics could learn
SIZE = degree_trial.TrialSize(scale=0.5, gaussians=600)
OPTIONS = TrainOptions(background=(0.0, 0.0, 0.0))


@pytest.fixture
def small_trials(monkeypatch):
    """Trials of a size that fits the scenes of these tests."""
    monkeypatch.setattr(degree_trial, "_SIZES", (SIZE,))


def make_scene(dataset, rng, gloss: float) -> Scene:
    """Blobs whose harmonics of degrees 1 to 3 have the standard deviation `gloss`."""
    matt = truth(rng)
    bands = gloss * rng.normal(size=(len(matt), 15, 3))
    blobs = dataclasses.replace(matt, sh=np.concatenate([matt.sh, bands], axis=1))
    camera, views = pinhole(64), []
    for number in range(VIEWS):
        center = rng.normal(size=3) * [1.0, 0.5, 1.0]
        pose = look_from(4 * center / np.linalg.norm(center))
        image = gsut.render(blobs, camera, pose).image
        pixels = 255 * image + rng.normal(scale=NOISE, size=image.shape)
        views.append(
            gsut.data.View(
                f"{number:03d}", dataset / f"{number:03d}", 0, pose,
                pixels=np.clip(pixels, 0, 255).round().astype(np.uint8),
            )
        )  # fmt: skip
    colors = (255 * np.clip(0.5 + matt.sh[:, 0] * gsut.gaussians.SH_C0, 0, 1)).round()
    return Scene(
        dataset, (camera,), views, matt.means, colors.astype(np.uint8), range(VIEWS), (),
        np.zeros(3),
    )  # fmt: skip


@pytest.mark.parametrize(("gloss", "degree"), [(0.4, 3), (0.0, 1)])
def test_degree_of_a_made_scene_follows_its_gloss(small_trials, dataset, rng, gloss, degree):
    scene = make_scene(dataset, rng, gloss)
    chosen, because = choose_degree(scene, OPTIONS)
    assert chosen.sh_degree == degree
    assert because.startswith(f"harmonics of degree {degree}: in two short trainings, degree 3 ")
    assert "showed 6 photographs set aside " in because
    assert choose_degree(scene, OPTIONS) == (chosen, because)  # the same again


def test_degree_of_few_views_or_given_is_not_tried(small_trials, scene, monkeypatch):
    monkeypatch.setattr(degree_trial, "measure_gains", None)  # would raise
    assert len(scene.train_indices) == 10
    for preset, degree in ((None, 1), ("best", 2)):
        options = TrainOptions(preset=preset)
        chosen, because = choose_degree(scene, options)
        assert chosen.sh_degree == degree
        assert "10 photographs are too few" in because
    given = TrainOptions(sh_degree=0)
    assert choose_degree(scene, given) == (given, "")


def test_short_runs_take_the_high_degree_untried(small_trials, dataset, rng, monkeypatch):
    monkeypatch.setattr(degree_trial, "measure_gains", None)  # would raise
    scene = make_scene(dataset, rng, gloss=0.0)
    for preset in (None, "best"):
        chosen, because = choose_degree(scene, TrainOptions(preset=preset, steps=200))
        assert chosen.sh_degree == 3
        assert "200 steps are too few" in because


def test_short_trainings_take_at_most_an_eighth_of_the_run():
    rows = [(TrainOptions(), 0), (TrainOptions(preset="best"), 0), (TrainOptions(preset="fast"), 1)]
    for options, expected in rows:
        shares = [size.estimate_share(options) for size in degree_trial._SIZES]
        assert [share <= degree_trial._MOST_SHARE for share in shares].index(True) == expected


def test_short_trainings_leave_the_bits_of_the_long_one(scene, monkeypatch):
    monkeypatch.setattr(degree_trial, "_SIZES", (degree_trial.TrialSize(0.5, 50, steps=5),))
    monkeypatch.setattr(degree_trial, "_MOST_SHARE", 1e9)
    monkeypatch.setattr(degree_trial, "_FEWEST_VIEWS", 10)
    options = TrainOptions(steps=20, max_gaussians=100)
    tried = gsut.train(scene, options, progress=False)
    assert tried.metrics["sh_degree"] == tried.gaussians.sh_degree
    assert any("showed 2 photographs set aside" in note for note in tried.metrics["notes"])
    given = dataclasses.replace(options, sh_degree=tried.gaussians.sh_degree)
    assert arrays_of(gsut.train(scene, given, progress=False).gaussians) == arrays_of(
        tried.gaussians
    )
