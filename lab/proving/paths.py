"""Moves a camera through a stage: walks, orbits, straight ways, turns, grids, photographs."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from lab.proving.stage import Stage
from tests.bench.walk_film import look_along

# World-from-camera poses (N, 4, 4), camera axes x right, y down, z forward, at times (N,) seconds.
Path = Callable[[np.ndarray], np.ndarray]
_FASTEST_WALK = 1.6  # metres a second
_FASTEST_TURN = 1.2  # radians a second
_MOST_FIELD = 2.0  # radians, of lenses beyond which pictures need not overlap less


@dataclasses.dataclass(frozen=True)
class Motion:
    """How a camera moves.

    Args:
        kind: "walk", "orbit", "straight", "turn", "grid" or "photos".
        frames: number of pictures. interval: seconds between them.
        step: share of the field of view that each picture shows anew.
        shake_degrees: of a hand, root mean square. bob: metres up and down at each step.
        seed: of everything that is drawn. is_film: nobody walks faster than people do.
    """

    kind: str
    frames: int
    interval: float
    step: float
    shake_degrees: float
    bob: float
    seed: int
    is_film: bool = False

    @property
    def seconds(self) -> float:
        """From the first picture to the last."""
        return (self.frames - 1) * self.interval


def plan_path(stage: Stage, motion: Motion, field: float) -> Path:
    """Plans a path that fits the stage and the lens' horizontal field, radians."""
    rng = np.random.default_rng([motion.seed, 11])
    field = min(field, _MOST_FIELD)
    # What a step may turn, and move in metres, so that pictures show `step` anew.
    turn, move = motion.step * field, 2 * motion.step * stage.reach * math.tan(field / 2)
    if motion.is_film:
        turn = min(turn, _FASTEST_TURN * motion.interval)
        if motion.kind not in ("grid", "orbit"):
            move = min(move, _FASTEST_WALK * motion.interval)
    plan = {"orbit": _plan_orbit, "turn": _plan_turn, "grid": _plan_grid,
            "photos": _plan_photos}.get(motion.kind, _plan_line)  # fmt: skip
    place = plan(rng, stage, motion, turn, move)
    phase = rng.uniform(0, 2 * math.pi, 24)
    rates = np.geomspace(0.7, 5.0, 5)  # hertz: a hand shakes, the slower the more
    shares = motion.shake_degrees * rates**-0.7 / math.sqrt(0.5 * (rates**-1.4).sum())

    def shake(times: np.ndarray, first: int) -> np.ndarray:
        waves = np.sin(2 * math.pi * rates * times[:, None] + phase[first : first + 5])
        return np.radians(waves @ shares)

    def find_poses(times: np.ndarray) -> np.ndarray:
        times = np.atleast_1d(np.asarray(times, np.float64))
        centers, yaw, pitch, roll = place(times)
        steps = np.sin(2 * math.pi * 1.8 * times + phase[0])
        centers = centers + motion.bob * steps[:, None] * [0, 0, 1]
        return look_along(centers, yaw + shake(times, 1), pitch + shake(times, 7),
                          roll + 0.5 * shake(times, 13))  # fmt: skip

    return find_poses


def _plan_line(rng, stage: Stage, motion: Motion, turn: float, move: float):
    start, end = (np.asarray(p, np.float64) for p in stage.line)
    way = end - start
    length = min(float(np.linalg.norm(way)), move * (motion.frames - 1))
    way = way / np.linalg.norm(way)
    heading = math.atan2(way[1], way[0]) + stage.lean
    side = np.array([-way[1], way[0], 0.0])
    is_walk = motion.kind == "walk"
    swing = min(0.15 * stage.reach, 0.4) * is_walk
    # A walk looks about: at the fastest by one turn a picture.
    rounds = rng.uniform(0.7, 2.0)
    about = min(0.8, turn * motion.frames / (2 * math.pi * rounds)) * is_walk
    phase = rng.uniform(0, 2 * math.pi, 4)

    def place(times: np.ndarray):
        share = times / motion.seconds
        wave = 2 * math.pi * rounds * share
        centers = start + length * share[:, None] * way
        centers = centers + swing * np.sin(1.3 * wave + phase[0])[:, None] * side
        centers = centers + 0.3 * swing * np.sin(0.9 * wave + phase[3])[:, None] * [0, 0, 1]
        yaw = heading + about * np.sin(wave + phase[1])
        pitch = stage.tilt + 0.3 * about * np.sin(0.7 * wave + phase[2])
        return centers, yaw, pitch, np.zeros_like(times)

    return place


