"""Films a walk through the demo's hall as a real camera would, with everything about it known.

Each row has its own time (rolling shutter), each pixel several within the exposure (motion blur);
light drifts, the sensor is noisy, and H.264 compresses.
"""

from __future__ import annotations

import dataclasses
import fractions
import math
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from gsut._core import num_threads
from gsut.data.poses import invert_pose
from gsut.lens import Camera
from lab.demo_tracer.hall import make_hall
from lab.demo_tracer.tracing import Tracer
from tests.python.small_videos import turn_by_quarter

# World-from-camera poses (N, 4, 4) at times (N,) in seconds.
Path4 = Callable[[np.ndarray], np.ndarray]
_BLOCK_ROWS = 18  # pixels traced at once: rays and hits of a block stay in the cache
_BLOCK_COLUMNS = 48
_SPREAD = np.array([0.7549, 0.5698])  # of samples over a pixel: Roberts' sequence in the plane
_NOISE = 1.5  # grey levels, standard deviation, as of a small sensor indoors
_DRIFT = 0.07  # of the exposure, as an automatic one does indoors
_TINT = 0.02  # of the white balance
_DRIFT_SECONDS = 11.0  # period of both


@dataclasses.dataclass(frozen=True)
class Film:
    """How a walk is filmed.

    Args:
        camera: the lens, at the film's size.
        path: where the camera is.
        seconds: length of the film.
        frame_rate: frames a second.
        readout: seconds from the first row to the last; below 0: from the last to the first.
        exposure: seconds.
        crf: of H.264: 18 hardly visible, 28 rough.
        samples: rays a pixel: also moments within the exposure.
        contrast: of the hall's textures and light; 1: as painted.
        seed: of the hall's textures and of the noise.
        sideways: a phone held upright: columns are read one after the other, and the file holds
            lying pictures with the flag that turns them.
        back: a second lens of the same size, whose pictures stand at the right of those of the
            first; where a lens has no ray its pictures are black.
        back_from_front: (4, 4) of it.
        back_readout: seconds of its readout; None: as that of the first.
    """

    camera: Camera
    path: Path4
    seconds: float = 20.0
    frame_rate: float = 12.0
    readout: float = 0.016
    exposure: float = 0.008
    crf: int = 22
    samples: int = 3
    contrast: float = 1.0
    seed: int = 1
    sideways: bool = False
    back: Camera | None = None
    back_from_front: np.ndarray | None = None
    back_readout: float | None = None

    @property
    def readouts(self) -> list[float]:
        """Seconds of each lens' readout."""
        return [self.readout, self.readout if self.back_readout is None else self.back_readout]

    @property
    def lenses(self) -> list[tuple[Camera, np.ndarray]]:
        """Each lens with its (4, 4) front_from_lens."""
        if self.back is None or self.back_from_front is None:
            return [(self.camera, np.eye(4))]
        return [(self.camera, np.eye(4)), (self.back, invert_pose(self.back_from_front))]

    @property
    def times(self) -> np.ndarray:
        """(N,) seconds of the frames: the middle of exposure and readout."""
        return np.arange(round(self.seconds * self.frame_rate)) / self.frame_rate


def plan_walk(
    seconds: float,
    *,
    around: float = 1.0,
    looking: float = 1.0,
    forward: float = 0.0,
    bob: float = 0.02,
    shake_degrees: float = 0.6,
    seed: int = 0,
) -> Path4:
    """Describes a walk around the hall's table.

    Args:
        seconds: of the film.
        around: rounds about the table; 0: on the spot.
        looking: how far the camera looks about on the way, of about 50 degrees to both sides.
        forward: metres a second straight on instead of around the table, looking ahead.
        bob: metres up and down at each step.
        shake_degrees: of a hand, root mean square.
        seed: of the phases.
    """
    rng = np.random.default_rng([seed, 5])
    phase = rng.uniform(0, 2 * math.pi, 16)
    # A hand shakes at 0.7 to 5 hertz, the slower the more.
    rates = np.geomspace(0.7, 5.0, 5)
    shares = shake_degrees * rates**-0.7 / math.sqrt(0.5 * (rates**-1.4).sum())

    def shake(times: np.ndarray, first: int) -> np.ndarray:
        waves = np.sin(2 * math.pi * rates * times[:, None] + phase[first] + 1.7 * np.arange(5))
        return np.radians(waves @ shares)

    def place_camera(times: np.ndarray) -> np.ndarray:
        times = np.atleast_1d(np.asarray(times, np.float64))
        share = times / seconds
        turn = 2 * math.pi * around * share + phase[0]
        reach = 1.0 + 0.12 * np.sin(2 * turn + phase[1])
        x, y = 2.3 * reach * np.cos(turn), 1.8 * reach * np.sin(turn)
        yaw = turn + math.pi / 2
        if forward:
            x, y = -3.6 + forward * times, np.full_like(times, -2.85)
            yaw = np.zeros_like(times)
        z = 1.55 + bob * np.sin(2 * math.pi * 1.8 * times + phase[2])
        z = z + 0.15 * np.sin(2 * math.pi * 0.11 * times + phase[3])
        about = 0.9 * np.sin(2 * math.pi * 0.13 * times + phase[4])
        yaw = yaw + looking * about + shake(times, 5)
        pitch = -0.1 + 0.25 * looking * np.sin(2 * math.pi * 0.09 * times + phase[6])
        pitch = pitch + shake(times, 7)
        roll = 0.5 * shake(times, 8)
        return look_along(np.stack([x, y, z], axis=1), yaw, pitch, roll)

    return place_camera


