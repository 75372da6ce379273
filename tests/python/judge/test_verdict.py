"""The verdict: its words, and which of several counts."""

import dataclasses
import json
import types

import pytest

from gsut.judge.checks import Check, combine_verdicts, judge, judge_pictures
from gsut.judge.checks.poses import POSES_CHECKS
from gsut.run import Verdict

GOOD = Verdict("good", "61 of 61 images registered")
POOR = Verdict("poor", "12 dB", ("the poses do not fit",), "gsut doctor DATA")


def test_the_words_say_level_finding_reasons_and_what_to_do():
    assert str(GOOD) == "good: 61 of 61 images registered."
    assert str(POOR) == "poor: 12 dB (the poses do not fit). Next: gsut doctor DATA"


def test_the_poorest_of_several_counts():
    usable = dataclasses.replace(POOR, level="usable")
    assert combine_verdicts(GOOD, usable, GOOD) == usable
    assert combine_verdicts(POOR, GOOD) == POOR
    assert combine_verdicts(usable, POOR) == POOR


def test_what_is_inferred_lowers_what_was_measured_by_one_level_at_most():
    found = combine_verdicts(GOOD, POOR)
    assert found == dataclasses.replace(POOR, level="usable")


@pytest.mark.parametrize(("is_visible", "level"), [(True, "good"), (False, "usable")])
def test_what_held_out_views_show_stays_a_reason_and_lowers_nothing(is_visible, level):
    says = "the focal length is known only to 12 %"
    check = Check("focal length", lambda _: 7.0, 2.0, 6.0, lambda _: says, "--fov", is_visible)
    poses = judge([check], None, "poses of 17 of 17 images", "gsut train")
    assert poses.level == "poor"  # of the poses themselves
    poses = Verdict.from_dict(json.loads(json.dumps(poses.as_dict())))
    found = combine_verdicts(GOOD, poses)
    assert found.level == level and found.reasons == (says,)


def test_few_views_lower_nothing_that_held_out_views_show():
    check = next(check for check in POSES_CHECKS if check.name == "number of views")
    poses = judge([check], types.SimpleNamespace(registered=4), "poses of 4 of 4 images", "")
    assert poses.level == "poor"  # where nothing was measured
    found = combine_verdicts(dataclasses.replace(GOOD, level="usable"), poses)
    assert found.level == "usable" and "only 4 views" in found.reasons


def test_an_unknown_level_is_refused():
    with pytest.raises(ValueError, match="good, usable, poor"):
        Verdict("fine", "")


def test_blurred_pictures_are_a_reason_and_their_number_is_none():
    rows = [{"blurred": i < 10} for i in range(30)]
    found = judge_pictures({"frames": rows, "size": (4, 3)})
    assert found.level == "usable" and "10 of them blurred" in str(found)
    assert judge_pictures({"frames": rows[10:], "size": (4, 3)}).level == "good"
    assert judge_pictures({"frames": rows[25:], "size": (4, 3)}).level == "good"
