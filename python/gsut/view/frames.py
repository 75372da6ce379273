"""Draws the frames that the page requests, by gsut's renderer through the lens itself."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.data.images import shrink_image
from gsut.gaussians import (
    OPAQUE,
    SH_C0,
    Gaussians,
    StoredGaussians,
)
from gsut.lens import Camera
from gsut.orientation import turn_picture
from gsut.render import (
    PixelFilter,
    choose_solid,
    place_about,
    render,
    to_uint8,
    with_surroundings,
)
from gsut.view.frame_request import FULL_QUALITY, FrameRequest
from gsut.view.lenses import MOST_KEPT, Lenses
from gsut.view.measure import find_point_at
from gsut.view.overlays import (
    draw_cameras,
    draw_marks,
    draw_points,
    mark_without_ray,
)
from gsut.view.shown_gaussians import ShownGaussians
from gsut.view.stage import move_motion

# Percentiles of the distances that the colours span.
_RANGE_PERCENT = (2.0, 98.0)
# Error, of full scale, that is shown in the last colour.
_MOST_ERROR = 0.25
# Photographs that decide how fine a Gaussian was seen, evenly chosen.
_FILTER_CAMERAS = 8
# Pixels between samples for the range of distances.
_SAMPLES = 7


@dataclasses.dataclass
class Drawn:
    """A frame, (H, W, 3) uint8, and the range that its colours span, or None."""

    image: np.ndarray
    span: tuple[float, float] | None = None


class Frames:
    """Draws frames of a stage.

    Args:
        shown: the Gaussians of a stage.
        lenses: by number.
    """

    def __init__(self, shown: ShownGaussians, lenses: Lenses) -> None:
        self.shown, self.stage, self.lenses = shown, shown.stage, lenses
        self._renderer = _core.Renderer()
        self._rule = _core.BlendRule()
        self._buffers: tuple[np.ndarray, ...] = ()
        self._pixels: Any = None  # a PixelFilter

    def _release_large(self, camera: Camera) -> None:
        """Gives back the memory of a frame larger than those that screens request."""
        if camera.width * camera.height > MOST_KEPT:
            self._buffers, self._renderer = (), _core.Renderer()

    def encode(self, request: FrameRequest) -> tuple[bytes, str, tuple[float, float] | None]:
        """Returns a frame as a file: bytes, kind and the range of its colours."""
        import cv2

        drawn = self.draw(request)
        pixels = cv2.cvtColor(drawn.image, cv2.COLOR_RGB2BGR)
        if request.quality is None:
            _, data = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1])
            return data.tobytes(), "image/png", drawn.span
        _, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, request.quality])
        return data.tobytes(), "image/jpeg", drawn.span

    def draw(self, request: FrameRequest) -> Drawn:
        """Draws a frame with everything that lies over it, as the page shows it."""
        camera = self.lenses.resize(request.lens, request.width, request.height)
        place, pose = self._place(request), request.pose
        drawn = self._draw_picture(request, camera, place)
        image, scene, layers = drawn.image, self.stage.scene, request.layers
        if "domain" in layers:
            mark_without_ray(image, camera.rays()[1])
        if scene is not None and "points" in layers:
            draw_points(image, camera, pose, scene.points, scene.point_colors)
        if scene is not None and "cameras" in layers:
            draw_cameras(image, camera, pose, scene, request.view)
        if request.marks is not None and len(request.marks):
            draw_marks(image, camera, pose, request.marks)
        self._release_large(camera)
        drawn.image = turn_picture(image, request.turns)
        return drawn

    def find_point(self, request: FrameRequest, pixel: tuple[float, float]) -> np.ndarray | None:
        """Finds the point (3,) at the expected distance along a pixel's ray; None if nothing is
        there.

        Args:
            request: whose frame was clicked.
            pixel: x and y on the page's picture.
        """
        camera = self.lenses.resize(request.lens, request.width, request.height)
        place = self._place(request)
        _, alpha, depth = self._render(request, camera, place)
        self._release_large(camera)
        return find_point_at(place, camera, request.turn_back(pixel), alpha, depth)

    def _place(self, request: FrameRequest) -> Any:
        scene = self.stage.scene
        if request.shutter is None or scene is None:
            return request.pose
        view = scene.views[request.shutter]
        if np.array_equal(view.camera_from_world, request.pose):
            return view.motion
        return move_motion(scene, request.shutter, request.pose)

    def _draw_picture(self, request: FrameRequest, camera: Camera, place: Any) -> Drawn:
        if request.mode == "centers":
            return Drawn(self._draw_centers(request, camera))
        image, alpha, depth = self._render(request, camera, place, request.mode != "color")
        if request.mode in ("color", "error"):
            image = self._apply_light(image, request, camera)
        if request.mode == "color":
            return Drawn(to_uint8(image))
        if request.mode == "alpha":
            return Drawn(np.repeat(to_uint8(alpha)[..., None], 3, axis=2))
        if request.mode == "error":
            return self._draw_error(request, image)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.where(alpha > OPAQUE, depth / alpha, np.nan)
        if request.mode == "normal":
            return Drawn(_draw_normals(self.shown.axes, camera, request.pose, distance))
        known = distance[::_SAMPLES, ::_SAMPLES]
        known = known[np.isfinite(known)]
        span = tuple(np.percentile(known, _RANGE_PERCENT)) if len(known) else (1.0, 2.0)
        near, far = float(span[0]), max(float(span[1]), float(span[0]) * 1.001 + 1e-9)
        with np.errstate(invalid="ignore"):  # even steps of 1 / distance: near things differ more
            level = (1 / distance - 1 / far) / (1 / near - 1 / far)
        return Drawn(_apply_colors(level, np.isfinite(distance), "TURBO"), (near, far))

    def _render(
        self, request: FrameRequest, camera: Camera, place: Any, with_depth: bool = True
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        shape = (camera.height, camera.width)
        if not self._buffers or self._buffers[1].shape != shape:
            self._buffers = tuple(np.zeros((*shape, *rest), np.float32) for rest in ((3,), (), ()))
        image, alpha, depth = self._buffers
        stage, g = self.stage, self.shown.choose(request)
        fills, behind = stage.background is None, choose_solid(stage.background)
        if g is None or not len(g):
            image[:], alpha[:], depth[:] = behind, 0, 0
            return image, alpha, depth
        g = self._widen_for_pixels(g, request, camera, place)
        if isinstance(g, StoredGaussians):
            seen = render(g, camera, place, background=stage.background)
            return seen.image, seen.alpha, seen.depth
        job = _core.RenderJob(
            camera, place_about(place, g.origin), rule=self._rule, background=behind,
            sh_degree=g.sh_degree, keep=False,
        )  # fmt: skip
        covered = alpha if with_depth or fills else None
        self._renderer.render(g, job, image, covered, depth if with_depth else None)
        return with_surroundings(image, alpha, camera) if fills else image, alpha, depth

    def _widen_for_pixels(
        self, gaussians: Any, request: FrameRequest, camera: Camera, place: Any
    ) -> Any:
        """Widens a run's Gaussians to the pixels of a coarse frame.

        They stay unchanged while the eye moves, since it takes time, and in PNGs, which are exact.
        """
        scene = self.stage.scene
        at_rest = request.quality is not None and request.quality >= FULL_QUALITY
        if not at_rest or scene is None or self.stage.kind != "run":
            return gaussians
        if not PixelFilter.is_coarser(camera, scene.cameras):
            return gaussians
        if self._pixels is None or self._pixels.gaussians is not gaussians:
            self._pixels = PixelFilter.from_scene(gaussians, scene, _FILTER_CAMERAS)
        return self._pixels.widen(camera, place)

    def _draw_centers(self, request: FrameRequest, camera: Camera) -> np.ndarray:
        image = np.zeros((camera.height, camera.width, 3), np.uint8)
        gaussians = self.shown.choose(request)
        if gaussians is not None and len(gaussians):
            if not isinstance(gaussians, Gaussians):
                gaussians = gaussians.to_gaussians()
            colors = to_uint8(0.5 + SH_C0 * gaussians.sh[:, 0])
            centers = gaussians.means + gaussians.origin
            draw_points(image, camera, request.pose, centers, colors)
        return image

    def _draw_error(self, request: FrameRequest, image: np.ndarray) -> Drawn:
        """Draws the mean absolute difference from the photograph, where it can be compared."""
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
        return Drawn(_apply_colors(off / _MOST_ERROR, mask, "INFERNO"), (0.0, _MOST_ERROR))

    def _apply_light(self, image: np.ndarray, request: FrameRequest, camera: Camera) -> np.ndarray:
        """Multiplies an image by the light of the photograph that it is compared with."""
        scene, light, view = self.stage.scene, self.stage.light, request.view
        if scene is None or light is None or view is None:
            return image
        index = scene.views[view].camera_index
        return image * light.on(camera, view, index) if request.lens == index else image


def _draw_normals(
    axes: np.ndarray, camera: Camera, pose: np.ndarray, distance: np.ndarray
) -> np.ndarray:
    """Draws surface normals of the distances in the scene's `axes`: right, up, forward as RGB."""
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
    turned = normal @ (axes @ pose[:3, :3].T).T.astype(np.float32)
    turned[~np.isfinite(turned).all(axis=2)] = -1
    return to_uint8((turned + 1) / 2)


def _apply_colors(level: np.ndarray, known: np.ndarray, colors: str) -> np.ndarray:
    """Returns (H, W, 3) uint8: levels 0 to 1 in a colour map, black where unknown."""
    import cv2

    levels = to_uint8(np.where(known, level, 0))
    mapped = cv2.applyColorMap(levels, getattr(cv2, f"COLORMAP_{colors}")) * known[..., None]
    return cv2.cvtColor(mapped, cv2.COLOR_BGR2RGB)
