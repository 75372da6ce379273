"""Draws a capture from its seed: scene, lens, path, light, camera faults, what gsut is told."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np

from lab.mistakes import MISTAKES
from lab.proving.exposure import Sensor, draw_sensor
from lab.proving.families import FAMILIES
from lab.proving.lenses import DrawnLens, draw_lens, draw_other_name
from lab.proving.paints import Style
from lab.proving.paths import Motion, Path, plan_path
from lab.proving.stage import Stage

# Of everything that decides the pictures: another number makes another folder of the cache.
VERSION = 3
_KINDS = ("dataset", "photographs", "film")


@dataclasses.dataclass(frozen=True)
class Told:
    """What gsut is told of a capture besides its pictures.

    Args:
        lens: "file" (the true lens), "name" (of the database), "exif" or "nothing".
        is_wrong: the name or EXIF is that of another camera.
        name: of the database; empty: none.
        focal_35mm: of EXIF; None: no EXIF.
        mistake: index in `MISTAKES` made in the dataset; None: it is exact.
        points: whether the dataset has points.
        place_error: metres that the places in EXIF are off; None: EXIF has none.
        turned: photographs lie on their side, with EXIF's flag.
        dropped: share of a film's frames that are missing.
    """

    lens: str
    is_wrong: bool = False
    name: str = ""
    focal_35mm: float | None = None
    mistake: int | None = None
    points: bool = True
    place_error: float | None = None
    turned: bool = False
    dropped: float = 0.0


@dataclasses.dataclass(frozen=True)
class Capture:
    """A capture with everything known about it.

    Args:
        seed: of all that is drawn. family: of its scene. style: of its surfaces.
        lens: true lens. motion: how the camera moves. kind: "dataset", "photographs" or "film".
        readout: seconds from the first line to the last, below 0 upwards; 0: global.
        exposure: seconds. sensor: the camera's faults. samples: rays a pixel.
        told: what gsut is told.
    """

    seed: int
    family: str
    style: Style
    lens: DrawnLens
    motion: Motion
    kind: str
    readout: float
    exposure: float
    sensor: Sensor
    samples: int
    told: Told

    @functools.cached_property
    def stage(self) -> Stage:
        """The scene."""
        return FAMILIES[self.family](np.random.default_rng([self.seed, 1]), self.style)

    @functools.cached_property
    def path(self) -> Path:
        """Where the camera is at any time: also the pose of each line."""
        return plan_path(self.stage, self.motion, self.lens.field)

    @property
    def times(self) -> np.ndarray:
        """(N,) seconds of the pictures' middle lines, in the middle of their exposure."""
        return np.arange(self.motion.frames) * self.motion.interval

    @property
    def is_upright(self) -> bool:
        """Returns whether the picture is held upright: its lines are then read as its columns."""
        return self.lens.camera.width < self.lens.camera.height

    def _measure_readout(self) -> float:
        """Measures how far, in the rough, the picture shifts during the readout, pixels."""
        ends = self.path(np.concatenate([self.times - 0.5 * abs(self.readout),
                                         self.times + 0.5 * abs(self.readout)]))  # fmt: skip
        first, last = ends[: len(self.times)], ends[len(self.times) :]
        moved = np.linalg.norm(last[:, :3, 3] - first[:, :3, 3], axis=1) / self.stage.reach
        turned = np.linalg.norm(last[:, :3, 2] - first[:, :3, 2], axis=1)
        width = self.lens.camera.width
        return float(np.median(moved + turned)) * width / min(self.lens.field, 2.5)

    def list_factors(self) -> dict[str, Any]:
        """Lists what was drawn, for the table of results."""
        camera = self.lens.camera
        return {
            "seed": self.seed, "family": self.family, "kind": self.kind,
            "lens": self.lens.kind, "maker": self.lens.maker,
            "field_degrees": float(np.degrees(self.lens.field)),
            "width": camera.width, "height": camera.height, "frames": self.motion.frames,
            "motion": self.motion.kind, "step": self.motion.step, "readout_ms": 1e3 * self.readout,
            "readout_px": self._measure_readout(),
            "exposure_ms": 1e3 * self.exposure, "told": self.told.lens,
            "told_wrong": self.told.is_wrong, "points": self.told.points,
            "place_error": self.told.place_error, "turned": self.told.turned,
            "dropped": self.told.dropped,
            "mistake": None if self.told.mistake is None else MISTAKES[self.told.mistake].name,
            "movers": self.stage.movers is not None,
            **{f"style_{key}": value for key, value in dataclasses.asdict(self.style).items()},
            **{f"sensor_{key}": value for key, value in dataclasses.asdict(self.sensor).items()},
        }  # fmt: skip


