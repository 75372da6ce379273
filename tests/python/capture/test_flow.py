"""The flow at frames of a video: the speed at that moment, not the mean over those beside it."""

import numpy as np
import pytest

import tolerances
from gsut.capture.ahead import make_pool
from gsut.capture.flow import FlowSearch, shrink_frame

SIZE = 240, 320
RATE = 16.0  # frames a second
SHAKE = 3.0  # hertz
REACH = 3.0  # pixels


def shaken_frames(rng, phase):
    """(5, H, W) uint8 of a texture that shakes to the right and left, frame 2 at a phase of it."""
    import cv2

    noise = rng.uniform(0, 255, (SIZE[0] // 4, SIZE[1] // 4)).astype(np.float32)
    texture = cv2.resize(noise, SIZE[::-1], interpolation=cv2.INTER_CUBIC).clip(0, 255)
    times = (np.arange(5) - 2) / RATE
    frames = []
    for x in REACH * np.sin(2 * np.pi * SHAKE * times + phase):
        shift = np.array([[1.0, 0.0, x], [0.0, 1.0, 0.0]])
        frames.append(cv2.warpAffine(texture, shift, SIZE[::-1], borderMode=cv2.BORDER_REFLECT))
    return times, np.round(frames).astype(np.uint8)


def speeds(times, frames, numbers):
    with make_pool() as pool:
        search = FlowSearch({2}, pool)
        for number in numbers:
            search.add(shrink_frame(number, float(times[number]), frames[number]))
        found = search.finish()
    assert list(found) == [2]
    return np.array(found[2])[:, 2]


@pytest.mark.parametrize("phase", [0.0, 1.2])
def test_speed_is_that_of_the_moment(rng, phase):
    times, frames = shaken_frames(rng, phase)
    fastest = 2 * np.pi * SHAKE * REACH
    off = np.median(speeds(times, frames, range(5))) - fastest * np.cos(phase)
    assert abs(off) < tolerances.CAPTURE_FLOW_SPEED * fastest


def test_speed_of_frames_that_lack_one_beside_is_the_mean_over_those_there(rng):
    times, frames = shaken_frames(rng, 0.0)
    mean = REACH * np.sin(2 * np.pi * SHAKE / RATE) * RATE
    off = np.median(speeds(times, frames, range(1, 4))) - mean
    assert abs(off) < tolerances.CAPTURE_FLOW_SPEED * mean


def test_speed_counts_time_stamps_that_are_uneven(rng):
    times, frames = shaken_frames(rng, 0.0)
    chosen = np.array([0, 1, 2, 4])
    places = REACH * np.sin(2 * np.pi * SHAKE * times[[1, 2, 4]])
    expected = np.polyfit(times[[1, 2, 4]], places, 2)[1]
    off = np.median(speeds(times[chosen], frames[chosen], range(4))) - expected
    assert abs(off) < tolerances.CAPTURE_FLOW_SPEED * expected
