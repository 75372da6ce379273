"""The verdict: its words, and which of several counts."""

import pytest

from gsut.run import Verdict, worst

GOOD = Verdict("good", "61 of 61 images registered")
POOR = Verdict("poor", "12 dB", ("the poses do not fit",), "gsut doctor DATA")


def test_the_words_say_level_finding_reasons_and_what_to_do():
    assert str(GOOD) == "good: 61 of 61 images registered."
    assert str(POOR) == "poor: 12 dB (the poses do not fit). Next: gsut doctor DATA"


def test_the_poorest_of_several_counts():
    assert worst([GOOD, POOR, GOOD]) is POOR


def test_an_unknown_level_is_refused():
    with pytest.raises(ValueError, match="good, usable, poor"):
        Verdict("fine", "")
