"""Training options: defaults, derived values, checks, JSON and command-line flags."""

import argparse
import dataclasses
import re

import numpy as np
import pytest

from gsut import InputError
from gsut.run.fitted import for_degree, for_views, is_open
from gsut.run.option_fields import add_option_flags, flag_name, given_options, option_info
from gsut.run.options import AUTO, COMMON_OPTIONS, PRESETS, TrainOptions

FIELDS = dataclasses.fields(TrainOptions)


def parse(*words: str) -> TrainOptions:
    parser = argparse.ArgumentParser()
    add_option_flags(parser, TrainOptions)
    return TrainOptions(**given_options(TrainOptions, parser.parse_args(words)))


def test_options_without_arguments_are_the_balanced_preset():
    options = TrainOptions()
    assert (options.steps, options.most_gaussians, options.sh_degree) == (2000, 200_000, 1)
    assert options.max_gaussians == options.resolved().max_gaussians == AUTO
    balanced = dataclasses.replace(TrainOptions(preset="balanced"), preset=None)
    assert options == balanced


def test_presets_steps_are_fewer_for_few_views_and_given_ones_are_not():
    rows = [
        ("balanced", 25, 2000), ("balanced", 24, 1920), ("balanced", 10, 800),
        ("balanced", 2, 500), ("fast", 10, 500), ("best", 10, 2800), ("best", 60, 7000),
    ]  # fmt: skip
    for preset, views, steps in rows:
        options = for_views(TrainOptions(preset=preset), views)
        assert options.steps == steps and is_open(options, "steps")
        assert for_views(options, views).steps == steps
        assert for_views(TrainOptions(preset=preset, steps=3000), views).steps == 3000
    resolved = for_views(TrainOptions(), 10).resolved()
    assert resolved == TrainOptions(steps=800).resolved()
    assert for_views(resolved, 2) == resolved  # of a run that goes on


def test_harmonics_of_a_preset_may_be_higher_and_given_ones_stay():
    assert for_degree(TrainOptions(), 3).sh_degree == 3
    assert for_degree(TrainOptions(preset="best"), 1).sh_degree == 2
    assert for_degree(TrainOptions(sh_degree=1), 3).sh_degree == 1
    both = for_degree(for_views(TrainOptions(), 10), 3)
    assert both.resolved() == TrainOptions(steps=800, sh_degree=3).resolved()
    assert both.words() == [] and both.resolved().words() == ["--steps", "800", "--sh-degree", "3"]


def test_options_with_preset_keep_values_that_were_given():
    count = 0
    for preset, values in PRESETS.items():
        options = TrainOptions(preset=preset, steps=123)
        assert options.steps == 123
        assert options.max_gaussians == AUTO
        assert options.most_gaussians == values["max_gaussians"]
        assert TrainOptions(preset=preset, max_gaussians=77).most_gaussians == 77
        count += 1
    assert count == 3


@pytest.mark.parametrize(
    ("steps", "lr_means", "lr_sh_rest", "noise", "densify_every"),
    [
        (500, 2.6e-3, 1e-3, False, 50),
        (1000, 8e-4, 1e-3, False, 50),
        (2000, 4.8e-4, 5e-4, True, 100),
    ],
)
def test_resolved_at_the_recipes_steps_gives_the_measured_values(
    steps, lr_means, lr_sh_rest, noise, densify_every
):
    options = TrainOptions(steps=steps).resolved()
    assert options.lr_means == lr_means
    assert options.lr_sh_rest == lr_sh_rest
    assert options.noise is noise
    assert options.densify_every == densify_every


def test_resolved_in_long_runs_decays_the_other_rates():
    assert TrainOptions(steps=1000).resolved().lr_final_factor == 1.0
    assert TrainOptions(steps=2000).resolved().lr_final_factor == 0.5
    assert 0.3 < TrainOptions(steps=4000).resolved().lr_final_factor < 0.5
    assert TrainOptions(steps=30_000).resolved().lr_final_factor == 0.3


def test_resolved_for_any_number_of_steps_leaves_only_what_depends_on_the_data():
    count = 0
    for steps in (1, 2, 9, 99, 700, 1001, 6999, 30_000):
        options = TrainOptions(steps=steps).resolved()
        empty = {f.name for f in FIELDS if getattr(options, f.name) is None}
        assert empty == {
            *("preset", "test_names", "init_count", "compact_at", "readout_time"),
            *("calibration_weights", "background", "motion_blur"),
        }
        assert options.resolved() == options
        count += 1
    assert count == 8


