"""Training options: defaults, derived values, checks, JSON and command-line flags."""

import argparse
import dataclasses
import re

import numpy as np
import pytest

from gsut import InputError
from gsut.cli import mesh
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
    show_every_option,
)

FIELDS = dataclasses.fields(TrainOptions)


def parse(*words: str) -> TrainOptions:
    parser = argparse.ArgumentParser()
    add_option_flags(parser, TrainOptions)
    return TrainOptions(**collect_given(TrainOptions, parser.parse_args(words)))


def test_options_without_arguments_are_the_balanced_preset():
    options = TrainOptions()
    assert (options.steps, options.most_gaussians, options.sh_degree) == (2000, 200_000, 1)
    assert options.max_gaussians == options.resolve().max_gaussians == AUTO
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
    resolved = fit_to_views(TrainOptions(), 10).resolve()
    assert resolved == TrainOptions(steps=800).resolve()
    assert fit_to_views(resolved, 2) == resolved  # of a run that goes on


def test_harmonics_of_a_preset_may_be_higher_and_given_ones_stay():
    assert raise_degree(TrainOptions(), 3).sh_degree == 3
    assert raise_degree(TrainOptions(preset="best"), 1).sh_degree == 2
    assert raise_degree(TrainOptions(sh_degree=1), 3).sh_degree == 1
    both = raise_degree(fit_to_views(TrainOptions(), 10), 3)
    assert both.resolve() == TrainOptions(steps=800, sh_degree=3).resolve()
    assert both.list_words() == [] and both.resolve().list_words() == [
        "--steps",
        "800",
        "--sh-degree",
        "3",
    ]


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
    options = TrainOptions(steps=steps).resolve()
    assert options.lr_means == lr_means
    assert options.lr_sh_rest == lr_sh_rest
    assert options.noise is noise
    assert options.densify_every == densify_every


def test_resolved_in_long_runs_decays_the_other_rates():
    assert TrainOptions(steps=1000).resolve().lr_final_factor == 1.0
    assert TrainOptions(steps=2000).resolve().lr_final_factor == 0.5
    assert 0.3 < TrainOptions(steps=4000).resolve().lr_final_factor < 0.5
    assert TrainOptions(steps=30_000).resolve().lr_final_factor == 0.3


def test_resolved_for_any_number_of_steps_leaves_only_what_depends_on_the_data():
    count = 0
    for steps in (1, 2, 9, 99, 700, 1001, 6999, 30_000):
        options = TrainOptions(steps=steps).resolve()
        empty = {f.name for f in FIELDS if getattr(options, f.name) is None}
        assert empty == {
            *("preset", "test_names", "init_count", "compact_at", "readout_time"),
            *("calibration_weights", "background", "motion_blur"),
        }
        assert options.resolve() == options
        count += 1
    assert count == 8


def test_resolved_with_given_values_keeps_them():
    given = {"lr_means": 1e-3, "noise": True, "coarse_to_fine": (0.0, 0.1), "densify_every": 7}
    options = TrainOptions(steps=100, **given).resolve()
    assert {name: getattr(options, name) for name in given} == given


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("steps", 0, "--steps must be >= 1 and <= 1e+07, found 0"),
        ("steps", 1.5, "--steps must be a whole number, found 1.5"),
        ("steps", True, "--steps must be a whole number, found True"),
        ("scale", 0.0, "--scale must be > 0 and <= 1, found 0.0"),
        ("lr_means", float("nan"), "--set lr_means must be >= 0 and <= 1, found nan"),
        ("init_opacity", 1.0, "--set init_opacity must be > 0 and < 1, found 1.0"),
        ("strategy", "magic", "--set strategy must be one of mcmc, mini, found 'magic'"),
        ("preset", "slow", "--preset must be one of fast, balanced, best, found 'slow'"),
        ("background", (0, 0), "--background must be 3 numbers, found 2 values: (0, 0)"),
        ("background", (0, 0, 2), "--background must be >= 0 and <= 1, found 2"),
        ("coarse_to_fine", "fine", "--set coarse_to_fine must be 2 numbers or auto, found 'fine'"),
        ("coarse_to_fine", (0.5, 0.2), "--set coarse_to_fine=0.5,0.2"),
        ("densify_from", 0.9, "--set densify_from=0.9 lies after densify_until=0.8"),
        ("noise", 1, "--set noise must be true or false, found 1"),
        ("seed", None, "--seed must be a whole number, found None"),
        ("test_names", "a.png", "--set test_names must be a list of names, found 'a.png'"),
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
    assert TrainOptions.from_json(options.resolve().to_json()) == options.resolve()


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
        "--steps", "77", "--set", "noise=false", "--set", "coarse_to_fine=0,0.25",
        "--background", "1,0.5,0", "--set", "test-names=a.png,b.png", "--set", "init=random",
        "--set", "lr_means=1e-3",
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


