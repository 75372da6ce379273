""".splat files: 32 bytes a Gaussian, without harmonics; what the first viewers on the web read."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.files import read_bytes, register_reader, write_file
from gsut.formats._format import Format, SceneFile, WriteSettings, Written
from gsut.formats._quantize import (
    logits_from_opacity,
    normalize_quats,
    opacity_from_logits,
    to_bytes,
)
from gsut.gaussians import SH_C0, Gaussians

_ROW = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])
# A byte b of a rotation is (b - 128) / 128: -1 to 127 / 128.
_QUAT_SCALE = 128.0


@register_reader("splat", ".splat")
def _read(path: Path) -> SceneFile:
    content = read_bytes(path)
    size = len(content)
    if size % _ROW.itemsize:
        raise InputError(
            f"{path}: {size} bytes are no whole number of Gaussians of {_ROW.itemsize} bytes; it "
            "is truncated or no .splat file"
        )
    rows = np.frombuffer(content, _ROW)
    with np.errstate(divide="ignore", invalid="ignore"):
        log_scales = np.log(rows["scale"])
    quats = (rows["quat"].astype(np.float32) - _QUAT_SCALE) / _QUAT_SCALE
    color = rows["rgba"].astype(np.float32) / 255
    sh = ((color[:, :3] - 0.5) / SH_C0)[:, None, :]
    return SceneFile(
        Gaussians(rows["mean"], quats, log_scales, logits_from_opacity(color[:, 3]), sh)
    )


def _write(path: Path, gaussians: Gaussians, settings: WriteSettings) -> Written:
    # Viewers that draw while loading show the largest and most opaque first.
    opacity = opacity_from_logits(gaussians.opacity_logits)
    weight = opacity * np.exp(np.sum(gaussians.log_scales.astype(np.float64), axis=1))
    order = np.argsort(-weight, kind="stable")
    g, opacity = gaussians[order], opacity[order]
    rows = np.empty(len(g), _ROW)
    rows["mean"], rows["scale"] = g.means, np.exp(g.log_scales)
    rows["rgba"][:, :3], colors = to_bytes(255 * (0.5 + SH_C0 * g.sh[:, 0]))
    rows["rgba"][:, 3] = np.rint(255 * opacity)
    q = normalize_quats(g.quats)
    # 1 has no byte of its own: the sign whose largest component is negative is exact.
    largest = q[np.arange(len(q)), np.argmax(np.abs(q), axis=1)]
    q *= np.where(largest > 0, -1.0, 1.0)[:, None]
    rows["quat"], _ = to_bytes(_QUAT_SCALE + _QUAT_SCALE * q)
    write_file(path, rows.tobytes())
    left_out = [".splat has no harmonics: colours are the same from all sides"]
    if gaussians.sh_degree == 0:
        left_out = []
    if settings.antialiased:
        left_out.append(".splat cannot say that a scene is antialiased")
    return Written(order, {"color": colors}, tuple(left_out))


FORMAT = Format("splat", (".splat",), _write, _read, lambda head: True)