def test_resolved_with_given_values_keeps_them():
    given = {"lr_means": 1e-3, "noise": True, "coarse_to_fine": (0.0, 0.1), "densify_every": 7}
    options = TrainOptions(steps=100, **given).resolved()
    assert {name: getattr(options, name) for name in given} == given


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("steps", 0, "--steps must be >= 1 and <= 1e+07, found 0"),
        ("steps", 1.5, "--steps must be a whole number, found 1.5"),
        ("steps", True, "--steps must be a whole number, found True"),
        ("scale", 0.0, "--scale must be > 0 and <= 1, found 0.0"),
        ("lr_means", float("nan"), "--lr-means must be >= 0 and <= 1, found nan"),
        ("init_opacity", 1.0, "--init-opacity must be > 0 and < 1, found 1.0"),
        ("strategy", "magic", "--strategy must be one of mcmc, adaptive, mini, found 'magic'"),
        ("preset", "slow", "--preset must be one of fast, balanced, best, found 'slow'"),
        ("background", (0, 0), "--background must be 3 numbers, found 2 values: (0, 0)"),
        ("background", (0, 0, 2), "--background must be >= 0 and <= 1, found 2"),
        ("coarse_to_fine", "fine", "--coarse-to-fine must be 2 numbers or auto, found 'fine'"),
        ("coarse_to_fine", (0.5, 0.2), "--coarse-to-fine 0.5,0.2"),
        ("densify_from", 0.9, "--densify-from 0.9 lies after --densify-until 0.8"),
        ("noise", 1, "--noise must be true or false, found 1"),
        ("seed", None, "--seed must be a whole number, found None"),
        ("test_names", "a.png", "--test-names must be a list of names, found 'a.png'"),
        ("init_count", 300_000, "more than --max-gaussians 200000"),
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
        preset="best", test_names=("a.png", "b.png"), lr_means=1e-3 / 3, coarse_to_fine=(0.1, 0.3)
    )
    assert TrainOptions.from_json(options.to_json()) == options
    assert TrainOptions.from_json(options.resolved().to_json()) == options.resolved()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"stepz": 3}', "run/options.json: unknown option stepz; known are preset, steps"),
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
        "--steps", "77", "--no-noise", "--coarse-to-fine", "0,0.25", "--background", "1,0.5,0",
        "--test-names", "a.png,b.png", "--init", "random", "--lr-means", "1e-3",
    )  # fmt: skip
    assert options == TrainOptions(
        steps=77, noise=False, coarse_to_fine=(0, 0.25), background=(1, 0.5, 0),
        test_names=("a.png", "b.png"), init="random", lr_means=1e-3,
    )  # fmt: skip


def test_flags_that_are_absent_leave_the_defaults():
    assert parse() == TrainOptions()


@pytest.mark.parametrize("words", [("--steps", "many"), ("--background", "1,x,0")])
def test_flags_that_are_no_numbers_are_refused_in_the_same_words(words):
    with pytest.raises(InputError, match=f"^{words[0]} must be"):
        parse(*words)


def test_help_lists_a_dozen_options_and_help_all_the_rest(capsys):
    from gsut.cli import main

    with pytest.raises(SystemExit):
        main(["train", "--help"])
    short = capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["train", "--help", "all"])
    everything = capsys.readouterr().out
    flags = [flag_name(field.name) for field in dataclasses.fields(TrainOptions)]
    listed = re.findall(r"^  (--[a-z-]+)", short, flags=re.MULTILINE)
    assert set(listed) & set(flags) == {flag_name(name) for name in COMMON_OPTIONS}
    assert len(COMMON_OPTIONS) <= 13
    assert all(flag in everything for flag in flags)
    assert main(["train", "DATA", "-o", "RUN", "--dead-opacity", "2"]) == 2  # hidden, not gone
    assert "--dead-opacity must be" in capsys.readouterr().err


def test_help_names_every_option_with_its_default():
    parser = argparse.ArgumentParser()
    add_option_flags(parser, TrainOptions)
    text = " ".join(parser.format_help().split())
    for field in FIELDS:
        assert flag_name(field.name) in text
        info = option_info(field)
        assert info.help and (field.default is not None or info.none)
    assert text.count("default ") >= len(FIELDS) > 30
