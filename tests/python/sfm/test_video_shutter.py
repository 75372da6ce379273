"""The rolling shutter of a video, found from the flow of its pictures, or not."""

import dataclasses

import numpy as np
import pytest

import tolerances
from gsut import Shutter, _core
from gsut.sfm.photographs.options import PosesOptions
from gsut.sfm.shutter.readout import estimate_rates, estimate_readout_by_flow
from gsut.sfm.shutter.video import find_video_shutter
from gsut.sfm.solution import measure_line_times
from gsut.sfm.solution.solver import solve_poses
from gsut.sfm.world.comparison import compare_poses
from synthetic_walk import Synthetic

READOUT = 0.04  # seconds; frames are a second apart
IMAGES = 12
STEP = 0.05  # seconds before and after a frame, by which its flow is measured


def flow_of(scene, image):
    """Where some points are, and how far they move in a second."""
    rate = scene.velocities[image] / scene.readout
    pixels = []
    for time in (-STEP, 0.0, STEP):
        pose = _core.moved_pose(scene.poses[image], rate, time)
        found, valid = scene.camera.project(scene.points @ pose[:3, :3].T + pose[:3, 3])
        inside = (found > 0).all(axis=1) & (found < 1000).all(axis=1)
        pixels.append(np.where((valid & inside)[:, None], found, np.nan))
    rows = np.hstack([pixels[1], (pixels[2] - pixels[0]) / (2 * STEP)])
    return rows[np.isfinite(rows).all(axis=1)][:40]


class Walk:
    """A walk, its solution with a global shutter, and the flow of its frames."""

    def __init__(self, readout):
        self.scene = Synthetic(np.random.default_rng(12), images=IMAGES, noise=0.1, readout=readout)
        count = len(self.scene.features)
        self.names = [f"{i:03d}.png" for i in range(count)]
        self.pairs = self.scene.verified()
        self.still = solve_poses(self.scene.images(), self.pairs, PosesOptions())
        # A shutter that is global moves all the same between the frames.
        self.scene.readout = READOUT
        self.scene.velocities = [
            READOUT * np.array([0.3, 0.1 * i, 0.0, 0.02, 0.15, 0.01]) for i in range(count)
        ]
        self.flows = {name: flow_of(self.scene, i) for i, name in enumerate(self.names)}

    def map(self, options, flows=None):
        mapping = self.scene.mapping(options, pairs=self.pairs, solution=self.still)
        photographs = dataclasses.replace(mapping.photographs, flows=flows or self.flows)
        return dataclasses.replace(mapping, photographs=photographs)

    def find(self, flows=None):
        return find_video_shutter(self.map(PosesOptions(), flows))


@pytest.fixture(scope="module")
def rolling():
    return Walk(READOUT)


def test_rates_of_frames_are_those_of_the_walk(rolling):
    rates, _ = estimate_rates(rolling.still, rolling.flows)
    expected = np.array(rolling.scene.velocities) / READOUT
    off = np.degrees(np.linalg.norm(rates[:, 3:] - expected[:, 3:], axis=1))
    assert off.max() < tolerances.SFM_RATE_DEGREES


def test_errors_of_the_flow_shorten_the_time_by_the_reliability(rolling):
    rng = np.random.default_rng(1)
    times = []
    shutters = [Shutter("top_to_bottom")] * IMAGES
    lines = measure_line_times(rolling.still, shutters)
    for noise in (0.0, 6.0):
        flows = {
            name: rows + noise * rng.standard_normal(rows.shape) * [0, 0, 1, 1]
            for name, rows in rolling.flows.items()
        }
        rates, spread = estimate_rates(rolling.still, flows)
        times.append(estimate_readout_by_flow(rolling.still, rates, spread, lines, None))
    exact, noisy = times
    assert exact.reliability > 0.99 > 0.97 > noisy.reliability
    short, right = noisy.time / exact.time, noisy.time / noisy.reliability / exact.time
    assert short < 0.97 and abs(right - 1) < tolerances.SFM_READOUT_SHORT
    assert noisy.sigma > exact.sigma


def test_readout_time_by_a_window_is_that_by_all_images(rolling, monkeypatch):
    shutters = [Shutter("top_to_bottom")] * IMAGES
    lines = measure_line_times(rolling.still, shutters)
    given = (rolling.still, *estimate_rates(rolling.still, rolling.flows), lines, None)
    whole = estimate_readout_by_flow(*given)
    monkeypatch.setattr("gsut.sfm.lens.information._MOST_IMAGES", 4)
    window = estimate_readout_by_flow(*given)
    assert window.time == pytest.approx(whole.time, rel=tolerances.ONE_WINDOW - 1)
    assert window.sigma == pytest.approx(whole.sigma, rel=tolerances.ONE_WINDOW - 1)


def test_rolling_video_is_found_with_its_readout_time_and_better_poses(rolling):
    found = rolling.find()
    assert found.readout is not None and 2 * found.readout.sigma < 0.1 * found.readout.time
    assert found.readout.time == pytest.approx(READOUT, rel=0.1)
    assert found.solution.shutter.direction == "top_to_bottom"
    assert found.solution.registered.all()
    truth = np.array(rolling.scene.poses)
    before = compare_poses(rolling.still.camera_from_world, truth)
    after = compare_poses(found.solution.camera_from_world, truth)
    assert after.ate_percent < before.ate_percent
    assert 4 * np.median(after.rotation_degrees) < np.median(before.rotation_degrees)
    assert "top to bottom" in found.describe()


def test_flow_of_the_other_sign_is_a_shutter_that_reads_backwards(rolling):
    flows = {name: rows * [1, 1, -1, -1] for name, rows in rolling.flows.items()}
    found = rolling.find(flows)
    assert found.readout.time == pytest.approx(READOUT, rel=0.1)
    assert found.solution.shutter.direction == "bottom_to_top"


@pytest.fixture(scope="module")
def still():
    return Walk(None)


def test_global_video_is_left_as_it_is(still):
    found = still.find()
    assert found.readout is None and found.solution is still.still
    assert "not determined" in found.describe()
