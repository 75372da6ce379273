"""The shapes of the JSON files that one command writes to a folder and another reads there.

See `gsut.files.check_shape`. Keys that no command reads are left out.
"""

from __future__ import annotations

from typing import Any

_NOTHING = type(None)
NUMBER = (int, float, _NOTHING)
VERDICT = {"level": str, "what": str, "reasons": [str], "advice": str}
_LIGHT = {
    "gains": {"*": [NUMBER]},
    "falloffs": [(_NOTHING, {"max_angle": NUMBER, "coefficients": [NUMBER]})],
}
_VIEW = {
    "name": str, "psnr?": NUMBER, "ssim?": NUMBER, "render_ms?": NUMBER,
    "render?": (str, _NOTHING), "truth?": (str, _NOTHING),
}  # fmt: skip
METRICS_SHAPE: dict[str, Any] = {
    "steps?": int, "num_gaussians?": int, "worst_view?": (str, _NOTHING),
    **{f"{name}?": NUMBER for name in (
        "psnr", "psnr_min", "psnr_color_corrected", "ssim", "train_seconds", "render_ms",
    )},
    "rings?": [{"from_degrees": NUMBER, "to_degrees": NUMBER, "psnr": NUMBER}],
    "views?": [_VIEW], "notes?": [str], "verdict?": (_NOTHING, VERDICT),
    "light?": (_NOTHING, _LIGHT),
    "compaction?": (_NOTHING, {"harmonics_degrees?": (_NOTHING, [int])}),
}  # fmt: skip
ENVIRONMENT_SHAPE: dict[str, Any] = {
    "dataset?": (str, _NOTHING), "isa?": str, "digests?": (_NOTHING, {"*": str}),
}  # fmt: skip
SCENE_SHAPE: dict[str, Any] = {
    "key": {"inputs": [str]}, "verdict?": VERDICT, "renders?": (str, _NOTHING),
}  # fmt: skip
POSES_SHAPE: dict[str, Any] = {
    "registered": int, "images": int, "points": int, "lens": str, "seconds": {"*": NUMBER},
    "reprojection_error_px": {"rms": NUMBER, "median": NUMBER}, "verdict": VERDICT,
    "lenses": [{"model": str, "params": [NUMBER]}], "made_from?": str, "rig?": dict,
}  # fmt: skip
