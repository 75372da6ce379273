"""Frames: what the page asks for, drawn by gsut's renderer through the lens itself."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.data.images import shrink_image
from gsut.data.poses import rigid_transform
from gsut.gaussians import (
    SH_C0,
    Gaussians,
    StoredGaussians,
    pack_harmonics,
    rotate_upright,
    select_most_seen,
)
from gsut.lens import Camera
from gsut.render import (
    PixelFilter,
    is_coarser,
    place_about,
    render,
    solid,
    to_uint8,
    with_surroundings,
)
from gsut.view.lenses import Lenses
from gsut.view.measure import SEEN, point_at
from gsut.view.overlays import (
    draw_box,
    draw_cameras,
    draw_lines,
    draw_marks,
    draw_points,
    hatch_without_ray,
)
from gsut.view.stage import Stage, free_motion

MODES = ("color", "distance", "normal", "alpha", "centers", "error")
# Of the Gaussians that a frame is drawn of: those of a large scene cost more than its pixels do.
SHARES = (1.0, 0.5, 0.25)
_MOST_PIXELS = 33_000_000  # of one frame
_RANGE_PERCENT = (2.0, 98.0)  # of the distances, that colours span
_MOST_ERROR = 0.25  # of full scale: shown in the last colour
_FULL_QUALITY = 92
_FILTER_CAMERAS = 8  # photographs that say how fine a Gaussian was seen
_SAMPLES = 7  # every so many pixels, for the range of distances


@dataclasses.dataclass(frozen=True)
class FrameRequest:
    """One frame that the page asks for.

    Attributes:
        pose: (4, 4) camera_from_world, scene coordinates.
        lens: its number in `Lenses`; width, height: of the image.
        mode: one of MODES.
        view: the photograph whose pose this is, or None.
        shutter: the photograph whose rolling shutter is used, or None.
        layers: names of what is drawn over it: cameras, points, domain, box.
        crop: (2, 3) lower and upper corner of the box in `Frames.axes`, or None.
        clean: without the floaters, once `Frames.floaters` tells them.
        ground: (4,) a plane's normal n and d, n . x = d on it, that the layer "axes" draws; None:
            across `Frames.axes` through the scene's middle.
        marks: (n, 3) points.
        quality: of the JPEG; None: a PNG, which loses nothing.
        share: of the Gaussians, the most seen ones; below 1 while the eye moves.
    """

    pose: np.ndarray
    lens: int
    width: int
    height: int
    mode: str = "color"
    view: int | None = None
    shutter: int | None = None
    layers: frozenset[str] = frozenset()
    crop: np.ndarray | None = None
    marks: np.ndarray | None = None
    quality: int | None = _FULL_QUALITY
    share: float = 1.0
    clean: bool = False
    ground: np.ndarray | None = None

    @classmethod
    def parse(cls, values: dict[str, Any], num_views: int) -> FrameRequest:
        """The request of a JSON object.

        Raises:
            InputError: a value is missing or out of range; the sentence says which.
        """
        try:
            pose = rigid_transform(np.reshape(values["pose"], (4, 4)), "the frame's pose")
            # What the page has from a photograph comes back with its bits.
            pose = np.array(values["pose"], np.float64).reshape(4, 4)
            width, height = int(values["width"]), int(values["height"])
            view, shutter = (
                None if values.get(key) is None else int(values[key]) for key in ("view", "shutter")
            )
            crop = None if not values.get("crop") else np.array(values["crop"], np.float64)
            marks = np.array(values.get("marks") or [], np.float64).reshape(-1, 3)
            ground = values.get("ground")
            ground = None if ground is None else np.array(ground, np.float64).reshape(4)
            quality = values.get("quality", _FULL_QUALITY)
            quality = None if quality is None else min(100, max(5, int(quality)))
            lens, share = int(values["lens"]), float(values.get("share", 1))
        except (KeyError, TypeError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"the frame's request is not whole: {error}") from None
        mode = values.get("mode", "color")
        if mode not in MODES:
            raise InputError(f"there is no mode {mode!r}; known: {', '.join(MODES)}")
        if width < 1 or height < 1 or width * height > _MOST_PIXELS:
            raise InputError(f"a frame of {width} x {height} cannot be drawn; at most 33 million")
        if any(row is not None and not 0 <= row < num_views for row in (view, shutter)):
            raise InputError(f"there is no such photograph; there are {num_views}")
        if share not in SHARES:
            raise InputError(f"share must be one of {SHARES}, found {share}")
        if crop is not None and (crop.shape != (2, 3) or not np.isfinite(crop).all()):
            raise InputError("crop must be two corners of three numbers")
        if not np.isfinite(marks).all() or (ground is not None and not ground[:3].any()):
            raise InputError("marks must be finite, and the ground needs a normal")
        layers = frozenset(values.get("layers") or ())
        return cls(
            pose, lens, width, height, mode, view, shutter, layers, crop, marks, quality, share,
            bool(values.get("clean")), ground,
        )  # fmt: skip


@dataclasses.dataclass
class Drawn:
    """A frame: (H, W, 3) uint8, and the range of what its colours mean, or None."""

    image: np.ndarray
    span: tuple[float, float] | None = None


class Frames:
    """Draws frames of a stage.

    Args:
        stage: what is looked at; its Gaussians may be others from frame to frame.
        lenses: by number.

    Attributes:
        axes: (3, 3) rows: right, up, forward of the scene, in which the crop box stands.
        floaters: (N,) bool of `whole()`, None where nobody has looked for them.
    """

    def __init__(self, stage: Stage, lenses: Lenses) -> None:
        self.stage, self.lenses = stage, lenses
        self._renderer = _core.Renderer()
        self._rule = _core.BlendRule()
        self._buffers: tuple[np.ndarray, ...] = ()
        self._chosen: dict[Any, Any] = {}
        self.floaters: np.ndarray | None = None
        self._pixels: Any = None  # a PixelFilter
        place = stage.place()
        self.center, self.extent = place["center"], place["extent"]
        up = place["up"] / np.linalg.norm(place["up"])
        forward = place["pose"][2, :3] - up * (up @ place["pose"][2, :3])
        if np.linalg.norm(forward) < 1e-6:
            forward = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
        forward = forward / np.linalg.norm(forward)
        self.axes = np.stack([np.cross(forward, up), up, forward])

    def encode(self, request: FrameRequest) -> tuple[bytes, str, tuple[float, float] | None]:
        """A frame as a file: bytes, kind and the range of its colours."""
        import cv2

        drawn = self.draw(request)
        pixels = cv2.cvtColor(drawn.image, cv2.COLOR_RGB2BGR)
        if request.quality is None:
            _, data = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1])
            return data.tobytes(), "image/png", drawn.span
        _, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, request.quality])
        return data.tobytes(), "image/jpeg", drawn.span

    def draw(self, request: FrameRequest) -> Drawn:
        """A frame with all that is drawn over it."""
        camera = self.lenses.at(request.lens, request.width, request.height)
        place, pose = self._place(request), request.pose
        drawn = self._picture(request, camera, place)
        image, scene, layers = drawn.image, self.stage.scene, request.layers
        if "domain" in layers:
            hatch_without_ray(image, camera.rays()[1])
        if scene is not None and "points" in layers:
            draw_points(image, camera, pose, scene.points, scene.point_colors)
        if scene is not None and "cameras" in layers:
            draw_cameras(image, camera, pose, scene, request.view)
        if "axes" in layers:
            self._draw_axes(image, camera, pose, request.ground)
        if request.crop is not None and "box" in layers:
            sides = (np.arange(8)[:, None] >> np.arange(3)) & 1
            corners = request.crop[sides, np.arange(3)] * self.extent
            draw_box(image, camera, pose, corners @ self.axes + self.center)
        if request.marks is not None and len(request.marks):
            draw_marks(image, camera, pose, request.marks)
        return drawn

    def pick(self, request: FrameRequest, pixel: tuple[float, float]) -> np.ndarray | None:
        """The point (3,) that a pixel sees, at the expected distance along its ray; None: nothing.

        Args:
            request: whose frame was clicked.
            pixel: x and y.
        """
        camera = self.lenses.at(request.lens, request.width, request.height)
        place = self._place(request)
        _, alpha, depth = self._render(request, camera, place)
        return point_at(place, camera, np.array(pixel), alpha, depth)

    def _place(self, request: FrameRequest) -> Any:
        scene = self.stage.scene
        if request.shutter is None or scene is None:
            return request.pose
        view = scene.views[request.shutter]
        if np.array_equal(view.camera_from_world, request.pose):
            return view.motion
        return free_motion(scene, request.shutter, request.pose)

    def _picture(self, request: FrameRequest, camera: Camera, place: Any) -> Drawn:
        if request.mode == "centers":
            return Drawn(self._centers(request, camera))
        image, alpha, depth = self._render(request, camera, place, request.mode != "color")
        if request.mode == "color":
            return Drawn(to_uint8(image))
        if request.mode == "alpha":
            return Drawn(np.repeat(to_uint8(alpha)[..., None], 3, axis=2))
        if request.mode == "error":
            return self._error(request, image)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.where(alpha > SEEN, depth / alpha, np.nan)
        if request.mode == "normal":
            return Drawn(self._normals(camera, request.pose, distance))
        known = distance[::_SAMPLES, ::_SAMPLES]
        known = known[np.isfinite(known)]
        span = tuple(np.percentile(known, _RANGE_PERCENT)) if len(known) else (1.0, 2.0)
        near, far = float(span[0]), max(float(span[1]), float(span[0]) * 1.001 + 1e-9)
        with np.errstate(invalid="ignore"):  # even steps of 1 / distance: near things differ more
            level = (1 / distance - 1 / far) / (1 / near - 1 / far)
        return Drawn(_colored(level, np.isfinite(distance), "TURBO"), (near, far))

    def _render(
        self, request: FrameRequest, camera: Camera, place: Any, with_depth: bool = True
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        shape = (camera.height, camera.width)
        if not self._buffers or self._buffers[1].shape != shape:
            self._buffers = tuple(np.zeros((*shape, *rest), np.float32) for rest in ((3,), (), ()))
        image, alpha, depth = self._buffers
        gaussians = self._gaussians(request)
        if gaussians is None or not len(gaussians):
            image[:], alpha[:], depth[:] = solid(self.stage.background), 0, 0
            return image, alpha, depth
        gaussians = self._for_pixels(gaussians, request, camera, place)
        if isinstance(gaussians, StoredGaussians):
            seen = render(gaussians, camera, place, background=self.stage.background)
            return seen.image, seen.alpha, seen.depth
        fills = self.stage.background is None
        self._renderer.render(
            gaussians,
            _core.RenderJob(
                camera,
                place_about(place, gaussians.origin),
                rule=self._rule,
                background=solid(self.stage.background),
                sh_degree=gaussians.sh_degree,
                keep=False,
            ),
            image,
            alpha if with_depth or fills else None,
            depth if with_depth else None,
        )
        return with_surroundings(image, alpha, camera) if fills else image, alpha, depth

    def _for_pixels(self, gaussians: Any, request: FrameRequest, camera: Camera, place: Any) -> Any:
        """A run's Gaussians as wide as the pixels of a frame ask.

        As they are while the eye moves, for it takes time, and in PNGs, which are exact.
        """
        scene = self.stage.scene
        at_rest = request.quality is not None and request.quality >= _FULL_QUALITY
        if not at_rest or scene is None or self.stage.kind != "run":
            return gaussians
        if not is_coarser(camera, scene.cameras):
            return gaussians
        if self._pixels is None or self._pixels.gaussians is not gaussians:
            self._pixels = PixelFilter.of_run(gaussians, scene, _FILTER_CAMERAS)
        return self._pixels.of(camera, place)

    def whole(self) -> Gaussians:
        """All Gaussians of the stage, none where there are none."""
        g = self.stage.gaussians
        if g is None:
            raise InputError("there are no Gaussians here")
        return g if isinstance(g, Gaussians) else g.to_gaussians()

    def kept(self, whole: Gaussians, crop: np.ndarray | None, clean: bool) -> np.ndarray:
        """(N,) bool: inside the crop box and, if `clean`, no floaters."""
        kept = np.ones(len(whole), bool)
        if crop is not None:
            at = self._in_axes(whole)
            kept = np.all((at >= crop[0]) & (at <= crop[1]), axis=1)
        if clean and self.floaters is not None and len(self.floaters) == len(whole):
            kept &= ~self.floaters
        return kept

    def _in_axes(self, whole: Gaussians) -> np.ndarray:
        return (whole.means + (whole.origin - self.center)) @ self.axes.T / self.extent

    def _gaussians(self, request: FrameRequest) -> Any:
        """The Gaussians inside the crop box, and of these the share that is seen most."""
        g, crop, share = self.stage.gaussians, request.crop, request.share
        if isinstance(g, StoredGaussians):
            if crop is None:
                return g
            return g.with_change(lambda part: part[self.kept(part, crop, False)])
        clean = request.clean and self.floaters is not None
        some = share < 1 and self.stage.kind != "training"
        if g is None or not (some or clean or crop is not None):
            return g
        if self._chosen.get("of") is not g:
            self._chosen = {"of": g}
        key = share, clean, None if crop is None else crop.tobytes()
        if key not in self._chosen:
            boxes = (None, key[2])
            for old in [o for o in self._chosen if o != "of" and o[2] not in boxes]:
                del self._chosen[old]  # of a box as it was before
            whole = self.whole()
            kept = self.kept(whole, crop, clean)
            if some:
                kept &= select_most_seen(whole, self._in_axes(whole), share)
            self._chosen[key] = pack_harmonics(whole[kept])
        return self._chosen[key]

    def _centers(self, request: FrameRequest, camera: Camera) -> np.ndarray:
        image = np.zeros((camera.height, camera.width, 3), np.uint8)
        gaussians = self._gaussians(request)
        if gaussians is not None and len(gaussians):
            if not isinstance(gaussians, Gaussians):
                gaussians = gaussians.to_gaussians()
            colors = to_uint8(0.5 + SH_C0 * gaussians.sh[:, 0])
            centers = gaussians.means + gaussians.origin
            draw_points(image, camera, request.pose, centers, colors)
        return image

    def _error(self, request: FrameRequest, image: np.ndarray) -> Drawn:
        """The mean absolute difference from the photograph, where it can be compared."""
        import cv2

        scene = self.stage.scene
        if scene is None or request.view is None:
            raise InputError("the error needs a photograph: choose one")
        height, width = image.shape[:2]
        truth = shrink_image(scene.image(request.view), width, height)
        mask = scene.mask(request.view)
        if mask.shape != (height, width):
            mask = cv2.resize(mask.view(np.uint8), (width, height)) > 0
        off = np.abs(np.clip(image, 0, 1) - truth.astype(np.float32) / 255).mean(axis=2)
        return Drawn(_colored(off / _MOST_ERROR, mask, "INFERNO"), (0.0, _MOST_ERROR))

    def _normals(self, camera: Camera, pose: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """Surface normals of the distances, in the scene's axes: right, up, forward as RGB."""
        rays = np.nan_to_num(camera.rays()[0]).astype(np.float32)
        points = rays * distance[..., None].astype(np.float32)
        if not camera.is_central:
            points = points + np.nan_to_num(camera.origins()).astype(np.float32)
        right = np.zeros_like(points)
        down = np.zeros_like(points)
        right[:, 1:-1] = points[:, 2:] - points[:, :-2]
        down[1:-1] = points[2:] - points[:-2]
        normal = np.cross(down, right)
        with np.errstate(invalid="ignore", divide="ignore"):
            normal /= np.linalg.norm(normal, axis=2, keepdims=True)
        away = np.sum(normal * rays, axis=2) > 0
        normal[away] *= -1
        turned = normal @ (self.axes @ pose[:3, :3].T).T.astype(np.float32)
        turned[~np.isfinite(turned).all(axis=2)] = -1
        return to_uint8((turned + 1) / 2)

    def _draw_axes(
        self, image: np.ndarray, camera: Camera, pose: np.ndarray, ground: np.ndarray | None
    ) -> None:
        """A grid on the ground, or on the plane through the scene's middle across its up axis."""
        axes, middle = self.axes, self.center
        if ground is not None:
            axes = axes @ rotate_upright(axes[1]).T @ rotate_upright(ground[:3])
            middle = middle + (ground[3] - ground[:3] @ middle) * ground[:3]
        lines = np.linspace(-1, 1, 11)
        a = [(x, 0, -1) for x in lines] + [(-1, 0, z) for z in lines]
        b = [(x, 0, 1) for x in lines] + [(1, 0, z) for z in lines]
        starts, ends = (np.array(side) * self.extent @ axes + middle for side in (a, b))
        draw_lines(image, camera, pose, starts, ends, [(120, 130, 145)] * len(a))


def _colored(level: np.ndarray, known: np.ndarray, colors: str) -> np.ndarray:
    """(H, W, 3) uint8: levels 0 to 1 in a colour map, black where not known."""
    import cv2

    levels = to_uint8(np.where(known, level, 0))
    mapped = cv2.applyColorMap(levels, getattr(cv2, f"COLORMAP_{colors}")) * known[..., None]
    return cv2.cvtColor(mapped, cv2.COLOR_BGR2RGB)
