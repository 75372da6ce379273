"""Draws a scene that stays in its file: what the lens' cone, or that of a few tiles, may see."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.gaussians import Gaussians, StoredGaussians
from gsut.run import format_size

_TILE = 16  # pixels a side
# Gaussians that are widened to the image's pixels reach out of the balls that hold them, by less
# than a pixel: what lies up to this many pixels outside is read, too.
_MARGIN_PIXELS = 3.0
_LEAST_MARGIN = 1e-5  # radians: of rounding to float32


class StoredImage:
    """One image of Gaussians in a file; bit by bit that of the same in memory.

    Where those that it shows take more memory than may be used, it is drawn in parts, each with
    the Gaussians that the cone of its own rays may see.

    Args:
        gaussians: in the file.
        camera, place: as the core takes them, about the Gaussians' origin.
        look: rule, background, sh_degree and unscented of `_core.RenderJob`.

    Attributes:
        seen: the Gaussians that were drawn, where they were drawn at once; None: in parts.
    """

    def __init__(
        self,
        gaussians: StoredGaussians,
        camera: _core.Camera,
        place: Any,
        look: dict[str, Any],
    ) -> None:
        if look["rule"].alpha_min < StoredGaussians.LEAST_ALPHA:
            raise InputError("a blend rule with alpha_min below 1/255 needs Gaussians in memory")
        self._gaussians, self._camera, self._place = gaussians, camera, place
        self._look = look
        self._renderer = _core.Renderer()
        self.seen: Any = None
        self._shape = camera.height, camera.width
        self._find_rays()

    def draw(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Draws image, alpha, depth and distortion.

        Raises:
            InputError: not even a tile's Gaussians fit.
        """
        out = self._make_images()
        self._draw(out, 0, 0, -(-self._shape[0] // _TILE), -(-self._shape[1] // _TILE))
        return out

    @property
    def renderer(self) -> _core.Renderer | None:
        """The renderer that has drawn `seen`, with all that it keeps of it; None without `seen`."""
        return None if self.seen is None else self._renderer

    def _make_images(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        image, *rest = (np.zeros((*self._shape, *s), np.float32) for s in ((3,), (), (), ()))
        return image, rest[0], rest[1], rest[2]

    def _render(self, gaussians: Any, out: Any, keep: bool, tiles: np.ndarray | None) -> None:
        job = _core.RenderJob(self._camera, self._place, **self._look, tiles=tiles, keep=keep)
        self._renderer.render(gaussians, job, *out)

    def _find_rays(self) -> None:
        """Finds the rays of all pixels as the renderer has them, for any lens and motion."""
        shapes = ((0, 3), (0, 4), (0, 3), (0,), (0, 1, 3))
        nothing = Gaussians(*(np.zeros(shape, np.float32) for shape in shapes))
        self._render(nothing, self._make_images(), True, None)
        self._rays, self._starts = self._renderer.rays()
        place = self._place
        pose = place.at(0.5) if isinstance(place, _core.CameraMotion) else np.asarray(place)
        self._center = -pose[:3, :3].T @ pose[:3, 3]
        self._valid = np.asarray(self._rays.any(axis=2))
        self._margin = _LEAST_MARGIN
        if self._gaussians.change is not None:
            self._margin += _MARGIN_PIXELS * self._measure_largest_pixel()

    def _measure_largest_pixel(self) -> float:
        """Measures the largest angle between neighbouring pixels."""
        largest = 0.0
        for a, b in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
            both = self._valid[a] & self._valid[b]
            chords = np.linalg.norm(self._rays[a][both] - self._rays[b][both], axis=1)
            largest = max(largest, float(chords.max(initial=0.0)))
        return 2.0 * float(np.arcsin(min(1.0, 0.5 * largest)))

    def _draw(self, out: Any, top: int, left: int, bottom: int, right: int) -> None:
        """Draws tiles [top, bottom) x [left, right), in parts where it must be."""
        part = np.s_[top * _TILE : bottom * _TILE, left * _TILE : right * _TILE]
        valid = self._valid[part]
        pieces = self._find_seen(self._rays[part][valid], self._starts[part][valid])
        size, limit = self._gaussians.estimate_bytes(pieces), self._gaussians.limit
        rows, columns = bottom - top, right - left
        if size > limit and rows * columns > 1:
            if rows >= columns:
                middle = (top + bottom) // 2
                self._draw(out, top, left, middle, right)
                self._draw(out, middle, left, bottom, right)
            else:
                middle = (left + right) // 2
                self._draw(out, top, left, bottom, middle)
                self._draw(out, top, middle, bottom, right)
            return
        if size > limit:
            raise InputError(
                f"{format_size(limit)} of memory do not hold what 16 x 16 pixels may see of the "
                f"scene, {format_size(size)}; free some memory, or compact the scene "
                "(gsut compact)"
            )
        whole = rows * _TILE >= self._shape[0] and columns * _TILE >= self._shape[1]
        tiles = None
        if not whole:
            tiles = np.zeros([-(-side // _TILE) for side in self._shape], np.uint8)
            tiles[top:bottom, left:right] = 1
        drawn = out if whole else self._make_images()
        some = self._gaussians.read(pieces)
        self._render(some, drawn, whole, tiles)
        if whole:
            self.seen = some
        if not whole:
            for to, new in zip(out, drawn, strict=True):
                to[part] = new[part]

    def _find_seen(self, rays: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Finds the pieces that rays (n, 3) from starts (n, 3) about the centre may see."""
        if not len(rays):
            return np.zeros(0, np.int64)
        rays, starts = rays.astype(np.float64), starts.astype(np.float64)
        middle = starts.mean(axis=0)
        around = float(np.linalg.norm(starts - middle, axis=1).max())
        return self._gaussians.find_seen_pieces(self._center + middle, around, rays, self._margin)
