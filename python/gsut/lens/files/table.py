"""A lens as a table of pixels and their rays: .csv or .npz, to which the best model is fitted."""

from __future__ import annotations

import re

import numpy as np

from gsut._core import CalibrationError, InputError
from gsut.files import read_npz, reading
from gsut.lens.camera import Camera
from gsut.lens.files._format import LensFile, LensFormat, make_lens_error
from gsut.lens.fit_rays import fit_camera

_COLUMNS = ("x", "y", "rx", "ry", "rz")
# The first of these that is as good as exact is taken, else the nearest; with "# model: NAME" that
# one.
_MODELS = ("pinhole", "kannala_brandt", "opencv8", "ocam")
_EXACT = 0.001  # pixels, RMS
_MOST_RMS = 0.5  # pixels: a table that no model is nearer to is not of one of these lenses
_KEY = re.compile(r"^#\s*(\w+)\s*[:=]\s*(\S+)", re.MULTILINE)
_ADVICE = "write columns x, y, rx, ry, rz, and '# width: W' and '# height: H' above them"


def read_table(file: LensFile, camera_id: int | str | None) -> Camera:
    """Fits a camera to a table of pixels and rays.

    Args:
        file: a CSV of x, y (pixels), rx, ry, rz (rays: x right, y down, z forward, of any length),
            with lines `# width: W` and `# height: H`; or an NPZ of pixels (N, 2), rays (N, 3),
            width and height. May be there, too: model, else the best of some is taken;
            pixel_center, where the centre of the top-left pixel is, 0.5 [default] or 0.
        camera_id: not used; a table is of one camera.

    Raises:
        CalibrationError: something is missing, or no model fits to half a pixel (RMS).
    """
    source = file.source
    table, keys = (_read_npz if file.path.suffix.lower() == ".npz" else _read_csv)(file)
    try:
        width, height = (int(float(keys[name])) for name in ("width", "height"))
        center = float(keys.get("pixel_center", 0.5))
    except KeyError as error:
        raise CalibrationError(f"{source}: there is no {error.args[0]}; {_ADVICE}") from error
    except ValueError as error:
        raise CalibrationError(f"{source}: {error}; {_ADVICE}") from error
    table = table[np.isfinite(table).all(axis=1)]
    pixels, rays = table[:, :2] + 0.5 - center, table[:, 2:]
    named = keys.get("model")
    tried: list[tuple[float, Camera]] = []
    problem = ""
    for model in (named,) if named else _MODELS:
        try:
            camera = fit_camera(pixels, rays, model=model, width=width, height=height)
        except InputError as error:
            problem = str(error)
            continue
        found, valid = camera.project(rays)
        off = np.linalg.norm(found - pixels, axis=1)
        if np.all(valid):
            tried.append((float(np.sqrt(np.mean(off**2))), camera))
            if tried[-1][0] < _EXACT:
                break
    rms, best = min(tried, key=lambda row: row[0], default=(np.inf, None))
    if best is None or not rms <= _MOST_RMS:
        near = f"the nearest ({best.model}) is {rms:.2f} pixels off" if best else problem
        raise CalibrationError(
            f"{source}: none of {named or ', '.join(_MODELS)} fits the table to {_MOST_RMS} pixels "
            f"(RMS): {near}; check axes (x right, y down, z forward) and pixels, or fit another "
            "model with gsut.lens.fit_camera"
        )
    return best


def _read_csv(file: LensFile) -> tuple[np.ndarray, dict[str, str]]:
    text, source = file.text, file.source
    rows = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    names = [word.strip().lower() for word in re.split(r"[,;\s]+", rows[0].strip())] if rows else []
    if all(name in names for name in _COLUMNS):
        order, rows = [names.index(name) for name in _COLUMNS], rows[1:]
    else:
        order = list(range(len(_COLUMNS)))
    table = []
    for number, row in enumerate(rows, 1):
        words = re.split(r"[,;\s]+", row.strip())
        try:
            table.append([float(words[place]) for place in order])
        except (ValueError, IndexError):
            raise CalibrationError(
                f"{source}, row {number}: expected 5 numbers, found '{row}'; {_ADVICE}"
            ) from None
    return np.array(table).reshape(-1, len(_COLUMNS)), dict(_KEY.findall(text))


def _read_npz(file: LensFile) -> tuple[np.ndarray, dict[str, str]]:
    advice = "give pixels (N, 2), rays (N, 3), width and height"
    with reading(file.source, advice, make_lens_error):
        found = read_npz(file.path)
        pixels = np.asarray(found["pixels"], np.float64).reshape(-1, 2)
        rays = np.asarray(found["rays"], np.float64).reshape(-1, 3)
        keys = {name: str(values.item()) for name, values in found.items() if values.size == 1}
        return np.concatenate([pixels, rays], axis=1), keys


FORMAT = LensFormat("table", "pixels and rays", (".csv", ".npz"), read_table)
