"""The verdict of a training names what is wrong and the next command."""

import argparse
import shlex

import pytest

from gsut.run import BlockOptions, TrainOptions, Verdict
from gsut.run.options import add_option_flags, collect_given
from gsut.run.verdicts import judge_training

GOOD = {
    "psnr": 30.1, "psnr_train": 31.0, "psnr_color_corrected": 30.3, "psnr_min": 28.0,
    "worst_view": "a.png", "steps": 2000, "evaluated_on": "test views",
}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "level", "reason", "advice"),
    [
        ({}, "good", "", "gsut view run"),
        ({"psnr": 25.0}, "usable", "", "gsut train data -o run-2 --preset best"),
        ({"psnr": 15.0, "psnr_train": 16.0, "psnr_min": 12.0}, "poor", "wrong poses or a wrong",
         "gsut doctor data, then gsut train data -o run-2 --refine-poses"),
        ({"psnr": 15.0, "psnr_train": 16.0, "steps": 100, "psnr_min": 12.0}, "poor", "100 steps",
         "--preset best"),
        ({"psnr": 21.0, "psnr_train": 30.0, "psnr_min": 18.0}, "poor", "too few photographs",
         "photograph more"),
        ({"psnr": 25.0, "psnr_color_corrected": 29.0}, "usable", "exposure or white balance", ""),
        ({"psnr_min": 12.0}, "good", "a.png is far worse", ""),
        ({"psnr": None}, "usable", "", ""),
    ],
)  # fmt: skip
def test_verdict_of_a_training(changes, level, reason, advice):
    verdict = judge_training(GOOD | changes, "data", "run")
    print(verdict)
    assert verdict.level == level
    assert reason in "; ".join(verdict.reasons)
    assert advice in verdict.advice
    assert Verdict.from_dict(verdict.as_dict()) == verdict
    if changes.get("psnr", 30.0) is not None:
        assert "30 dB sharp" in verdict.what


def options_of(command, kind):
    parser = argparse.ArgumentParser()
    add_option_flags(parser, kind)
    return kind(**collect_given(kind, parser.parse_known_args(shlex.split(command))[0]))


@pytest.mark.parametrize(
    ("made", "again"),
    [
        ({}, {"preset": "best"}),
        ({"preset": "fast"}, {"preset": "best"}),
        ({"steps": 500, "lr_means": 1e-3, "max_gaussians": 20_000, "sh_degree": 0, "robust": True,
          "noise": True, "background": (0.0, 0.5, 1.0), "test_names": ("a b.png", "c.png")},
         {"preset": "best", "steps": None}),
        ({"preset": "best", "refine_lens": True, "test_every": 5}, {"steps": 14_000}),
    ],
)  # fmt: skip
@pytest.mark.parametrize("known", [lambda options: options, TrainOptions.resolve])
def test_next_command_keeps_the_options_of_the_run_but_makes_more_steps(made, again, known):
    options = known(TrainOptions(**made))
    advice = judge_training(GOOD | {"psnr": 25.0}, "data", "run", options).advice
    assert options_of(advice, TrainOptions) == TrainOptions(**made | again)


def test_next_command_divides_as_the_run_was_divided():
    division = BlockOptions("4", memory="2GB", workers=2)
    bad = GOOD | {"psnr": 15.0, "psnr_train": 16.0, "psnr_min": 12.0}
    for metrics in (GOOD | {"psnr": 25.0}, bad):
        advice = judge_training(metrics, "data", "run", None, division.list_words()).advice
        assert options_of(advice.partition(", then ")[2] or advice, BlockOptions) == division
    assert "--refine-poses" in advice
    assert BlockOptions("auto").list_words() == ["--blocks", "auto"]
