"""A signal ends long calls of the core within a second: Ctrl-C, or whatever its handler raises."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import gsut
from formats.scene_cases import plain_scene
from gsut import _core
from gsut.cli import EXIT_INTERRUPTED, main
from random_scenes import pinhole
from tolerances import SECONDS_TO_STOP

AFTER = 0.2  # seconds of the clock, until the signal
POSE = np.eye(4)


class Stopped(Exception):
    pass


@contextlib.contextmanager
def stopped_soon():
    """A signal whose handler raises comes during the block, which must not go on for long."""

    def stop(*_):
        nonlocal begun
        begun = time.process_time()
        raise Stopped

    begun = None
    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, AFTER)
    try:
        with pytest.raises(Stopped):
            yield
        assert time.process_time() - begun < SECONDS_TO_STOP
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def cloud(rng, count):
    """Many large Gaussians in front of the camera."""
    means = rng.normal(size=(count, 3)) * 0.5 + [0, 0, 4]
    return gsut.Gaussians(
        means, rng.normal(size=(count, 4)), np.full((count, 3), -0.5), np.full(count, -4.0),
        np.zeros((count, 1, 3)),
    )  # fmt: skip


def reference(rng):
    gsut.render(cloud(rng, 20_000), pinhole(600), POSE, dtype="float64")


def frame(rng):
    gsut.render(cloud(rng, 30_000), pinhole(4000), POSE)


def matching(rng):
    features = rng.integers(0, 255, (12_000, 128), dtype=np.uint8)
    _core.match_pairs([features] * 40, np.array([[i, j] for i in range(40) for j in range(i)]),
                      0.8, 0.7)  # fmt: skip


def compaction(rng):
    gsut.compact(plain_scene(rng, 400_000, 16), 0.1, method="field")


def palette(rng):
    _core.make_palette(rng.normal(size=(400_000, 45)).astype(np.float32), 30_000)


def fusion(rng):
    views, depth = _core.DepthViews([0, 0, 0]), np.full((600, 600), 2.0, np.float32)
    for _ in range(4):
        views.add(pinhole(600), POSE, depth, None, None)
    views.fuse(1e-3, np.inf, 4.0, 0.1, 0)


@pytest.mark.parametrize("long_call", [reference, frame, matching, compaction, palette, fusion])
def test_long_call_ends_soon_after_a_signal(long_call, rng):
    with stopped_soon():
        long_call(rng)


def test_call_in_another_thread_goes_on(rng):
    truth = gsut.render(cloud(rng, 300), pinhole(200), POSE, dtype="float64").image
    rng = np.random.default_rng(20260821)
    images = []
    other = threading.Thread(
        target=lambda: images.append(
            gsut.render(cloud(rng, 300), pinhole(200), POSE, dtype="float64").image
        )
    )
    with stopped_soon():
        other.start()
        reference(np.random.default_rng(1))
    other.join()
    assert np.array_equal(images[0], truth)


# In the midst of the imports: a finder of modules that interrupts.
INTERRUPTED = """
import os, signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)
class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == "gsut.cli":
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.1)
sys.meta_path.insert(0, Interrupt())
"""


def test_interrupt_during_imports_of_the_command_is_one_line(tmp_path):
    (tmp_path / "sitecustomize.py").write_text(INTERRUPTED)
    done = subprocess.run(
        [sys.executable, "-m", "gsut", "--help"], capture_output=True, check=False,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
    )  # fmt: skip
    said = b"gsut: interrupted; nothing was started\n"
    assert (done.returncode, done.stdout, done.stderr) == (EXIT_INTERRUPTED, b"", said)


def test_interrupt_of_a_command_says_what_is_kept(tmp_path, monkeypatch, capsys):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("gsut.formats.read_scene_file", interrupt)
    (tmp_path / "a.ply").touch()
    words = ["convert", str(tmp_path / "a.ply"), str(tmp_path / "b.ply")]
    assert main(words) == EXIT_INTERRUPTED
    assert "no file was left half-written" in capsys.readouterr().err
