"""The command line: commands on a faked run, refusals in one sentence, and start-up time."""

import argparse
import dataclasses
import importlib
import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import gsut
import small_run
from gsut.cli import build_parser, list_commands, main
from gsut.cli.demo import _free_run
from gsut.output_folder import MARKER
from gsut.run import TrainOptions
from gsut.run.folder import RunFile, RunFolder
from gsut.run.progress import Progress

PACKAGE = str(Path(gsut.__file__).parent.parent)
COMMANDS = list_commands()
HELP_SECONDS = 0.3  # of a processor; 0.09 beside other programs


@pytest.fixture
def scene(tmp_path, monkeypatch):
    scene = small_run.scene_from_arrays(tmp_path / "data")
    small_run.install(monkeypatch, scene)
    return scene


@pytest.fixture
def run(tmp_path, scene):
    return small_run.finished_run(tmp_path / "run", scene, report=False)


@pytest.fixture
def training(monkeypatch, scene):
    """Replaces gsut.train; records how it was called and leaves a finished run behind."""
    calls = []

    def train(scene, options, out, resume=False, progress=None, watch=None):
        calls.append(SimpleNamespace(options=options, out=out, resume=resume, progress=progress))
        if not RunFolder(out).has_run():
            small_run.finished_run(Path(out), scene, options, report=False)

    monkeypatch.setattr(gsut, "train", train, raising=False)
    return calls


def refused(capsys, *words: str) -> str:
    """Runs a command that must be refused; returns the sentence."""
    assert main(words) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("gsut: error: ")
    assert captured.err.count("\n") == 1
    assert "Traceback" not in captured.err
    return captured.err


# Start-up and help.


def test_help_of_the_program_lists_commands_and_answers_at_once():
    environment = os.environ | {"PYTHONPATH": PACKAGE, "PYTHONDONTWRITEBYTECODE": ""}
    seconds = []
    for _ in range(3):  # the first may write bytecode; the clock of a busy machine varies
        before = os.times()
        done = subprocess.run(
            [sys.executable, "-m", "gsut", "--help"],
            capture_output=True, text=True, env=environment,
        )  # fmt: skip
        after = os.times()
        # Of a processor: other programs' work must not make this fail.
        seconds.append(
            after.children_user - before.children_user
            + after.children_system - before.children_system
        )  # fmt: skip
    assert min(seconds) < HELP_SECONDS
    assert done.returncode == 0
    assert [command for command in COMMANDS if command not in done.stdout] == []


def test_list_of_commands_imports_none_of_them_and_has_their_lines():
    script = (
        "import sys, gsut.cli\n"
        "try: gsut.cli.main(['--help'])\n"
        "except SystemExit: pass\n"
        "print([m for m in sys.modules if m.startswith('gsut.cli.') or m == 'numpy'])"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": PACKAGE, "COLUMNS": "300"},
    )
    assert done.stdout.splitlines()[-1] == "[]"
    for command in COMMANDS:
        line = importlib.import_module(f"gsut.cli.{command}").HELP
        assert re.search(rf"^ +{command}\s+{re.escape(line)}$", done.stdout, re.MULTILINE)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command_ends_well(command, capsys):
    with pytest.raises(SystemExit) as caught:
        main([command, "--help"])
    assert caught.value.code == 0
    assert f"usage: gsut {command}" in capsys.readouterr().out


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_json(command):
    parser = build_parser([command])
    leaves = []
    while parser is not None:
        inner = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
        leaves.append(parser)
        parser = next(iter(inner[0].choices.values())) if inner else None
    assert "--json" in leaves[-1].format_help()


