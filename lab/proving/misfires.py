"""Names the misfires of a row: what gsut said or chose that the truth contradicts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from lab.proving.causes import CAUSES, find_wrong_cause

_SIGMAS = 3.0  # beyond which a stated standard deviation has failed
_TRUE_OF_EXACT = (
    "there are no points",
    "have no ray",
    "have the same pose",
    "all cameras stand at one place",
    "/depth is not used",
)
_SHIFT_PX = 1.5  # pixels by which a shutter must shift the picture for its readout to be missed
# Orders of lines whose true readout is below zero.
_BACKWARDS = ("bottom_to_top", "right_to_left")
# What gsut promises of every input: a run with one of these has failed.
BROKEN = ("traceback", "time limit", "other bits")


class Misfire(NamedTuple):
    """One thing that gsut got wrong."""

    kind: str
    text: str


def find_misfires(row: dict[str, Any]) -> Iterator[Misfire]:
    """Yields what went wrong in a row of `score_capture`."""
    for name in ("doctor", "poses", "train", "scene"):
        if row.get(f"{name}_traceback"):
            yield Misfire("traceback", f"{name}: {row[f'{name}_traceback'].splitlines()[-1]}")
        if f"{name}_status" in row and row[f"{name}_status"] is None:
            yield Misfire("time limit", name)
    if row.get("failed"):
        yield Misfire("traceback", f"the proving ground itself: {row['failed'][-200:]}")
    for what in row.get("other_bits", ()):
        yield Misfire("other bits", what)
    yield from _check_doctor(row)
    for step, texts in row.get("exact", {}).items():
        for text in texts:
            kind = "refuses" if text.startswith("error") else "warns of"
            yield Misfire(f"doctor {kind} exact data", f"every {step}: {text[:160]}")
    yield from _check_verdict(row)
    yield from _check_lens(row)
    yield from _check_shutter(row)
    for name in CAUSES:
        if (said := find_wrong_cause(row, name)) is not None:
            yield Misfire("cause not named", f"{name}; said: {said[:160]}")
    if row.get("train_refused"):
        yield Misfire("training refused", row["train_refused"])


def is_true_of_exact(text: str) -> bool:
    """Returns whether the doctor may say this of exact data: it is so."""
    return any(words in text for words in _TRUE_OF_EXACT)


def _check_doctor(row: dict[str, Any]) -> Iterator[Misfire]:
    if "planted" not in row:
        return
    said = [text for text in row["doctor_says"] if not is_true_of_exact(text)]
    if row["planted"] != "none":
        if not row["doctor_named"]:
            said_any = "said: " + said[0][:160] if said else "nothing was said"
            yield Misfire("mistake not named", f"{row['planted']}; {said_any}")
    elif row["doctor_errors"]:
        yield Misfire("doctor refuses exact data", said[0] if said else "")
    elif said:
        yield Misfire("doctor warns of exact data", said[0])


def _check_verdict(row: dict[str, Any]) -> Iterator[Misfire]:
    if "verdict" in row and row["verdict"] != row["true_class"]:
        figures = (
            f"{row['shift_degrees']:.2f} degrees, AUC@1 {100 * row['auc_1']:.0f}, @5 "
            f"{100 * row['auc_5']:.0f}, registered {100 * row['registered']:.0f} %"
        )
        text = "; ".join([figures, *row["verdict_reasons"]])
        yield Misfire(f"said {row['verdict']}, is {row['true_class']}", text)
    if "scene_verdict" in row and row["scene_verdict"] != row["scene_class"]:
        between = row["scene_between"]
        yield Misfire(
            f"scene said {row['scene_verdict']}, is {row['scene_class']}",
            f"detail between the pictures {100 * (between or 0):.0f} %, registered "
            f"{100 * row['registered']:.0f} %; " + "; ".join(row["scene_reasons"]),
        )
    few = [reason for reason in row.get("verdict_reasons", ()) if "few features" in reason]
    if few and row["auc_5"] > 0.9:
        yield Misfire("few features, poses fine", few[0])


def _check_lens(row: dict[str, Any]) -> Iterator[Misfire]:
    sigma = row.get("focal_sigma_percent")
    if sigma and abs(row["focal_error"]) > _SIGMAS * sigma / 100:
        yield Misfire(
            "focal length beyond 3 sigma",
            f"{100 * row['focal_error']:+.2f} %, sigma {sigma:.2f} %, {row['lens_px']:.2f} px",
        )
    if row.get("lens_px", 0.0) > 1.0 and row["verdict"] == "good":
        yield Misfire("lens off by more than a pixel, said good", f"{row['lens_px']:.2f} px")


def _check_shutter(row: dict[str, Any]) -> Iterator[Misfire]:
    if row.get("kind") != "film" or "shutter_found" not in row:
        return
    found, true = row["readout_found"], row["readout_ms"]
    is_rolling = row["shutter_found"] not in (None, "global")
    if is_rolling and not true:
        yield Misfire("readout found on a global shutter", f"{1e3 * (found or 0):.1f} ms")
    elif not is_rolling and row["readout_px"] > _SHIFT_PX:
        sigma = row["readout_sigma"]
        known = f"{1e3 * found:.1f} +- {1e3 * sigma:.1f} ms" if found and sigma else "none"
        yield Misfire(
            "readout missed", f"true {true:.1f} ms, {row['readout_px']:.1f} px, measured {known}"
        )
    elif is_rolling and found and row["readout_sigma"]:
        signed = 1e3 * (-found if row["shutter_found"] in _BACKWARDS else found)
        if abs(signed - true) > _SIGMAS * 1e3 * row["readout_sigma"]:
            yield Misfire("readout beyond 3 sigma", f"{signed:.1f} ms, true {true:.1f} ms")
