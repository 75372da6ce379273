"""`gsut scene`: a video to a scene in one command, killed and gone on with, done only once."""

import io
import json
import shutil
import signal
import subprocess
import sys
import time
import urllib.request

import cv2
import numpy as np
import pytest

import gsut
from gsut.cli import main
from gsut.run import StagedProgress, StageFollower
from gsut.training.time_left import Pace
from small_videos import walk_past

WORDS = ["--frames", "6", "--preset", "fast", "--steps", "40"]


SEEN: dict = {}  # what the page of the scene below answered at last


def ask_page(address, *routes):
    def ask(route):
        with urllib.request.urlopen(address + route, timeout=30) as reply:
            return json.loads(reply.read())

    return [ask(route) for route in routes]


@pytest.fixture(scope="module")
def finished_scene(tmp_path_factory):
    """A scene made without a break while its page is looked at, and the words that make it."""
    folder = tmp_path_factory.mktemp("scene")
    video = walk_past(folder / "walk.mp4")
    lens = folder / "lens.yaml"
    gsut.save_camera(gsut.Camera("pinhole", [300.0, 300.0, 160.0, 120.0], 320, 240), lens)
    words = ["scene", str(video), "--camera", str(lens), *WORDS]

    def open_page(address):
        SEEN["address"] = address

    def wait_for_end():
        SEEN["last"], SEEN["training"] = ask_page(SEEN["address"], "scene", "training")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gsut.cli.view.has_display", lambda: True)
        patch.setattr("webbrowser.open", open_page)
        patch.setattr("gsut.cli.view.wait_for_end", wait_for_end)
        assert main([*words, "-o", str(folder / "run"), "--quiet", "--view"]) == 0
    return folder, words


def test_view_shows_the_training_and_stays_until_the_end(finished_scene):
    assert SEEN["last"]["kind"] == "training" and SEEN["last"]["name"] == "run/poses"
    assert SEEN["training"]["state"] == "finished" and SEEN["training"]["step"] == 40


def test_video_becomes_a_scene_with_a_page(finished_scene):
    folder, _ = finished_scene
    run = folder / "run"
    state = json.loads((run / "scene.json").read_text())
    assert state["pictures"] == state["registered"] == 6
    held_out_verdict = json.loads((run / "metrics.json").read_text())["verdict"]
    assert state["verdict"]["level"] == held_out_verdict["level"]  # six pictures are no fault
    assert set(state["seconds"]) == {"capture", "poses", "training", "report"}
    assert state["psnr"] == json.loads((run / "metrics.json").read_text())["psnr"]
    page = (run / "scene.html").read_text()
    held_out = json.loads((run / "options.json").read_text())["test_names"]
    assert len(held_out) == 1 and "000000" not in held_out[0]
    assert (
        "of the detail is right" in page and 'href="report.html"' in page and "data:image" in page
    )
    assert main(["eval", str(run), "--json"]) == 0


def test_moved_scene_is_still_evaluated(finished_scene, tmp_path, capsys):
    folder, _ = finished_scene
    shutil.copytree(folder / "run", tmp_path / "elsewhere")
    values = json.loads((tmp_path / "elsewhere/environment.json").read_text())
    values["dataset"] = "/is/not/there/poses"
    (tmp_path / "elsewhere/environment.json").write_text(json.dumps(values))
    found = []
    for run in (tmp_path / "elsewhere", folder / "run"):
        assert main(["eval", str(run), "--json"]) == 0
        found.append(json.loads(capsys.readouterr().out)["psnr"])
    assert found[0] == found[1]


