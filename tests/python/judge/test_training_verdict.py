"""The verdict of a training names what is wrong and the next command."""

import argparse
import dataclasses
import shlex

import pytest

from gsut.check import Finding
from gsut.cli._flags import keep_findings
from gsut.judge.checks import judge_training
from gsut.run import BlockOptions, RunFolder, SceneOptions, TrainOptions, Verdict
from gsut.run.options import add_option_flags, collect_given
from gsut.training.record.results import find_accused

GOOD = {
    "psnr": 30.1, "psnr_color_corrected": 30.3, "detail_median": 0.9, "detail_min": 0.85,
    "least_detailed": "a.png", "detail_train": 0.95, "evaluated_on": "test views",
}  # fmt: skip
SOFT = {"psnr": 25.0, "detail_median": 0.6, "detail_min": 0.5, "detail_train": 0.65}


@pytest.mark.parametrize(
    ("changes", "level", "reason", "advice"),
    [
        ({}, "good", "", "gsut view run"),
        (SOFT, "usable", "steps and Gaussians are few", "gsut train data -o run-2 --preset best"),
        ({**SOFT, "detail_median": 0.2}, "poor", "far sharper (65 %", "photograph more"),
        (
            {**SOFT, "detail_median": 0.2, "detail_train": 0.35},
            "poor", "steps and Gaussians are few", "--preset best",
        ),
        ({**SOFT, "detail_shifted_median": 0.7}, "usable", "poses or the lens are wrong", "doctor"),
        ({**SOFT, "detail_train": 0.9, "detail_shifted_median": 0.61}, "usable", "too few", ""),
        ({**SOFT, "detail_train": 0.9}, "usable", "too few photographs", "photograph more"),
        (
            {**SOFT, "detail_train": 0.9, "moving_train": 0.002},
            "usable", "too few photographs, or something moved", "while nothing moves",
        ),
        (
            {**SOFT, "moving_train": 0.002, "patch_train": 0.06, "detail_outside_train": 0.92},
            "usable", "something moved in a patch of 6 % of the pictures, and of the rest 92 %",
            "nothing moves",
        ),
        ({**SOFT, "moving_train": 0.03}, "usable", "something moved, and of the", "nothing moves"),
        ({**SOFT, "patch_train": 0.06}, "usable", "steps and Gaussians are few", "--preset best"),
        (
            {"detail_median": 0.79, "detail_train": 0.81},
            "usable", "steps and Gaussians are few", "--preset best",
        ),
        ({"psnr": 18.0}, "good", "", "gsut view run"),
        ({"psnr": 25.0, "psnr_color_corrected": 29.0}, "good", "brightness or colours", ""),
        ({"detail_min": 0.3}, "good", "a.png is worst, with 30 %", ""),
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
        assert "% of the detail is right" in verdict.what


@pytest.mark.parametrize(
    ("subject", "are", "advice"),
    [("lens", "lens is", "mend it; then gsut train data -o run-2 --preset best"),
     ("poses", "poses are", "gsut doctor data, then gsut train data -o run-2 --preset best "
      "--refine-poses")],
)  # fmt: skip
@pytest.mark.parametrize("changes", [{"detail_shifted_median": 0.7}, {"steps": 1}])
def test_verdict_names_what_the_check_before_accuses(subject, are, advice, changes):
    accused = {"subject": subject, "what": "matches fit others", "advice": "mend it"}
    options = TrainOptions(preset="best")
    verdict = judge_training(GOOD | SOFT | changes, "data", "run", options, (), accused)
    assert f"the {are} wrong: matches fit others" in verdict.reasons[0]
    assert verdict.advice == advice
    few = judge_training(GOOD | SOFT, "data", "run", accused=accused)
    assert "steps and Gaussians are few" in few.reasons[0]


TRACKS = {"refined": 9, "turned_degrees": 2.04, "moved": 0.081, "error_px": 0.21}


@pytest.mark.parametrize(
    ("asked", "subject", "tracks", "reason"),
    [
        ({"refine_poses": True}, "poses", TRACKS, "the poses of 9 views turned by 2 degrees"),
        ({"refine_lens": True}, "lens", TRACKS | {"focal_percent": -1.96},
         "the focal length changed by -2.0 %"),
        ({"refine_poses": True}, "poses", {"refined": 0, "note": "no poses from tracks"},
         "that was not mended: no poses from tracks"),
    ],
)  # fmt: skip
def test_verdict_says_whether_refinement_mended_what_the_check_accused(
    asked, subject, tracks, reason
):
    accused = {"subject": subject, "what": "matches fit others", "advice": "mend it"}
    options = TrainOptions(preset="best", **asked)
    metrics = GOOD | SOFT | {"steps": 1, "refinement": {"tracks": tracks}}
    verdict = judge_training(metrics, "data", "run", options, (), accused)
    assert f"found that matches fit others; {'tracks' if tracks['refined'] else 'that'}" in str(
        verdict
    )
    assert reason in verdict.reasons[1]
    blamed = "the poses are wrong" in verdict.reasons[0]
    assert blamed == (tracks["refined"] == 0)
    if blamed:  # the same command again would not help
        assert verdict.advice == "gsut doctor data, then gsut poses data -o run-2-poses"
    other = judge_training(metrics, "data", "run", TrainOptions(preset="best"), (), accused)
    assert not any("the check before" in each for each in other.reasons)


def test_run_keeps_what_the_check_accuses_if_that_is_one_thing(tmp_path):
    run = RunFolder(tmp_path)
    lens, poses = (Finding("warning", "data", "w", "a", each) for each in ("lens", "poses"))
    keep_findings(run, [Finding("info", "data", "w"), lens, lens])
    assert find_accused(run) == dataclasses.asdict(lens)
    keep_findings(run, [lens, poses])
    assert find_accused(run) is None


def test_verdict_states_the_share_that_no_training_view_saw_where_there_is_one():
    said = [judge_training(GOOD | {"unseen": u}, "data", "run").what for u in (0.0, 0.004, 0.07)]
    assert ["no training view" in what for what in said] == [False, False, True]
    assert "7 % of the pixels show what no training view saw" in said[-1]


def options_of(command, kind):
    parser = argparse.ArgumentParser()
    add_option_flags(parser, kind)
    return kind(**collect_given(kind, parser.parse_known_args(shlex.split(command))[0]))


@pytest.mark.parametrize(
    ("made", "again"),
    [
        ({}, {"preset": "best"}),
        ({"preset": "fast"}, {"preset": "best"}),
        ({"steps": 500, "max_gaussians": 20_000, "sh_degree": 0,
          "robust": True, "background": (0.0, 0.5, 1.0), "test_names": ("a b.png", "c.png")},
         {"preset": "best", "steps": None}),
        ({"preset": "best", "refine_lens": True, "test_every": 5}, {"refine_poses": True}),
    ],
)  # fmt: skip
def test_next_command_keeps_the_options_of_the_run_but_makes_more_steps(made, again):
    options = TrainOptions(**made)
    advice = judge_training(GOOD | SOFT, "data", "run", options).advice
    if options.preset == "best":
        assert "wrong poses" in "; ".join(
            judge_training(GOOD | SOFT, "data", "run", options).reasons
        )
        advice = advice.partition(", then ")[2]
    assert options_of(advice, TrainOptions) == TrainOptions(**made | again)


def test_next_command_of_a_scene_repeats_the_scene():
    made = {"preset": "fast", "frames": 40, "fov": 80.0}
    scene = {"inputs": ["a b.mp4"], **made}
    options = TrainOptions(preset="fast", test_names=("../../a.png",))
    advice = judge_training(GOOD | SOFT, "run/poses", "run", options, scene=scene).advice
    assert advice.startswith("gsut scene 'a b.mp4' -o run-2 ")
    assert options_of(advice, SceneOptions) == SceneOptions(**made | {"preset": "best"})
    shifted = GOOD | SOFT | {"detail_shifted_median": 0.9}
    advice = judge_training(shifted, "run/poses", "run", options, scene=scene).advice
    assert advice.endswith("gsut train run/poses -o run-2 --preset fast --refine-poses")


def test_next_command_divides_as_the_run_was_divided():
    division = BlockOptions("4", memory="2GB", workers=2)
    for options in (None, TrainOptions(preset="best")):
        words = division.list_words()
        advice = judge_training(GOOD | SOFT, "data", "run", options, words).advice
        assert options_of(advice.partition(", then ")[2] or advice, BlockOptions) == division
    assert "--refine-poses" in advice
    assert BlockOptions("auto").list_words() == ["--blocks", "auto"]