def test_help_lists_the_common_options_and_help_all_the_rest(capsys):
    from gsut.cli import main

    with pytest.raises(SystemExit):
        main(["train", "--help"])
    short = capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["train", "--help-all"])
    everything = " ".join(capsys.readouterr().out.split())
    listed = re.findall(r"^  (?:-\w, |-o RUN, )?(--[a-z-]+)", short, flags=re.MULTILINE)
    assert {format_flag(name) for name in TrainOptions.FLAGS} <= set(listed)
    assert len(listed) <= 36 and "lr_means" not in short
    for field in FIELDS:
        info = get_info(field)
        shown = format_flag(field.name) if field.name in TrainOptions.FLAGS else f"{field.name}="
        assert shown in everything
        assert info.help and (field.default is not None or info.none)
    assert everything.count("default ") >= len(FIELDS) > 30


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["dead_opacity=2"], "--set dead_opacity must be >= 0 and < 1, found 2.0"),
        (["lr_meanz=2"], "--set lr_meanz: no such option; gsut train --help-all lists them"),
        (["lr_means"], "--set takes NAME=VALUE"),
        (["noise=maybe"], "--set noise must be true or false, found 'maybe'"),
        (["order=beta"], "--set order must be one of distance, z, ray, found 'beta'"),
    ],
)
def test_set_with_a_wrong_name_or_value_is_refused(words, said, capsys):
    from gsut.cli import main

    assert main(["train", "DATA", "-o", "RUN", "--set", *words]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["mesh", "RUN", "-o", "a.ply", "--set", "parts=0"],
         "--set parts takes a whole number from 1 to 2147483647, found '0'"),
        (["mesh", "RUN", "-o", "a.ply", "--set", "open=maybe"], "--set open takes true or false"),
        (["mesh", "RUN", "-o", "a.ply", "--set", "depth=first"],
         "--set depth takes median, expected, strongest, found 'first'"),
        (["compact", "RUN", "-o", "b", "--set", "sed=1"], "--set sed: no such option; gsut"),
    ],
)  # fmt: skip
def test_set_of_rare_options_refuses_what_it_cannot_read(words, said, capsys):
    from gsut.cli import main

    assert main(words) == 2
    assert said in capsys.readouterr().err


def test_rare_options_have_defaults_and_take_what_is_set():
    parser = argparse.ArgumentParser(prog="gsut mesh")
    mesh.add_flags(parser)
    plain = parser.parse_args(["RUN", "-o", "a.ply"])
    assert (plain.depth, plain.support, plain.open, plain.max_side) == ("median", 2, None, 1024)
    words = [w for each in ("depth=expected", "support=0", "open=false") for w in ("--set", each)]
    given = parser.parse_args(["RUN", "-o", "a.ply", *words])
    assert (given.depth, given.support, given.open) == ("expected", 0, False)
    assert "support" not in parser.format_help()
    show_every_option(parser)
    assert "support=N" in parser.format_help()


def test_words_of_options_make_the_same_options():
    options = TrainOptions(steps=70, noise=False, lr_means=2e-3, background=(0, 0, 1), robust=True)
    assert parse(*options.list_words()) == options
