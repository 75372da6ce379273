"""Training options: defaults, derived values, checks, JSON and command-line flags."""

import argparse
import dataclasses

import numpy as np
import pytest

from gsut import InputError
from gsut.run import TrainOptions
from gsut.run.options import (
    AUTO,
    PRESETS,
    add_option_flags,
    collect_given,
    fit_to_views,
    format_flag,
    get_info,
    is_from_preset,
    raise_degree,
)

FIELDS = dataclasses.fields(TrainOptions)


def parse(*words: str) -> TrainOptions:
    parser = argparse.ArgumentParser()
    add_option_flags(parser, TrainOptions)
    return TrainOptions(**collect_given(TrainOptions, parser.parse_args(words)))


def test_options_without_arguments_are_the_balanced_preset():
    options = TrainOptions()
    assert (options.steps, options.most_gaussians, options.sh_degree) == (2000, 200_000, 1)
    assert options.max_gaussians == AUTO
    balanced = dataclasses.replace(TrainOptions(preset="balanced"), preset=None)
    assert options == balanced


def test_presets_steps_are_fewer_for_few_views_and_given_ones_are_not():
    rows = [
        ("balanced", 25, 2000), ("balanced", 24, 1920), ("balanced", 10, 800),
        ("balanced", 2, 500), ("fast", 10, 500), ("best", 10, 2800), ("best", 60, 7000),
    ]  # fmt: skip
    for preset, views, steps in rows:
        options = fit_to_views(TrainOptions(preset=preset), views)
        assert options.steps == steps and is_from_preset(options, "steps")
        assert fit_to_views(options, views).steps == steps
        assert fit_to_views(TrainOptions(preset=preset, steps=3000), views).steps == 3000
    assert fit_to_views(TrainOptions(), 10) == TrainOptions(steps=800)
    again = TrainOptions.from_json(fit_to_views(TrainOptions(), 10).to_json())
    assert fit_to_views(again, 2) == again  # of a run that goes on


def test_a_small_cap_is_outgrown_in_fewer_of_a_presets_steps():
    small = TrainOptions(preset="fast", max_gaussians=5000)
    assert small.recipe.overgrowth > 1.0
    assert fit_to_views(small, 60).steps == 450
    assert fit_to_views(dataclasses.replace(small, steps=500), 60).steps == 500
    others = {"max_gaussians": 200_000}, {"steps": 200}, {"primitive": "triangle"}
    for other in (*others, {"strategy": "mini"}):
        assert dataclasses.replace(small, **other).recipe.overgrowth == 1.0


def test_harmonics_of_a_preset_may_be_higher_and_given_ones_stay():
    assert raise_degree(TrainOptions(), 3).sh_degree == 3
    assert raise_degree(TrainOptions(preset="best"), 1).sh_degree == 2
    assert raise_degree(TrainOptions(sh_degree=1), 3).sh_degree == 1
    both = raise_degree(fit_to_views(TrainOptions(), 10), 3)
    assert both == TrainOptions(steps=800, sh_degree=3) and both.list_words() == []
    again = TrainOptions.from_json(both.to_json())
    assert again.list_words() == ["--steps", "800", "--sh-degree", "3"]


def test_options_with_preset_keep_values_that_were_given():
    for preset, values in PRESETS.items():
        options = TrainOptions(preset=preset, steps=123)
        assert options.steps == 123
        assert options.max_gaussians == AUTO
        assert options.most_gaussians == values["max_gaussians"]
        assert TrainOptions(preset=preset, max_gaussians=77).most_gaussians == 77


@pytest.mark.parametrize(
    ("steps", "lr_means", "lr_sh_rest", "noise", "densify_every"),
    [
        (500, 2.6e-3, 1e-3, False, 50),
        (1000, 8e-4, 1e-3, False, 50),
        (2000, 4.8e-4, 5e-4, True, 100),
    ],
)
def test_recipe_at_its_own_steps_gives_the_measured_values(
    steps, lr_means, lr_sh_rest, noise, densify_every
):
    recipe = TrainOptions(steps=steps).recipe
    assert recipe.lr_means == lr_means
    assert recipe.lr_sh_rest == lr_sh_rest
    assert recipe.noise is noise
    assert recipe.densify_every == densify_every


