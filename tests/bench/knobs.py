"""Speed against error: one knob of the blend rule or of the method turned at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from gsut import _core
from tests.bench.accuracy import errors_of, make_truth
from tests.bench.measure import (
    BACKWARD_STAGES,
    FORWARD_STAGES,
    SCALAR_FORWARD_STAGES,
    FastRun,
    ScalarRun,
    best_times,
)
from tests.bench.scenes import BenchScene

# The rule without cut-offs, as far as a picture can tell: what the knobs' errors are measured to.
_IDEAL_ALPHA_MIN, _IDEAL_TRANSMITTANCE_MIN = 1e-5, 1e-7

KNOB_COLUMNS = (
    ("knob", "knob", ""),
    ("value", "value", ""),
    ("isa", "isa", ""),
    ("forward + backward cpu ms", "forward_backward_cpu_ms", ".1f"),
    ("blend", "blend_cpu_ms", ".1f"),
    ("image rms to the rule without cut-offs", "rule_rms_error", ".1e"),
    ("max", "rule_max_error", ".1e"),
    ("rms to the double reference", "image_rms_error", ".1e"),
)


def knob_settings() -> list[tuple[str, str, dict[str, Any]]]:
    """(knob, value in words, fields of BlendRule) of all settings; the first is the default."""
    settings: list[tuple[str, str, dict[str, Any]]] = [("default", "", {})]
    for over in (0.25, 0.5, 2, 4, 8):
        settings.append(("alpha_min", f"{over:g}/255", {"alpha_min": over / 255}))
    for value in (1e-6, 1e-5, 1e-3, 1e-2):
        settings.append(("transmittance_min", f"{value:g}", {"transmittance_min": value}))
    settings.append(("response_min", "0.0113", {"response_min": 0.0113}))
    settings.append(("order", "z", {"order_by_z": True}))
    return settings


def knob_bench(
    scene: BenchScene,
    *,
    repeats: int,
    tiles: int,
    with_scalar: bool = True,
    on_progress: Callable[[str], None] = lambda text: None,
) -> list[dict[str, Any]]:
    """Times and errors of all settings on one scene and the active number of threads.

    Args:
        scene: what to render.
        repeats: most runs a setting.
        tiles: sampled for the errors.
        with_scalar: measure the baseline's unscented extents, too.
        on_progress: gets a word before each setting.

    Returns:
        One row a setting: its processor time over threads in milliseconds, its root mean square and
        largest error against the double reference of the rule without cut-offs, and, where the rule
        is the default, the rms error against the double reference of that rule.
    """
    ideal = _core.BlendRule()
    ideal.alpha_min, ideal.transmittance_min = _IDEAL_ALPHA_MIN, _IDEAL_TRANSMITTANCE_MIN
    on_progress("double reference without cut-offs")
    truth = make_truth(scene, ideal, tiles=tiles, with_gradients=False)
    same_rule = make_truth(scene, _core.BlendRule(), tiles=tiles, with_gradients=False)

    def row(
        knob: str, value: str, run: FastRun | ScalarRun, stages: tuple[str, ...]
    ) -> dict[str, Any]:
        on_progress(f"{knob} {value}".strip())
        times = best_times(run.once, repeats)
        errors = errors_of(truth, run.image, None)
        is_default = knob in ("default", "isa", "tile bound")
        kernel = errors_of(same_rule, run.image, None).image_rms if is_default else None
        return {
            "name": scene.name, "knob": knob, "value": value, "isa": _core.active_isa(),
            "threads": _core.num_threads(),
            "forward_backward_cpu_ms": times.cpu_ms(*stages, *BACKWARD_STAGES),
            "blend_cpu_ms": times.cpu_ms("forward"),
            "rule_rms_error": errors.image_rms_all, "rule_max_error": errors.image_max,
            "image_rms_error": kernel,
            "tile_pairs": run.renderer.statistics()["num_pairs"],
        }  # fmt: skip

    rows = []
    for knob, value, fields in knob_settings():
        rule = _core.BlendRule()
        for name, setting in fields.items():
            setattr(rule, name, setting)
        rows.append(row(knob, value, FastRun(scene, rule), FORWARD_STAGES))
    active = _core.active_isa()
    try:
        for isa in _core.available_isas():
            if isa != active:
                _core.set_isa(isa)
                rows.append(row("isa", isa, FastRun(scene, _core.BlendRule()), FORWARD_STAGES))
    finally:
        _core.set_isa(active)
    if with_scalar:
        for widen in (1.0, 1.5):
            run = ScalarRun(scene, _core.BlendRule(), widen)
            value = f"scalar baseline, extents x {widen:g}"
            rows.append(row("tile bound", value, run, SCALAR_FORWARD_STAGES))
    return rows
