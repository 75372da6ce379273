"""The number of Gaussians that a run may have, by the count of photographs."""

import gsut
from gsut import TrainOptions
from gsut.run.options import PRESETS, fit_to_views, presets
from gsut.training.first import choose_number, complexity
from random_scenes import arrays_of


def chosen_with(scene, monkeypatch, per_view, **options):
    monkeypatch.setattr(complexity, "_PER_VIEW", per_view)
    return choose_number(scene, TrainOptions(**options))


def test_number_grows_with_photographs_up_to_the_presets(scene, monkeypatch):
    views = len(scene.train_indices)
    found, said = chosen_with(scene, monkeypatch, 1000)
    assert found == 1000 * views
    words = f"{views} photographs: at most {1000 * views:,} Gaussians of degree 1, 1,000 each: "
    assert said == [f"{words}more would only memorize them"]
    half = scene.replace(train_indices=scene.train_indices[: views // 2])
    assert chosen_with(half, monkeypatch, 1000)[0] == 1000 * (views // 2)
    many, said = chosen_with(scene, monkeypatch, 10**6)
    assert (many, said) == (200_000, [])


def test_a_number_that_is_given_stays_and_nothing_is_said(scene, monkeypatch):
    found, said = chosen_with(scene, monkeypatch, 1, max_gaussians=500, sh_degree=2)
    assert (found, said) == (500, [])


def test_training_takes_the_number_says_so_and_has_the_bits_of_one_that_is_given(
    scene, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(complexity, "_PER_VIEW", 20)
    most = 20 * len(scene.train_indices)
    options = TrainOptions(steps=20)
    whole = gsut.train(scene, options, out=tmp_path / "a", progress=True)
    assert len(whole.gaussians) == most
    line = f"{len(scene.train_indices)} photographs: at most {most} Gaussians of degree 1, 20 each"
    assert any(note.startswith(line) for note in whole.metrics["notes"])
    assert line in capsys.readouterr().err
    assert line in (tmp_path / "a" / "report.html").read_text()
    given = gsut.train(scene, TrainOptions(steps=20, max_gaussians=most), progress=False)
    assert arrays_of(given.gaussians) == arrays_of(whole.gaussians)
    assert not any("photographs: at most" in note for note in given.metrics["notes"])


def test_training_on_few_photographs_takes_fewer_steps_and_says_so(scene, monkeypatch, capsys):
    preset = {"steps": 50, "max_gaussians": 100, "sh_degree": 0, "max_side": 1600}
    monkeypatch.setitem(PRESETS, "fast", preset)
    monkeypatch.setattr(presets, "_LEAST_STEPS", 5)
    views = len(scene.train_indices)
    result = gsut.train(scene, TrainOptions(preset="fast"), progress=True)
    assert result.metrics["steps"] == 2 * views
    line = f"{views} photographs: {2 * views} steps, for which the preset has 50"
    assert line in capsys.readouterr().err
    assert any(note.startswith(line) for note in result.metrics["notes"])
    given = gsut.train(scene, TrainOptions(steps=20, max_gaussians=100), progress=False)
    assert given.metrics["steps"] == 20
    assert not any("steps, for which" in note for note in given.metrics["notes"])


def test_steps_that_growth_beyond_a_small_cap_replaces_are_reported(scene):
    options = fit_to_views(TrainOptions(preset="fast", max_gaussians=5000), 60)
    _, (line,) = choose_number(scene, options)
    assert "at most 5,000 Gaussians: 450 steps, for which the preset has 500; they outgrow" in line
