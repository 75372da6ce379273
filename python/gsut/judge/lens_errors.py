"""Hypotheses of lenses that were misread, or are of other photographs."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence

import numpy as np

from gsut._core import InputError
from gsut.judge.hypotheses import Dataset, Hypothesis, Numbers, Rate, Variant, Variants, climb
from gsut.lens import Camera

# Factors on the image's size that programs resize by, and that a lens may not have followed.
_SIZES = (0.25, 1 / 3, 0.5, 2 / 3, 0.75, 4 / 3, 1.5, 2.0, 3.0, 4.0)
# Other orders of radial-tangential coefficients, and where OpenCV's k1 k2 p1 p2 k3 stand in them.
_ORDERS = {"k1 k2 k3 p1 p2": (0, 1, 3, 4, 2), "p1 p2 k1 k2 k3": (2, 3, 0, 1, 4)}


def _change_lenses(
    data: Dataset, change: Callable[[Camera], Camera | None], words: str = "", edit: str = ""
) -> Variants:
    """Yields the dataset with changed lenses, if each can be changed so."""
    if not all(map(_has_focal, data.cameras)):
        return
    try:
        changed = data.equip([change(camera) for camera in data.cameras])
    except (InputError, ValueError, KeyError):
        return
    if changed is not None:
        yield Variant(words, edit, changed)


def _has_focal(camera: Camera) -> bool:
    """Returns whether fx, fy, cx and cy are a lens' first numbers: a panorama has none."""
    return camera.param_names.split()[:4] == ["fx", "fy", "cx", "cy"]


def _replace(camera: Camera, params: Numbers, model: str = "") -> Camera:
    """Returns a lens with other numbers."""
    return Camera(model or camera.model, list(params), camera.width, camera.height)


def _adjust(camera: Camera, focal: float = 1.0, center: Numbers | None = None) -> Camera:
    """Returns a lens with focal lengths times a factor, and another principal point."""
    p = np.array(camera.params)
    return _replace(camera, [*(focal * p[:2]), *(p[2:4] if center is None else center), *p[4:]])


def _find_center(camera: Camera) -> np.ndarray:
    """Returns the principal point in pixels."""
    return np.array(camera.params)[2:4]


def _is_pinhole(camera: Camera) -> bool:
    return _has_focal(camera) and not np.any(camera.params[4:])


def _change_as_in(
    *rows: tuple[str, str, Callable[[Camera], Camera | None]],
) -> Callable[[Dataset, Rate], Variants]:
    """Makes what supposes the changes of lenses in a table: words, edit and the change of each."""

    def suppose(data: Dataset, _: Rate) -> Variants:
        for words, edit, change in rows:
            yield from _change_lenses(data, change, words, edit)

    return suppose


def _climb_lenses(
    data: Dataset, rate: Rate, change: Callable[[Camera, np.ndarray], Camera | None],
    starts: Sequence[Numbers], steps: Numbers,
) -> np.ndarray:  # fmt: skip
    def suppose(x: np.ndarray) -> Dataset | None:
        found = list(_change_lenses(data, lambda c: change(c, x)))
        return found[0].data if found else None

    return climb(suppose, rate, starts, steps)


def _suppose_exchanges(data: Dataset, _: Rate) -> Variants:
    for one, two in itertools.combinations(range(len(data.cameras)), 2):
        a, b = data.cameras[one], data.cameras[two]
        if (a.width, a.height) == (b.width, b.height):
            cameras = list(data.cameras)
            cameras[one], cameras[two] = b, a
            changed = data.equip(cameras)
            if changed is not None:
                yield Variant(f"{one} and {two}", "", changed)


def _read_as_fisheye(c: Camera) -> Camera | None:
    is_radial = c.model.startswith("opencv") and not _is_pinhole(c)
    return _replace(c, c.params[:8], "kannala_brandt") if is_radial else None


def _read_as_radial(c: Camera) -> Camera | None:
    return _replace(c, c.params[:8], "opencv4") if c.model == "kannala_brandt" else None


def _undistort(c: Camera) -> Camera | None:
    return None if c.model == "pinhole" else _replace(c, c.params[:4], "pinhole")


def _reorder(c: Camera, order: tuple[int, ...]) -> Camera | None:
    p = np.array(c.params)
    if not c.model.startswith("opencv") or len(p) < 4 + len(order):
        return None
    p[4 : 4 + len(order)] = p[4 : 4 + len(order)][list(order)]
    return _replace(c, p)


def _suppose_focals(data: Dataset, rate: Rate) -> Variants:
    def change(camera: Camera, x: np.ndarray) -> Camera:
        return _adjust(camera, float(np.exp(x[0])))

    x = _climb_lenses(data, rate, change, [[k / 25] for k in range(-17, 18)], [0.02])
    words = f"{np.exp(x[0]):.3f}"
    yield from _change_lenses(data, lambda c: change(c, x), words, words)