def _plan_orbit(rng, stage: Stage, motion: Motion, turn: float, move: float):
    radius, up = stage.orbit
    step = min(turn if stage.inward else move / radius, 0.5)
    total = min(2 * math.pi, step * (motion.frames - 1))
    first = rng.uniform(0, 2 * math.pi)
    phase = rng.uniform(0, 2 * math.pi, 3)

    def place(times: np.ndarray):
        angle = first + total * times / motion.seconds
        reach = radius * (1 + 0.06 * np.sin(2 * angle + phase[0]))
        high = up + 0.12 * radius * np.sin(1.5 * angle + phase[1])
        offset = np.stack([reach * np.cos(angle), reach * np.sin(angle), high], axis=1)
        yaw = angle + (math.pi if stage.inward else math.pi / 2)
        pitch = -np.arctan2(high, reach) if stage.inward else np.full_like(angle, stage.tilt)
        return np.asarray(stage.focus) + offset, yaw, pitch, np.zeros_like(times)

    return place


def _plan_turn(rng, stage: Stage, motion: Motion, turn: float, move: float):
    total = min(2 * math.pi, turn * (motion.frames - 1))
    first, arm = rng.uniform(0, 2 * math.pi), float(rng.choice([0.0, 0.0, 0.01, 0.1]))

    def place(times: np.ndarray):
        angle = first + total * times / motion.seconds
        offset = arm * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
        pitch = stage.tilt + 0.15 * np.sin(1.7 * angle)
        return np.asarray(stage.spot) + offset, angle, pitch, np.zeros_like(times)

    return place


def _plan_grid(rng, stage: Stage, motion: Motion, turn: float, move: float):
    rows = max(2, round(math.sqrt(motion.frames) / 1.5))
    columns = math.ceil(motion.frames / rows)
    along, across = min(move, 110 / columns), min(1.4 * move, 110 / rows)
    heading = rng.uniform(0, 2 * math.pi)
    off = rng.normal(0, 0.05 * move, (motion.frames, 3))
    number = np.arange(motion.frames)
    row, column = number // columns, number % columns
    column = np.where(row % 2 == 0, column, columns - 1 - column)
    flat = np.stack([(column - (columns - 1) / 2) * along, (row - (rows - 1) / 2) * across], axis=1)
    c, s = math.cos(heading), math.sin(heading)
    stops = np.asarray(stage.spot) + off
    stops[:, :2] += flat @ np.array([[c, s], [-s, c]])

    def place(times: np.ndarray):
        share = np.clip(times / motion.interval, 0, motion.frames - 1)
        low = np.minimum(share.astype(int), motion.frames - 2)
        part = (share - low)[:, None]
        centers = (1 - part) * stops[low] + part * stops[low + 1]
        still = np.zeros_like(times)
        return centers, heading + still, stage.tilt + still, still

    return place


def _plan_photos(rng, stage: Stage, motion: Motion, turn: float, move: float):
    """Plans stops near an orbit or a line; between them the camera does not film."""
    count = motion.frames
    focus = np.asarray(stage.focus, np.float64)
    on_orbit = "orbit" in stage.motions and rng.random() < 0.6
    if on_orbit:
        radius, up = stage.orbit
        total = min(2 * math.pi, turn * (count - 1)) if stage.inward else 2 * math.pi
        angle = rng.uniform(0, 2 * math.pi) + np.sort(rng.uniform(0, total, count))
        reach = radius * rng.uniform(0.8, 1.15, count)
        high = up + radius * rng.uniform(-0.15, 0.3, count)
        stops = focus + np.stack([reach * np.cos(angle), reach * np.sin(angle), high], axis=1)
        yaw = angle + (math.pi if stage.inward else math.pi / 2)
    else:
        start, end = (np.asarray(p, np.float64) for p in stage.line)
        way = end - start
        length = min(float(np.linalg.norm(way)), move * (count - 1))
        way = way / np.linalg.norm(way)
        share = np.sort(rng.uniform(0, 1, count))[:, None]
        stops = start + length * share * way + rng.normal(0, 0.06 * min(stage.reach, 5), (count, 3))
        yaw = np.full(count, math.atan2(way[1], way[0]) + stage.lean)
    pitch = np.full(count, stage.tilt)
    if stage.inward and on_orbit:
        pitch = -np.arctan2(stops[:, 2] - focus[2], np.linalg.norm((stops - focus)[:, :2], axis=1))
    yaw = yaw + rng.normal(0, 0.25 * turn, count)
    pitch = pitch + rng.normal(0, 0.15 * turn, count)
    roll = rng.normal(0, 0.03, count)

    def place(times: np.ndarray):
        number = np.clip(np.rint(times / motion.interval).astype(int), 0, count - 1)
        return stops[number], yaw[number], pitch[number], roll[number]

    return place
