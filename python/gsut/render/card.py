"""Draws on a graphics card by WebGPU: calls the shaders of forward.wgsl, reads images back.

Adapters differ in how they round exp2 and division, so bits belong to one adapter; on it, the same
frame has the same bits each time: no sum depends on the order of threads.
"""

from __future__ import annotations

import functools
import importlib.resources
import warnings
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.gaussians import Gaussians, LinearGaussians, StoredGaussians
from gsut.render.card_tiles import TILE_PIXELS, find_tiles
from gsut.render.soundness import sum_bits

ON_CARD = "card"  # stands for the renderer of an image that a graphics card drew

_DEVICES = ("cpu", "gpu")
# What forward.wgsl draws.
_RESPONSE = "maximum"
_ORDERS = ("distance", "z")
_GROUP = 256  # threads of a workgroup, in all shaders
_MOST_GROUPS = 65535  # of one dispatch, by WebGPU's limits
_RADIX_BITS = 4  # of the keys that one pass of the sort looks at
_RECORD_FLOATS = 20  # of a Gaussian, in forward.wgsl
_SPLAT_FLOATS = 11  # mean, quaternion, scales, opacity
_PART_ROWS = (
    64  # a part of the Gaussians is a multiple of it: bindings begin at multiples of 256 bytes
)
_KEY_BITS = 32  # of a distance
_LEAST_COVERED = 1e-3  # share of a pixel below which its distortion counts as 0, as on the CPU
_LARGEST = float(np.finfo(np.float32).max)
_LIMITS = ("max-buffer-size", "max-storage-buffer-binding-size")
_SHADERS = (
    "make_records", "count_digits", "scatter", "scan", "order_counts", "list_pairs", "find_tiles",
    "blend",
)  # fmt: skip


class CardRefusal(Exception):
    """Why a frame cannot be drawn on a card: a sentence without its end."""