def _distort(camera: Camera, x: np.ndarray, model: str) -> Camera:
    return _replace(camera, [*camera.params[:4], x[0], 0, 0, 0], model)


def _suppose_distortions(data: Dataset, rate: Rate) -> Variants:
    if not all(_is_pinhole(camera) for camera in data.cameras):
        return
    for words, model, starts in (
        ("a fisheye", "kannala_brandt", (-0.05, 0.0, 0.05)),
        ("a lens with distortion", "opencv4", (-0.4, -0.2, -0.1, 0.1)),
    ):
        change = functools.partial(_distort, model=model)
        x = _climb_lenses(data, rate, change, [[k] for k in starts], [0.04])
        yield from _change_lenses(data, functools.partial(change, x=x), words)


def _suppose_crops(data: Dataset, rate: Rate) -> Variants:
    if not all(map(_has_focal, data.cameras)):
        return

    def change(camera: Camera, x: np.ndarray) -> Camera:
        return _adjust(camera, center=_find_center(camera) + x)

    side = data.cameras[0].width / 10
    starts = [(0.5, 0.5), (-0.5, -0.5), *itertools.product((-side, 0.0, side), repeat=2)]
    x = _climb_lenses(data, rate, change, starts, [side / 2, side / 2])
    x = _climb_lenses(data, rate, change, [x], [1.0, 1.0])
    center = _find_center(data.cameras[0]) + x
    edit = f"cx = {center[0]:.1f}, cy = {center[1]:.1f}"
    if np.abs(np.abs(x) - 0.5).max() < 0.25 and x[0] * x[1] > 0:
        edit += f" ({'add 0.5 to' if x[0] > 0 else 'subtract 0.5 from'} cx and cy: OpenCV, Kalibr "
        edit += "and mrcal put (0, 0) at the centre of the top-left pixel, here it is (0.5, 0.5))"
    yield from _change_lenses(data, lambda c: change(c, x), f"cx {x[0]:+.2f} and cy {x[1]:+.2f}",
                              edit)  # fmt: skip


LENS_ERRORS: tuple[Hypothesis, ...] = (
    Hypothesis("the lenses of cameras {} exchanged", "exchange their lenses", "lens",
               _suppose_exchanges),
    Hypothesis("{}", 'name the model: camera_model "{}"', "lens", _change_as_in(
        ("a fisheye (Kannala-Brandt) with these coefficients, not radial-tangential ones",
         "OPENCV_FISHEYE", _read_as_fisheye),
        ("a radial-tangential lens (OpenCV) with these coefficients, not a fisheye", "OPENCV",
         _read_as_radial),
    )),
    Hypothesis("a lens without distortion: they have been undistorted",
               "give the lens that the undistorted photographs have (pinhole, no k), or the "
               "originals", "lens", _change_as_in(("", "", _undistort))),
    Hypothesis("coefficients in the order {}, not k1 k2 p1 p2 k3",
               "write the coefficients in OpenCV's order, k1 k2 p1 p2 k3, or by their names",
               "lens", _change_as_in(
                   *((name, "", functools.partial(_reorder, order=order))
                     for name, order in _ORDERS.items()))),
    Hypothesis("distortion of the other sign",
               "the coefficients undistort where they should distort: change their signs, or take "
               "them from the calibration as it was written", "lens", _change_as_in(
                   ("", "", lambda c: _replace(c, [*c.params[:4], *-np.array(c.params[4:])])))),
    Hypothesis("a principal point {}", "{}", "lens", _change_as_in(
        ("with cx and cy swapped",
         "swap cx and cy (and width and height, where they are swapped, too)",
         lambda c: _adjust(c, center=_find_center(c)[::-1])),
        *((f"times {s:.3g}", f"multiply cx and cy by {s:.4g}: they are for images of another size",
           lambda c, s=s: _adjust(c, center=s * _find_center(c))) for s in _SIZES),
    )),
    Hypothesis("focal length and principal point times {}: the lens is for images of another size",
               "multiply fx, fy, cx and cy by {}, or give the width and height they are for",
               "lens", _change_as_in(
                   *((f"{s:.4g}", f"{s:.4g}", lambda c, s=s: _adjust(c, s, s * _find_center(c)))
                     for s in _SIZES))),
    Hypothesis("a focal length times {}", "multiply fx and fy by about {}, or calibrate anew",
               "lens", _suppose_focals, free=1),
    Hypothesis("{}: they are not undistorted, as the lens says",
               "give the lens file of the original photographs, or calibrate (gsut calibrate)",
               "lens", _suppose_distortions, free=1),
    Hypothesis("{} pixels: the photographs are a crop",
               "keep fx and fy; {}", "lens", _suppose_crops, free=2),
)  # fmt: skip
