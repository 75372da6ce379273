"""The verdict of a training names what is wrong and the next command."""

import pytest

from gsut.evaluate import train_verdict
from gsut.run import Verdict

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
    verdict = train_verdict(GOOD | changes, "data", "run")
    print(verdict)
    assert verdict.level == level
    assert reason in "; ".join(verdict.reasons)
    assert advice in verdict.advice
    assert Verdict.of(verdict.as_dict()) == verdict
    if changes.get("psnr", 30.0) is not None:
        assert "30 dB sharp" in verdict.what