def test_recipe_of_long_runs_decays_the_other_rates():
    assert TrainOptions(steps=1000).recipe.lr_final_factor == 1.0
    assert TrainOptions(steps=2000).recipe.lr_final_factor == 0.5
    assert 0.3 < TrainOptions(steps=4000).recipe.lr_final_factor < 0.5
    assert TrainOptions(steps=30_000).recipe.lr_final_factor == 0.3


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("steps", 0, "--steps must be >= 1 and <= 1e+07, found 0"),
        ("steps", 1.5, "--steps must be a whole number, found 1.5"),
        ("steps", True, "--steps must be a whole number, found True"),
        ("scale", 0.0, "--scale must be > 0 and <= 1, found 0.0"),
        ("strategy", "magic", "strategy must be one of mcmc, mini, found 'magic'"),
        ("preset", "slow", "--preset must be one of fast, balanced, best, found 'slow'"),
        ("background", (0, 0), "--background must be 3 numbers, found 2 values: (0, 0)"),
        ("background", (0, 0, 2), "--background must be >= 0 and <= 1, found 2"),
        ("robust", 1, "--robust must be true or false, found 1"),
        ("readout_time", float("nan"), "--readout-time must be > 0 and <= 1, found nan"),
        ("max_gaussians", "few", "--max-gaussians must be a whole number or auto, found 'few'"),
        ("seed", None, "--seed must be a whole number, found None"),
        ("test_names", "a.png", "--test-names must be a list of names, found 'a.png'"),
    ],
)
def test_options_with_a_bad_value_name_option_value_and_range(name, value, said):
    with pytest.raises(InputError) as caught:
        TrainOptions(**{name: value})
    assert said in str(caught.value)


def test_options_with_numpy_numbers_become_plain_ones():
    options = TrainOptions(steps=np.int64(7), scale=np.float32(0.5), background=[0, 1, 0])
    assert type(options.steps) is int
    assert type(options.scale) is float
    assert options.background == (0.0, 1.0, 0.0)


def test_json_round_trip_gives_equal_options():
    options = TrainOptions(
        preset="best", test_names=("a.png", "b.png"), readout_time=1 / 3, background=(0.1, 0.3, 0)
    )
    assert TrainOptions.from_json(options.to_json()) == options


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            '{"lr_means": 3}',
            "run/options.json: unknown option lr_means, as other versions of gsut write; leave it "
            "out of the file, or train again; known are preset, steps",
        ),
        ('{"steps": -3}', "run/options.json: --steps must be"),
        ('{"steps": 3', "run/options.json: not valid JSON"),
        ("[1]", "run/options.json: a JSON object"),
    ],
)
def test_json_that_is_wrong_says_file_and_reason(text, said):
    with pytest.raises(InputError) as caught:
        TrainOptions.from_json(text, source="run/options.json")
    assert said in str(caught.value)


def test_flags_set_the_options_they_name():
    options = parse(
        "--steps", "77", "--background", "1,0.5,0", "--test-names", "a.png,b.png",
    )  # fmt: skip
    assert options == TrainOptions(
        steps=77, background=(1, 0.5, 0), test_names=("a.png", "b.png"),
    )  # fmt: skip


def test_flags_that_are_absent_leave_the_defaults():
    assert parse() == TrainOptions()


@pytest.mark.parametrize("words", [("--steps", "many"), ("--background", "1,x,0")])
def test_flags_that_are_no_numbers_are_refused_in_the_same_words(words):
    with pytest.raises(InputError, match=f"^{words[0]} must be"):
        parse(*words)


def test_help_lists_every_option(capsys):
    from gsut.cli import main

    with pytest.raises(SystemExit):
        main(["train", "--help"])
    text = " ".join(capsys.readouterr().out.split())
    for field in FIELDS:
        info = get_info(field)
        assert (format_flag(field.name) in text) == (field.name in TrainOptions.FLAGS)
        assert info.help and (field.default is not None or info.none)
    assert text.count("default ") >= len(TrainOptions.FLAGS) == 21


def test_words_of_options_make_the_same_options():
    options = TrainOptions(steps=70, test_names=("a",), background=(0, 0, 1), robust=True)
    assert parse(*options.list_words()) == options