def test_second_run_says_done_and_changes_nothing(finished_scene, capsys):
    folder, words = finished_scene
    files = sorted(path for path in (folder / "run").rglob("*") if path.is_file())
    before = [path.stat().st_mtime_ns for path in files]
    assert main([*words, "-o", str(folder / "run")]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("already finished") and "report: " in printed
    assert [path.stat().st_mtime_ns for path in files] == before
    assert main([*words, "-o", str(folder / "run"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["registered"] == 6


def test_other_inputs_and_settings_do_not_overwrite(finished_scene, capsys):
    folder, words = finished_scene
    out = ["-o", str(folder / "run")]
    assert main([*words, *out, "--fov", "50"]) == 2
    assert "scene with other --fov (None, now 50.0)" in capsys.readouterr().err
    other = walk_past(folder / "other.mp4", frames=8)
    assert main(["scene", str(other), *words[2:], *out]) == 2
    assert "scene with other inputs" in capsys.readouterr().err


@pytest.fixture
def copied(finished_scene, tmp_path):
    """A copy of the scene and its film, the film's path, and the words that make it."""
    folder, words = finished_scene
    run, video = tmp_path / "run", tmp_path / "walk.mp4"
    shutil.copytree(folder / "run", run)
    shutil.copy(words[1], video)
    for path in (run / "scene.json", run / "gsut.json", run / "poses/capture/capture.json"):
        path.write_text(path.read_text().replace(words[1], str(video)))
    return run, video, ["scene", str(video), *words[2:], "-o", str(run), "--no-open"]


def test_changed_film_of_a_trained_scene_is_refused(copied, capsys):
    run, video, same = copied
    figures = json.loads((run / "scene.json").read_text())
    assert main(same) == 0
    walk_past(video, frames=8)
    for changed in (figures, {"key": figures["key"]}):  # finished, and without its report
        (run / "scene.json").write_text(json.dumps(changed))
        capsys.readouterr()
        assert main(same) == 2
        assert f"a scene of other pictures: changed: {video}" in capsys.readouterr().err
    (run / "scene.json").write_text(json.dumps(figures))
    video.unlink()
    assert main(same) == 0  # the finished scene is still there


def test_film_that_was_only_touched_is_the_same(copied):
    run, video, same = copied
    video.touch()
    before = (run / "scene.html").stat().st_mtime_ns
    assert main([*same, "--quiet"]) == 0
    assert (run / "scene.html").stat().st_mtime_ns == before


def test_stages_of_an_unfinished_scene_are_repeated_where_the_film_changed(copied, capsys):
    run, video, same = copied
    key = json.loads((run / "scene.json").read_text())["key"]
    (run / "scene.json").write_text(json.dumps({"key": key}))
    for name in ("report.html", "metrics.json", "scene.html"):
        (run / name).unlink()
    before = (run / "scene.ply").read_bytes()
    walk_past(video, frames=23)
    assert main(same) == 0
    said = capsys.readouterr().err
    assert f"pictures are chosen again (changed: {video})" in said
    assert "poses are found again" in said
    assert "training starts again: the images and poses have changed" in said
    assert (run / "scene.ply").read_bytes() != before
    assert main(["eval", str(run), "--json"]) == 0


def test_training_on_other_poses_is_not_taken_for_that_of_the_scene(copied, capsys):
    run, _, same = copied
    key = json.loads((run / "scene.json").read_text())["key"]
    (run / "scene.json").write_text(json.dumps({"key": key}))
    path = run / "poses/transforms.json"
    values = json.loads(path.read_text())
    values["frames"][0]["transform_matrix"][0][3] += 1
    path.write_text(json.dumps(values))
    assert main(same) == 2
    assert "was trained on other poses; give another output folder" in capsys.readouterr().err
    with pytest.raises(gsut.InputError, match="has other poses than"):
        gsut.load_run(run, run / "poses")


def test_killed_at_any_stage_it_ends_with_the_same_bits(finished_scene, tmp_path):
    folder, words = finished_scene
    run = tmp_path / "run"
    program = [sys.executable, "-m", "gsut", *words, "-o", str(run), "--quiet"]
    for file in ("poses/capture/images", "poses/poses.json", "history.jsonl"):
        process = subprocess.Popen(program, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        while process.poll() is None and not (run / file).exists():
            time.sleep(0.01)
        assert process.poll() is None, process.stderr.read()
        process.send_signal(signal.SIGKILL)
        process.communicate()
        assert not (run / "scene.html").exists()
    assert subprocess.run(program, check=False).returncode == 0
    assert (run / "scene.ply").read_bytes() == (folder / "run/scene.ply").read_bytes()
    names = ("poses/transforms.json", "poses/points3D.ply")
    assert all((run / n).read_bytes() == (folder / "run" / n).read_bytes() for n in names)


@pytest.mark.slow
def test_scene_called_from_python_resumes_after_interrupts(tmp_path):
    video, pictures = cv2.VideoCapture(str(walk_past(tmp_path / "walk.mp4"))), tmp_path / "pictures"
    pictures.mkdir()
    for number in range(24):
        _, picture = video.read()
        if number % 4 == 0:
            cv2.imwrite(str(pictures / f"{number:02}.png"), picture)
    lens = tmp_path / "lens.yaml"
    gsut.save_camera(gsut.Camera("pinhole", [300.0, 300.0, 160.0, 120.0], 320, 240), lens)
    options = gsut.SceneOptions(preset="fast", steps=40, camera=str(lens))
    states = []

    def interrupt_at(stage):
        def show(row):
            states.append(row)
            if row["stage"] == stage:
                raise KeyboardInterrupt

        return show

    run = tmp_path / "run"
    for stage in ("matching", "training"):
        with pytest.raises(KeyboardInterrupt):
            gsut.scene(pictures, run, options, progress=interrupt_at(stage))
        assert states[-1]["stage"] == stage and states[-1]["seconds_left"] > 0
    assert len(gsut.load_run(run).gaussians) > 0  # a scene, though not a finished one
    result = gsut.scene(pictures, run, options, progress=False)
    assert result.figures["registered"] == 6 and result.trained is not None
    assert result.page.is_file() and result.verdict.level == result.figures["verdict"]["level"]
    again = gsut.scene(pictures, run, options, progress=interrupt_at("capture"))
    assert again.trained is None and again.figures == result.figures
    whole = gsut.scene([pictures], tmp_path / "whole", options, progress=False)
    assert (whole.path / "scene.ply").read_bytes() == (run / "scene.ply").read_bytes()


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def run_stages(bars, clock, seconds):
    """Goes through stages of so many seconds; returns (now, seconds left) at each report."""
    estimates = []
    with bars:
        for name, whole in seconds.items():
            with bars.stage(name):
                for part in range(20):
                    clock.now += whole / 20
                    bars.show((part + 1) / 20, "words")
                    estimates.append((clock.now, bars.estimate_left()))
        assert bars.estimate_left() == 0
    return estimates


def test_time_left_is_that_of_the_last_run_at_the_pace_of_this_one(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    clock, file = Clock(), io.StringIO()
    run_stages(
        StagedProgress("a command", ("a", "b", "c"), file=file, clock=clock), clock,
        {"a": 10.0, "b": 60.0, "c": 30.0},
    )  # fmt: skip
    clock.now, slower = 0.0, {"a": 30.0, "b": 180.0, "c": 90.0}
    bars = StagedProgress("a command", ("a", "b", "c"), file=file, clock=clock)
    for now, left in run_stages(bars, clock, slower):
        assert now < 10 or left == pytest.approx(300 - now)  # a tenth of all, as of last time
    assert "left" in file.getvalue() and "100%" in file.getvalue()
    assert bars.seconds == pytest.approx(slower)
    (tmp_path / "gsut/stages.json").write_text("no JSON")
    assert StagedProgress("a command", ("a", "b"), enabled=False).estimate_left() == 2


def test_long_first_stage_of_few_pictures_does_not_stretch_the_others(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    clock, file = Clock(), io.StringIO()
    bars = StagedProgress("a", ("read", "train"), file=file, clock=clock)
    run_stages(bars, clock, {"read": 1.0, "train": 60.0})
    bars = StagedProgress("a", ("read", "train"), file=file, clock=clock)
    with bars.stage("read"):
        clock.now += 45
    assert bars.estimate_left() == pytest.approx(60)


def test_stage_that_reports_a_tenth_at_once_does_not_shrink_the_others(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    clock, file = Clock(), io.StringIO()
    run_stages(
        StagedProgress("a", ("map", "train"), file=file, clock=clock), clock,
        {"map": 10.0, "train": 30.0},
    )  # fmt: skip
    bars = StagedProgress("a", ("map", "train"), file=file, clock=clock)
    with bars.stage("map"):
        for seconds, share, left in ((0.1, 0.1, 1 + 30), (1, 0.2, 8 + 30), (4, 0.6, 4 + 30)):
            clock.now += seconds
            bars.show(share)
            assert bars.estimate_left() == pytest.approx(left, rel=0.1)


def test_stage_that_the_last_run_lacked_says_nothing_about_the_others(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    clock, file = Clock(), io.StringIO()
    bars = StagedProgress("a", ("read", "map", "train"), file=file, clock=clock)
    run_stages(bars, clock, {"read": 5.0, "map": 2.0, "train": 400.0})
    bars = StagedProgress("a", ("read", "lens", "map", "train"), file=file, clock=clock)
    with bars.stage("read"):
        clock.now += 5
    with bars.stage("lens"):
        clock.now += 3
    assert bars.estimate_left() == pytest.approx(402)


def test_stages_take_their_time_by_picture(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    clock, file = Clock(), io.StringIO()
    for pictures, expected in ((20, None), (5, 50)):
        bars = StagedProgress("a", ("train",), file=file, clock=clock)
        stages = StageFollower(bars, pictures)
        stages.expect(["match", "map"])
        if expected is not None:
            assert bars.estimate_left() == pytest.approx(expected)
        run_stages(bars, clock, {"match": 40.0, "map": 40.0, "train": 30.0})


def test_each_stage_takes_its_time_by_its_own_work(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    clock, file = Clock(), io.StringIO()
    for pictures, steps, expected in ((20, 500, None), (5, 2000, 10 + 400)):
        bars = StagedProgress("a", ("map", "train"), file=file, clock=clock)
        bars.scale(["map"], pictures)
        bars.scale(["train"], 1)  # thought so at first
        bars.scale(["train"], steps)
        if expected is not None:
            assert bars.estimate_left() == pytest.approx(expected)
        run_stages(bars, clock, {"map": 40.0, "train": 100.0})


def test_staged_bar_never_goes_back_and_skips_what_is_done(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    clock = Clock()
    bars = StagedProgress("a command", ("a", "b"), enabled=False, clock=clock)
    bars.skip("a")
    with bars.stage("b"):
        clock.now += 5
        bars.show(0.5)
        before = bars.estimate_left()
        assert before == pytest.approx(5)
        bars.show(0.1)  # a sub-stage that begins again
        assert bars.estimate_left() == before


@pytest.mark.parametrize("slower", [1.0, 4.0])
def test_training_time_left_holds_though_steps_grow(slower):
    options = gsut.TrainOptions(preset="fast", max_gaussians=50_000)
    clock = Clock()
    pace = Pace(options.recipe, 500, 12_000, 50_000, clock=clock)
    fraction = np.arange(1, 501) / 500
    # As measured of frames of 854 x 480.
    steps = np.where(fraction <= 0.2, 0.0058, np.where(fraction <= 0.45, 0.0145, 0.042))
    ends = slower * np.cumsum(steps)
    ratios = []
    for step, end in enumerate(ends, 1):
        clock.now = end
        left = pace.estimate_left(step)
        if 2 * slower < end < 0.95 * ends[-1]:
            ratios.append(left / (ends[-1] - end))
    assert len(ratios) > 200
    assert np.mean((np.array(ratios) < 1.5) & (np.array(ratios) > 1 / 1.5)) > 0.9