def test_version_names_compiler_libraries_and_instruction_set(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    said = capsys.readouterr().out
    build = gsut.machine.describe_build()
    assert said.startswith(f"gsut {gsut.__version__}\n")
    assert all(f"{name}: {build[name]}" in said for name in ("compiler", "eigen", "highway"))
    assert gsut.machine.active_isa() in said


# Refusals.


def test_refusal_with_debug_shows_the_traceback(monkeypatch, capsys):
    monkeypatch.setenv("GSUT_DEBUG", "1")
    assert main(["eval", "absent"]) == 2
    assert "Traceback" in capsys.readouterr().err


# gsut train.


def test_train_hands_the_given_options_on(tmp_path, training, capsys):
    out = tmp_path / "new"
    words = ["train", "data", "-o", str(out), "--steps", "7", "--seed", "3", "--test-every", "4"]
    assert main(words) == 0
    (call,) = training
    assert call.options == TrainOptions(steps=7, seed=3, test_every=4)
    assert (call.out, call.resume, call.progress) == (out, False, True)
    captured = capsys.readouterr()
    assert f"report: {out / RunFile.REPORT}" in captured.out
    assert "PSNR" in captured.out
    assert "images/9.png" in captured.err  # the scene's note


def test_train_quiet_prints_nothing(tmp_path, training, capsys):
    assert main(["train", "data", "-o", str(tmp_path / "new"), "--quiet"]) == 0
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "")
    assert training[0].progress is False