class Card:
    """One adapter, its shaders and the Gaussians that were drawn last.

    Args:
        adapter: of wgpu.

    Attributes:
        name: of the adapter, as its driver gives it.
    """

    def __init__(self, adapter: Any) -> None:
        import wgpu

        self.name = adapter.info["device"] or adapter.info["description"]
        self._usage = wgpu.BufferUsage
        self._most = min(adapter.limits[key] for key in _LIMITS)
        limits = {key: adapter.limits[key] for key in _LIMITS}
        self._device = adapter.request_device_sync(required_limits=limits)
        files = importlib.resources.files("gsut.render")
        text = (files / "forward.wgsl").read_text(encoding="utf-8")
        module = self._device.create_shader_module(code=text)
        self._pipelines = {
            name: self._device.create_compute_pipeline(
                layout="auto", compute={"module": module, "entry_point": name}
            )
            for name in _SHADERS
        }
        # Mark of the Gaussians, and parts that fit one binding each: first row, splats, harmonics.
        self._scene: tuple[Any, list[tuple[int, Any, Any]]] = (None, [])

    def draw(
        self, gaussians: Any, mark: Any, camera: Any, place: np.ndarray, rule: Any, sh_degree: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Draws Gaussians over black.

        Args:
            gaussians: float32, about the origin that `place` is about.
            mark: changes if the Gaussians do; the ones drawn last stay on the card.
            camera: of a lens whose rays meet in one point.
            place: (4, 4) camera_from_world.
            rule: the `BlendRule`.
            sh_degree: harmonics above it are ignored.

        Returns:
            Image, transmittance (0 where a pixel has no ray), depth and distortion, as `Render`.

        Raises:
            CardRefusal: the adapter has no room for it.
        """
        tiles = find_tiles(camera)
        size, across_down = len(gaussians), tiles.tiles[0] * tiles.tiles[1]
        self._check_groups(size, "Gaussians")
        if across_down > _MOST_GROUPS:
            raise CardRefusal(f"{self.name} draws at most {_MOST_GROUPS} tiles of 16 x 16 pixels")
        stored = (gaussians.sh_degree + 1) ** 2
        look = _describe_view(place, rule)

        def make_view(first: int, count: int) -> Any:
            whole = [count, *tiles.tiles, sh_degree, *tiles.cells, stored, first]
            return self._make_uniform(look, np.array(whole, np.uint32))

        view = make_view(0, size)
        cones, rays = self._upload(tiles.cones), self._upload(tiles.rays)
        parts = self._keep_scene(gaussians, mark)
        records, order, begin, num_pairs = self._order(size, parts, view, make_view, cones)
        work = self._device.create_command_encoder()
        tile_begin, pairs = self._make_room(across_down + 1), self._make_room(1)
        if num_pairs:
            pairs = self._list_pairs(
                work, view, cones, (records, order, begin), num_pairs, (size, across_down),
                tile_begin,
            )  # fmt: skip
        colors = self._make_room(4 * across_down * TILE_PIXELS)
        distances = self._make_room(4 * across_down * TILE_PIXELS)
        self._call(work, "blend", across_down, {
            (0, 0): view, (0, 3): cones, (0, 4): records, (1, 8): tile_begin, (3, 0): rays,
            (3, 1): pairs, (3, 2): colors, (3, 3): distances,
        })  # fmt: skip
        self._device.queue.submit([work.finish()])
        color, along = (
            tiles.join(self._read(each, 4 * across_down * TILE_PIXELS))
            for each in (colors, distances)
        )
        left = color[..., 3]
        covered = tiles.join(tiles.rays[..., 3])[..., 0] - left
        return color[..., :3], left, along[..., 0], _find_distortion(along, covered)

    def _order(
        self, size: int, parts: list[tuple[int, Any, Any]], view: Any, make_view: Any, cones: Any
    ) -> tuple[Any, Any, Any, int]:
        """Makes records, and sorts them by distance: records, order, first pairs, their number."""
        records = self._make_room(_RECORD_FLOATS * size)
        keys, values, counts = (self._make_room(size) for _ in range(3))
        begin = self._make_room(size + 1)
        work = self._device.create_command_encoder()
        groups = -(-size // _GROUP)
        ends = [*(first for first, _, _ in parts[1:]), size]
        for (first, splats, harmonics), end in zip(parts, ends, strict=True):
            rows = end - first
            single = {"offset": 4 * first, "size": 4 * rows}
            whole = {name: _RECORD_FLOATS * value for name, value in single.items()}
            self._call(work, "make_records", -(-rows // _GROUP), {
                (0, 0): make_view(first, rows), (0, 1): splats, (0, 2): harmonics, (0, 3): cones,
                (0, 4): {"buffer": records, **whole}, (0, 5): {"buffer": keys, **single},
                (0, 6): {"buffer": values, **single}, (0, 7): {"buffer": counts, **single},
            })  # fmt: skip
        _, order = self._sort(work, keys, values, size, _KEY_BITS)
        self._call(work, "order_counts", groups, {
            (0, 0): view, (0, 7): counts, (1, 6): order, (1, 7): begin,
        })  # fmt: skip
        self._scan(work, begin, size)
        self._device.queue.submit([work.finish()])
        num_pairs = np.frombuffer(self._device.queue.read_buffer(begin, 4 * size, 4), np.uint32)
        return records, order, begin, int(num_pairs[0])

    def _list_pairs(
        self, work: Any, view: Any, cones: Any, ordered: tuple[Any, Any, Any], num_pairs: int,
        counts: tuple[int, int], tile_begin: Any,
    ) -> Any:  # fmt: skip
        """Lists (tile, Gaussian) pairs by tile, nearest first, and where each tile's begin."""
        self._check_groups(num_pairs, "pairs of a tile and a Gaussian")
        records, order, begin = ordered
        size, num_tiles = counts
        keys, pairs = self._make_room(num_pairs), self._make_room(num_pairs)
        self._call(work, "list_pairs", -(-size // _GROUP), {
            (0, 0): view, (0, 3): cones, (0, 4): records, (1, 3): keys, (1, 4): pairs,
            (1, 6): order, (1, 7): begin,
        })  # fmt: skip
        keys, pairs = self._sort(work, keys, pairs, num_pairs, num_tiles.bit_length())
        self._call(work, "find_tiles", -(-num_pairs // _GROUP), {
            (0, 0): view, (1, 0): self._make_uniform(np.array([num_pairs, 0, 0, 0], np.uint32)),
            (1, 1): keys, (1, 8): tile_begin,
        })  # fmt: skip
        return pairs

    def _sort(self, work: Any, keys: Any, values: Any, count: int, bits: int) -> tuple[Any, Any]:
        """Sorts stably by the lowest bits of the keys; returns the buffers that hold the result."""
        blocks = -(-count // _GROUP)
        spare = (self._make_room(count), self._make_room(count))
        counts = self._make_room((1 << _RADIX_BITS) * blocks + 1)
        for shift in range(0, bits, _RADIX_BITS):
            what = self._make_uniform(np.array([count, shift, blocks, 0], np.uint32))
            self._call(work, "count_digits", blocks, {
                (1, 0): what, (1, 1): keys, (1, 5): counts,
            })  # fmt: skip
            self._scan(work, counts, (1 << _RADIX_BITS) * blocks)
            self._call(work, "scatter", blocks, {
                (1, 0): what, (1, 1): keys, (1, 2): values, (1, 3): spare[0], (1, 4): spare[1],
                (1, 5): counts,
            })  # fmt: skip
            (keys, values), spare = spare, (keys, values)
        return keys, values

    def _scan(self, work: Any, sums: Any, count: int) -> None:
        what = self._make_uniform(np.array([count, 0, 0, 0], np.uint32))
        self._call(work, "scan", 1, {(2, 0): what, (2, 1): sums})

    # --- what goes to the card and comes back ---

    def _keep_scene(self, gaussians: Any, mark: Any) -> list[tuple[int, Any, Any]]:
        """Uploads Gaussians, unless they are there, in parts that fit one binding each."""
        if self._scene[0] == mark and mark is not None:
            return self._scene[1]
        self._scene = (None, [])  # its memory is free before the next is uploaded
        g = gaussians if isinstance(gaussians, Gaussians) else gaussians.to_gaussians()
        columns = (g.means, g.quats, g.log_scales, g.opacity_logits.reshape(-1, 1))
        splats = np.concatenate(columns, axis=1, dtype=np.float32)
        assert splats.shape[1] == _SPLAT_FLOATS
        row_bytes = 4 * max(_SPLAT_FLOATS, 3 * g.sh.shape[1])
        rows = max(1, self._most // row_bytes // _PART_ROWS) * _PART_ROWS
        parts = [
            (first, self._upload(splats[first : first + rows]),
             self._upload(g.sh[first : first + rows]))
            for first in range(0, len(g), rows)
        ]  # fmt: skip
        self._scene = (mark, parts)
        return parts

    def _check_groups(self, count: int, what: str) -> None:
        if count > _MOST_GROUPS * _GROUP:
            raise CardRefusal(f"{count:,} {what} are more than {_MOST_GROUPS * _GROUP:,}")

    def _check_size(self, size: int) -> int:
        if size > self._most:
            raise CardRefusal(
                f"{self.name} takes arrays of {self._most / 1e6:,.0f} MB, and this frame needs one "
                f"of {size / 1e6:,.0f} MB"
            )
        return size

    def _upload(self, array: np.ndarray) -> Any:
        data = np.ascontiguousarray(array)
        self._check_size(data.nbytes)
        return self._device.create_buffer_with_data(data=data, usage=self._usage.STORAGE)

    def _make_room(self, count: int) -> Any:
        """Makes an array of numbers of 4 bytes, all zero."""
        usage = self._usage.STORAGE | self._usage.COPY_SRC
        size = self._check_size(4 * max(count, 4))
        return self._device.create_buffer(size=size, usage=usage)

    def _make_uniform(self, *parts: np.ndarray) -> Any:
        data = b"".join(part.tobytes() for part in parts)
        return self._device.create_buffer_with_data(data=data, usage=self._usage.UNIFORM)

    def _read(self, buffer: Any, count: int) -> np.ndarray:
        data = self._device.queue.read_buffer(buffer, 0, 4 * count)
        return np.frombuffer(data, np.float32)

    def _call(
        self, work: Any, shader: str, groups: int, bindings: dict[tuple[int, int], Any]
    ) -> None:
        """Runs a shader; bindings: buffers, or parts of buffers, by (group, binding)."""
        pipeline = self._pipelines[shader]
        call = work.begin_compute_pass()
        call.set_pipeline(pipeline)
        for group in sorted({group for group, _ in bindings}):
            entries = [
                {"binding": binding,
                 "resource": what if isinstance(what, dict) else {"buffer": what}}
                for (where, binding), what in bindings.items()
                if where == group
            ]  # fmt: skip
            layout = pipeline.get_bind_group_layout(group)
            call.set_bind_group(
                group, self._device.create_bind_group(layout=layout, entries=entries)
            )
        call.dispatch_workgroups(groups)
        call.end()


def _describe_view(place: np.ndarray, rule: Any) -> np.ndarray:
    """Makes the floats of the shaders' View; the camera's centre keeps the digits a float takes."""
    rotation = place[:3, :3]
    center = -rotation.T @ place[:3, 3]
    high = center.astype(np.float32)
    cutoff = -2.0 * np.log(rule.response_min) if rule.response_min > 0.0 else _LARGEST
    rows = [
        [*high, np.log2(rule.alpha_min)], [*(center - high), cutoff],
        [*rotation[0], rule.alpha_max], [*rotation[1], rule.transmittance_min],
        [*rotation[2], float(rule.order == "z")],
        [*np.clip([rule.near_z, rule.far_z], -_LARGEST, _LARGEST), float(rule.stop_before), 0],
    ]  # fmt: skip
    return np.array(rows, np.float32)


def _find_distortion(along: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """Finds the squared distances about their mean from those about the first one."""
    shift = along[..., 0] - covered * along[..., 1]
    counts = covered >= _LEAST_COVERED
    spread = along[..., 2] - shift * shift / np.where(counts, covered, 1.0)
    return np.where(counts, np.maximum(spread, 0.0), 0.0).astype(np.float32)


@functools.lru_cache(maxsize=1)
def find_card() -> Card | str:
    """Finds the fastest adapter; without one, returns why there is none."""
    try:
        import wgpu
    except ImportError:
        return "the package wgpu is not installed (pip install 'gsut[gpu]')"
    try:
        return Card(wgpu.gpu.request_adapter_sync(power_preference="high-performance"))
    except Exception as error:  # drivers raise what they like
        return f"this machine has no graphics card that WebGPU can use ({error})"


def draw_on_card(
    gaussians: Any, mark: Any, camera: Any, place: Any, rule: Any, sh_degree: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Draws as `Card.draw`, with whatever card there is.

    Raises:
        CardRefusal: there is no card, or it cannot draw this frame.
    """
    card = find_card()
    if isinstance(card, str):
        raise CardRefusal(card)
    if not isinstance(place, np.ndarray) or not camera.is_central:
        raise CardRefusal(
            "a rolling shutter, or a lens without one centre, has rays of many origins"
        )
    if len(gaussians) == 0:
        raise CardRefusal("there are no Gaussians")
    primitive = getattr(gaussians, "primitive", Gaussians.PRIMITIVES[0])
    if primitive != Gaussians.PRIMITIVES[0]:
        raise CardRefusal(f"it draws Gaussians only, found primitive {primitive}")
    order = gaussians.order if rule.order == "model" else rule.order
    if gaussians.response != _RESPONSE or order not in _ORDERS:
        raise CardRefusal(
            f"it knows the response {_RESPONSE} and the orders {' and '.join(_ORDERS)} only"
        )
    try:
        return card.draw(gaussians, mark, camera, place, rule, sh_degree)
    except (CardRefusal, InputError):
        raise
    except Exception as error:  # out of memory, a lost device: drivers raise what they like
        find_card.cache_clear()
        raise CardRefusal(f"{card.name} failed ({error})") from error


def check_device(device: str, dtype: str, gaussians: Any, has_features: bool) -> None:
    """Rejects what a graphics card does not draw, and warns where the CPU does in its place."""
    if device not in _DEVICES:
        raise InputError(f'device "{device}" is unknown; known: {", ".join(_DEVICES)}')
    if device == "cpu":
        return
    if dtype != "float32":
        raise InputError(f'device "gpu" draws in float32; leave dtype="{dtype}" out, or device')
    if has_features or isinstance(gaussians, LinearGaussians):
        raise InputError('device "gpu" draws no features and no LinearGaussians; leave it out')
    if isinstance(gaussians, StoredGaussians):
        _warn_of_cpu("Gaussians that stay in their file are read for each image")


def draw_or_warn(
    drawn: Any, camera: Any, place: Any, look: dict[str, Any]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """Draws image, alpha, depth and distortion; None, with a warning, where no card can."""
    try:
        color, left, depth, distortion = draw_on_card(
            drawn, sum_bits(drawn), camera, place, look["rule"], look["sh_degree"]
        )
    except CardRefusal as refusal:
        _warn_of_cpu(str(refusal))
        return None
    has_ray = camera.rays()[1]
    image = color + left[..., None] * np.float32(look["background"])
    return image, np.where(has_ray, np.float32(1.0) - left, np.float32(0.0)), depth, distortion


def _warn_of_cpu(reason: str) -> None:
    warnings.warn(f"drawn on the CPU: {reason}", RuntimeWarning, stacklevel=4)
