"""The shapes of the JSON files that one command writes to a folder and another reads there.

See `gsut.files.check_shape`. Keys that no command reads are left out.
"""

from __future__ import annotations

from typing import Any

from gsut.run.verdict import Verdict

_NOTHING = type(None)
_NUMBER = (int, float, _NOTHING)
_LIGHT = {
    "gains": {"*": [_NUMBER]},
    "falloffs": [(_NOTHING, {"max_angle": _NUMBER, "coefficients": [[_NUMBER]]})],
}
_VIEW = {
    "name": str, "psnr?": _NUMBER, "ssim?": _NUMBER, "render_ms?": _NUMBER,
    "render?": (str, _NOTHING), "truth?": (str, _NOTHING),
}  # fmt: skip
METRICS_SHAPE: dict[str, Any] = {
    "steps?": int, "num_gaussians?": int, "worst_view?": (str, _NOTHING),
    "psnr": _NUMBER,
    **{f"{name}?": _NUMBER for name in (
        "psnr_min", "psnr_color_corrected", "ssim", "train_seconds", "render_ms",
        "seconds_per_step", "peak_rss_mb",
    )},
    "dataset?": (str, _NOTHING), "image_size?": [[int]], "test_views?": [str],
    "rings?": [{"from_degrees": _NUMBER, "to_degrees": _NUMBER, "psnr": _NUMBER}],
    "views?": [_VIEW], "notes?": [str], "verdict?": (_NOTHING, Verdict.SHAPE),
    "light?": (_NOTHING, _LIGHT), "marked?": [{"picture": str, "text": str}],
}  # fmt: skip
ENVIRONMENT_SHAPE: dict[str, Any] = {
    "dataset?": (str, _NOTHING), "isa?": str, "digests?": (_NOTHING, {"*": str}),
}  # fmt: skip
SCENE_SHAPE: dict[str, Any] = {
    "key": {"inputs": [str]}, "verdict?": Verdict.SHAPE, "renders?": (str, _NOTHING),
}  # fmt: skip