def test_train_json_prints_the_metrics(tmp_path, training, capsys):
    out = tmp_path / "new"
    assert main(["train", "data", "-o", str(out), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((out / RunFile.METRICS).read_text())


def test_train_into_a_run_is_refused_before_the_data_is_read(run, monkeypatch, capsys):
    monkeypatch.setattr(gsut, "load_dataset", lambda *_, **__: pytest.fail("data was read"))
    before = {p: p.read_bytes() for p in run.path.rglob("*") if p.is_file()}
    said = refused(capsys, "train", "data", "-o", str(run.path))
    assert "already holds a run; add --resume" in said
    assert {p: p.read_bytes() for p in run.path.rglob("*") if p.is_file()} == before


def test_train_resume_takes_the_runs_own_options(run, training):
    assert main(["train", "data", "-o", str(run.path), "--resume", "--threads", "2"]) == 0
    (call,) = training
    assert call.resume is True
    assert call.options == TrainOptions(steps=100, threads=2)


def test_train_resume_of_a_run_killed_at_its_start_begins_it(tmp_path, training):
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / MARKER).write_text('{"command": "gsut train"}')
    assert main(["train", "data", "-o", str(tmp_path / "new"), "--resume", "--steps", "5"]) == 0
    assert training[0].options == TrainOptions(steps=5)


def test_train_interrupted_says_how_to_go_on(tmp_path, monkeypatch, scene, capsys):
    def interrupted(*_, out, **__):
        if begins:
            (out / "options.json").write_text("{}")
        raise KeyboardInterrupt

    monkeypatch.setattr(gsut, "train", interrupted, raising=False)
    out = tmp_path / "new"
    for does_begin, resumed in ((False, "\n"), (True, " --resume\n")):
        begins = does_begin
        assert main(["train", "my data", "-o", str(out)]) == 130
        assert capsys.readouterr().err.endswith(f"gsut train 'my data' -o {out}{resumed}")


# gsut eval.


def test_eval_prints_figures_and_changes_nothing(run, capsys):
    before = {p: p.read_bytes() for p in run.path.rglob("*") if p.is_file()}
    assert main(["eval", str(run.path)]) == 0
    out = capsys.readouterr().out
    assert "images/0.png" in out and "PSNR by field angle: 0–30° 20.00" in out
    assert {p: p.read_bytes() for p in run.path.rglob("*") if p.is_file()} == before


def test_eval_of_each_split_takes_its_views(run, capsys):
    for split, number in (("test", 2), ("train", 4), ("all", 6)):
        assert main(["eval", str(run.path), "--split", split, "--json"]) == 0
        assert len(json.loads(capsys.readouterr().out)["views"]) == number


def test_eval_with_out_writes_pictures_and_metrics_once(run, tmp_path, capsys):
    out = tmp_path / "pictures"
    assert main(["eval", str(run.path), "-o", str(out)]) == 0
    assert len(list(out.glob("*.png"))) == 6
    assert json.loads((out / RunFile.METRICS).read_text())["num_gaussians"] == 1234
    capsys.readouterr()
    assert "is not empty" in refused(capsys, "eval", str(run.path), "-o", str(out))


def test_eval_of_an_unfinished_run_says_so(run, capsys):
    (run.path / RunFile.SCENE).unlink()
    assert "the run is not finished" in refused(capsys, "eval", str(run.path))


# gsut render.


def test_render_along_each_path_writes_its_images(run, tmp_path, monkeypatch):
    file = tmp_path / "path.json"
    file.write_text(json.dumps({"camera_from_world": [np.eye(4).tolist()] * 3}))
    count = 0
    for path, names in (
        ("auto", ["00000.png", "00001.png", "00002.png", "00003.png"]),
        ("orbit", ["00000.png", "00001.png", "00002.png", "00003.png"]),
        ("train", ["00000.png", "00001.png", "00002.png", "00003.png"]),
        ("test", ["images_0.png", "images_3.png"]),
        (str(file), ["00000.png", "00001.png", "00002.png", "00003.png"]),
    ):
        out = tmp_path / f"out{count}"
        words = ["render", str(run.path), "--path", path, "--frames", "4", "-o", str(out)]
        assert main(words) == 0
        assert sorted(p.name for p in out.iterdir()) == names
        count += 1
    assert count == 5


def test_render_with_lens_and_size_uses_both_and_says_where_shapes_differ(run, tmp_path, capsys):
    lens, out = tmp_path / "lens.json", tmp_path / "out"
    gsut.save_camera(gsut.Camera("pinhole", [20, 20, 10, 5], 20, 10), lens)
    words = ["--frames", "1", "--camera", str(lens), "--size", "40x24", "-o", str(out)]
    assert main(["render", str(run.path), *words]) == 0
    assert cv2.imread(str(out / "00000.png")).shape == (24, 40, 3)
    assert "another shape than the lens' 20 x 10: pixels are drawn 1.2 times as wide" in (
        capsys.readouterr().err
    )


def test_render_without_out_goes_into_the_run(run):
    assert main(["render", str(run.path), "--frames", "2"]) == 0
    assert len(list((run.path / "auto").iterdir())) == 2


def test_render_of_a_file_of_gaussians_needs_no_run(tmp_path):
    path, out = tmp_path / "scene.ply", tmp_path / "out"
    gsut.formats.save_ply(path, small_run.GAUSSIANS[:20])
    words = ["render", str(path), "--frames", "3", "--size", "40x30", "--fov", "80"]
    assert main([*words, "-o", str(out)]) == 0
    images = [cv2.imread(str(file)) for file in sorted(out.iterdir())]
    assert [image.shape for image in images] == [(30, 40, 3)] * 3
    assert all(image.any() for image in images)


def test_render_of_depths_of_a_model_along_the_ray_draws_by_the_distance(tmp_path, monkeypatch):
    path, orders, render = tmp_path / "scene.ply", [], gsut.render
    monkeypatch.setattr(
        gsut, "render", lambda g, *a, **k: orders.append(g.order) or render(g, *a, **k)
    )
    gsut.formats.save_ply(path, dataclasses.replace(small_run.GAUSSIANS[:20], order="ray"))
    words = ["render", str(path), "--frames", "1", "--size", "20x15", "-o"]
    assert main([*words, str(tmp_path / "images")]) == 0
    assert main([*words, str(tmp_path / "depths"), "--depth", "ray"]) == 0
    assert orders == ["ray", "distance"]
    assert (tmp_path / "depths" / "depth" / "00000.npy").is_file()


def test_render_along_a_saved_path_uses_its_lens_and_is_smooth_if_frames_are_given(run, tmp_path):
    from gsut.lens.files import values_from_camera

    path, out = tmp_path / "camera.json", tmp_path / "out"
    lens = gsut.Camera("pinhole", [20, 20, 10, 5], 20, 10)
    poses = [np.eye(4).tolist(), gsut.exp_pose(np.array([0.2, 0, 0, 0, 0.3, 0])).tolist()]
    path.write_text(json.dumps({"camera_from_world": poses, "lens": values_from_camera(lens)}))
    words = ["render", str(run.path), "--path", str(path), "-o"]
    assert main([*words, str(out)]) == 0
    assert main([*words, str(tmp_path / "smooth"), "--frames", "5"]) == 0
    keys, smooth = (
        [cv2.imread(str(file)) for file in sorted(folder.glob("*.png"))]
        for folder in (out, tmp_path / "smooth")
    )
    assert (len(keys), len(smooth)) == (2, 5) and keys[0].shape == (10, 20, 3)
    for key, same in zip(keys, (smooth[0], smooth[-1]), strict=True):
        assert np.abs(key.astype(int) - same).max() <= 1


def test_render_to_a_video_holds_all_frames_and_is_never_overwritten(run, tmp_path, capsys):
    out = tmp_path / "film.mp4"
    assert main(["render", str(run.path), "--frames", "5", "--size", "65x48", "-o", str(out)]) == 0
    video = cv2.VideoCapture(str(out))
    assert int(video.get(cv2.CAP_PROP_FRAME_COUNT)) == 5
    assert int(video.get(cv2.CAP_PROP_FRAME_WIDTH)) == 64
    video.release()
    capsys.readouterr()
    assert "film.mp4 exists" in refused(capsys, "render", str(run.path), "-o", str(out))
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []


# gsut demo and doctor.


def test_demo_run_of_a_finished_demo_takes_the_next_folder(tmp_path, scene):
    options = TrainOptions(preset="fast", steps=100)
    run, resume = _free_run(tmp_path, options)
    assert (run.path.name, resume) == ("run", False)
    finished = small_run.finished_run(run.path, scene, options, report=False)
    run, resume = _free_run(tmp_path, options)
    assert (run.path.name, resume) == ("run-2", False)
    (finished.path / RunFile.REPORT).unlink()
    run, resume = _free_run(tmp_path, options)
    assert (run.path.name, resume) == ("run", True)


def test_doctor_of_no_dataset_finds_an_error(tmp_path, capsys):
    assert main(["doctor", str(tmp_path / "absent")]) == 2
    captured = capsys.readouterr()
    assert "training cannot start" in captured.out
    assert "Traceback" not in captured.err


# The progress bar.


class Terminal:
    """A stream that says it is a terminal and keeps what is written."""

    encoding = "utf-8"

    def __init__(self) -> None:
        self.text = ""

    def write(self, text: str) -> None:
        self.text += text

    def flush(self) -> None:
        pass

    def isatty(self) -> bool:
        return True


def test_progress_shows_step_loss_gaussians_and_the_last_psnr():
    terminal = Terminal()
    with Progress(file=terminal) as progress:
        progress.show_step(1, 100, 0.5, 1000, psnr=21.234)
        progress.show_step(100, 100, 0.0625, 20_000)
    last = terminal.text.rstrip("\n").split("\r")[-1]
    assert [
        w for w in ("100%", "100/100", "loss 0.0625", "20,000", "21.23 dB") if w not in last
    ] == []


def test_progress_in_a_log_has_a_line_a_report_after_some_seconds(monkeypatch):
    log, now = io.StringIO(), [1000.0]
    monkeypatch.setattr("tqdm.std.time", lambda: now[0])
    for seconds, lines in ((1.0, 0), (60.0, 4)):
        with Progress(file=log) as progress:
            for done in range(1, 5):
                progress.show("views", done, 4)
                now[0] += seconds
        assert len(log.getvalue().splitlines()) == lines
    assert "\r" not in log.getvalue()
    assert "100%" in log.getvalue().splitlines()[-1]


def test_progress_disabled_writes_nothing(capsys):
    progress = Progress(enabled=False)
    progress.show_step(5, 10, 0.1, 10)
    progress.close()
    assert capsys.readouterr() == ("", "")


# The real thing.


def test_demo_for_real_ends_with_a_report(tmp_path, capsys):
    assert main(["demo", "-o", str(tmp_path / "demo"), "--steps", "20", "--no-open"]) == 0
    run = RunFolder.open(tmp_path / "demo" / "run")
    assert (run.path / RunFile.REPORT).stat().st_size > 10_000
    assert (run.path / RunFile.CHECKPOINT).is_file()
    first = json.loads((run.path / RunFile.METRICS).read_text())["psnr"]
    capsys.readouterr()
    assert main(["eval", str(run.path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["psnr"] == pytest.approx(first)