def capture(seed: int, tiny: bool = False) -> Capture:
    """Draws the capture of a seed; the same seed gives the same capture and pictures.

    Args:
        seed: at least 0.
        tiny: fewer and smaller pictures, for quick tests; everything else is drawn alike.
    """
    rng = np.random.default_rng([seed, 0])
    # Every family once in a block of seeds.
    names = sorted(FAMILIES)
    block = np.random.default_rng([seed // len(names), 77]).permutation(len(names))
    family = names[block[seed % len(names)]]
    style = Style(
        bare=float(rng.choice([0.0, 0.1, 0.4, 0.8], p=[0.35, 0.35, 0.2, 0.1])),
        glossy=float(rng.choice([0.0, 0.1, 0.4], p=[0.5, 0.3, 0.2])),
        grain=rng.uniform(0.1, 0.4),
        repeated=bool(rng.random() < 0.2),
    )
    kind = str(rng.choice(_KINDS, p=[0.5, 0.35, 0.15]))
    most = 45_000 if kind == "film" else 77_000
    lens = draw_lens(rng, 48 * 48 if tiny else rng.uniform(40_000, most))
    stage = FAMILIES[family](np.random.default_rng([seed, 1]), style)
    motion = _draw_motion(rng, stage, kind, seed)
    if tiny:
        motion = dataclasses.replace(motion, frames=min(motion.frames, 6))
    is_rolling = motion.kind != "photos" and rng.random() < 0.5
    readout = rng.uniform(0.005, 0.033) * rng.choice([1, 1, 1, -1]) if is_rolling else 0.0
    exposure = 0.0 if rng.random() < 0.3 else float(10.0 ** rng.uniform(-3.5, -1.9))
    sensor = draw_sensor(rng, seed)
    told = _draw_told(rng, kind, lens, is_rolling)
    has_flag = lens.kind == "phone" and sensor.quality > 0  # a PNG has no EXIF
    return Capture(
        seed, family, style, lens, motion, kind, float(readout), exposure, sensor,
        2 if tiny else 3, _add_metadata(told, kind, has_flag, seed),
    )  # fmt: skip


def _draw_motion(rng: np.random.Generator, stage: Stage, kind: str, seed: int) -> Motion:
    weights = np.array([3.0, 2.0, *[1.0] * len(stage.motions)])[: len(stage.motions)]
    motion = str(rng.choice(stage.motions, p=weights / weights.sum()))
    if kind == "film" and motion == "photos":
        motion = "walk"
    frames = int(np.exp(rng.uniform(np.log(6), np.log(41))))
    is_held = motion not in ("photos", "grid", "turn")
    if kind == "film":
        frames, interval, step = int(rng.integers(30, 49)), 0.05, rng.uniform(0.02, 0.06)
    else:
        interval, step = 0.5, rng.uniform(0.05, 0.3)
    return Motion(
        motion,
        frames,
        interval,
        step,
        float(rng.choice([0.0, 0.3, 0.8])),
        0.02 * is_held,
        seed,
        kind == "film",
    )


def _add_metadata(told: Told, kind: str, has_flag: bool, seed: int) -> Told:
    """Adds what the camera writes beside the lens, drawn from the seed alone."""
    rng = np.random.default_rng([seed, 62])
    has_place, is_turned, is_cut = rng.random(3) < (0.4, 0.25, 0.3)
    return dataclasses.replace(
        told,
        place_error=float(rng.choice([0.3, 3.0, 10.0])) if has_place and kind != "film" else None,
        turned=bool(is_turned)
        and has_flag
        and kind == "photographs"
        and told.lens in ("nothing", "exif"),
        dropped=0.1 if is_cut and kind == "film" else 0.0,
    )


def _draw_told(rng: np.random.Generator, kind: str, lens: DrawnLens, is_rolling: bool) -> Told:
    if kind == "dataset":
        mistake = None
        if rng.random() < 0.4:
            mistake = int(rng.integers(len(MISTAKES)))
        return Told("file", mistake=mistake, points=bool(rng.random() < 0.7))
    ways = ["nothing", "file", "name" if lens.name else "nothing", "exif"]
    way = str(rng.choice(ways, p=[0.35, 0.15, 0.2, 0.3]))
    is_wrong = way in ("name", "exif") and bool(rng.random() < 0.2)
    name = ""
    if way == "name":
        name = draw_other_name(rng, lens.maker) if is_wrong else lens.name
    focal = None
    if way == "exif" and kind == "photographs":
        focal = lens.focal_35mm or float(rng.uniform(12, 60))
        is_wrong = is_wrong or lens.focal_35mm is None
        focal *= rng.uniform(1.3, 2.5) if is_wrong else 1.0
    return Told(way, is_wrong, name, focal)