def look_along(
    centers: np.ndarray, yaw: np.ndarray, pitch: np.ndarray, roll: np.ndarray
) -> np.ndarray:
    """Returns (N, 4, 4) poses: yaw about z from +x, pitch upwards, roll about the view."""
    forward = np.stack(
        [np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)], axis=1
    )
    level = np.stack([np.sin(yaw), -np.cos(yaw), np.zeros_like(yaw)], axis=1)
    down = np.cross(forward, level)
    right = np.cos(roll)[:, None] * level + np.sin(roll)[:, None] * down
    poses = np.tile(np.eye(4), (len(yaw), 1, 1))
    poses[:, :3, :3] = np.stack([right, np.cross(forward, right), forward], axis=2)
    poses[:, :3, 3] = centers
    return poses


def write_film(film: Film, target: Path) -> None:
    """Writes the film: H.264 in MP4."""
    import av

    camera = film.camera
    with av.open(str(target), "w") as out:
        rate = fractions.Fraction(film.frame_rate).limit_denominator(1001)
        options = {"crf": str(film.crf), "threads": "1"}  # several make other bits each time
        stream = out.add_stream("libx264", rate=rate, options=options)
        size = camera.width * len(film.lenses), camera.height
        stream.width, stream.height = size[::-1] if film.sideways else size
        stream.pix_fmt = "yuv420p"
        for picture in trace_frames(film):
            stored = np.ascontiguousarray(np.rot90(picture)) if film.sideways else picture
            out.mux(stream.encode(av.VideoFrame.from_ndarray(stored, format="rgb24")))
        out.mux(stream.encode(None))
    if film.sideways:
        turn_by_quarter(target, camera.height)


def trace_frames(film: Film) -> Iterator[np.ndarray]:
    """Yields each frame before compression: (H, W, 3) uint8 RGB."""
    rng = np.random.default_rng([film.seed, 6])
    tracer = Tracer(make_hall(film.seed), film.samples)
    lenses = [(spread_rays(camera, film.samples), pose) for camera, pose in film.lenses]
    with ThreadPoolExecutor(num_threads()) as pool:
        for time in film.times:
            parts = [
                _expose(film, tracer, rays, pose, time, pool, readout)
                for (rays, pose), readout in zip(lenses, film.readouts, strict=False)
            ]
            image = 0.5 + film.contrast * (np.hstack(parts) - 0.5)
            angle = 2 * math.pi * time / _DRIFT_SECONDS
            gain = 1 + _DRIFT * math.sin(angle) + _TINT * np.sin(angle / 2 + np.arange(3))
            noisy = 255 * image * gain + _NOISE * rng.standard_normal(image.shape)
            yield np.round(np.clip(noisy, 0, 255)).astype(np.uint8)


def spread_rays(camera: Camera, samples: int) -> np.ndarray:
    """Returns (S, H, W, 3) float32 unit rays, spread over each pixel, their mean in its middle."""
    spread = (np.arange(samples)[:, None] + 0.5) * _SPREAD % 1.0
    rays = []
    for dx, dy in spread - spread.mean(axis=0) + 0.5:
        x, y = np.meshgrid(np.arange(camera.width) + dx, np.arange(camera.height) + dy)
        found, _ = camera.unproject(np.stack([x.ravel(), y.ravel()], axis=1))
        rays.append(np.nan_to_num(found).astype(np.float32).reshape(*x.shape, 3))
    return np.stack(rays)


def _expose(
    film: Film,
    tracer: Tracer,
    rays: np.ndarray,
    front_from_lens: np.ndarray,
    time: float,
    pool: ThreadPoolExecutor,
    readout: float,
) -> np.ndarray:
    """Returns (H, W, 3) in [0, 1]: what a lens sees in the frame whose middle is at this time."""
    samples, height, width, _ = rays.shape
    lines = width if film.sideways else height
    of_line = ((np.arange(lines) + 0.5) / lines - 0.5) * readout
    # Neighbouring samples of a pixel are far apart in time.
    order = np.argsort(np.arange(samples) * 0.618 % 1.0)
    of_sample = ((order + 0.5) / samples - 0.5) * film.exposure
    poses = film.path((time + of_line + of_sample[:, None]).ravel()) @ front_from_lens
    poses = poses.reshape(samples, lines, 4, 4).astype(np.float32)

    def trace_block(block: tuple[slice, slice]) -> np.ndarray:
        own = rays[:, block[0], block[1]]
        seen = own.any(axis=3)
        if not seen.any():
            return np.zeros((*own.shape[1:3], 3))
        line = 2 if film.sideways else 1
        at = np.expand_dims(poses[:, block[line - 1]], 3 - line)
        rotation = at[..., :3, :3]
        directions = sum(rotation[..., k] * own[..., k, None] for k in range(3))
        origins = np.broadcast_to(at[..., :3, 3], directions.shape)
        shape = (samples, -1, 3)
        found = tracer.trace_colors(origins.reshape(shape), directions.reshape(shape))
        return found.reshape(*own.shape[1:3], 3) * seen.all(axis=0)[..., None]

    blocks = [
        (slice(y, y + _BLOCK_ROWS), slice(x, x + _BLOCK_COLUMNS))
        for y in range(0, height, _BLOCK_ROWS)
        for x in range(0, width, _BLOCK_COLUMNS)
    ]
    image = np.zeros((height, width, 3))
    for block, part in zip(blocks, pool.map(trace_block, blocks), strict=True):
        image[block] = part
    return image
