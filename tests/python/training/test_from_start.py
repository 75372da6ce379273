"""`gsut compact` by `--method auto`: where it trains from the start, how long, where it merges."""

import dataclasses
import json
import math
import shutil

import cv2
import numpy as np
import pytest

import gsut
from gsut import TrainOptions
from gsut.cli import main
from gsut.data.scene import digest_scene
from gsut.render import Light
from gsut.run.folder import RunFile, RunFolder
from gsut.training.time_left import predict_training_steps
from gsut.training.tuning import finetune_options
from gsut.training.tuning.from_start import FromStart
from rendered_dataset import VIEWS, write_dataset

GAINS = 0.75 + 0.25 * np.sin(np.arange(VIEWS))
SHORT = {"steps": 80, "max_gaussians": 300, "exposure": "on", "checkpoint_every": 0}
HALF = ("--keep", "0.5", "--finetune", "10")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of photographs that differ in light."""
    folder = tmp_path_factory.mktemp("from_start")
    data = write_dataset(folder / "data", np.random.default_rng(20261123))
    for number, gain in enumerate(GAINS):
        file = str(data / "images" / f"{number:03d}.png")
        cv2.imwrite(file, np.rint(gain * cv2.imread(file)).astype(np.uint8))
    out = folder / "run"
    gsut.train(gsut.load_dataset(data), TrainOptions(**SHORT), out=out, progress=False)
    return out


def compacted(run, out, *words):
    assert main(["compact", str(run), *words, "-o", str(out)]) == 0
    return json.loads((out / RunFile.METRICS).read_text())


def files_of(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_auto_trains_from_the_start_and_says_why(run, tmp_path, capsys):
    before, out = files_of(run), tmp_path / "small"
    found = compacted(run, out, *HALF)
    told = capsys.readouterr()
    assert files_of(run) == before
    assert found["compaction"]["method"] == "from_start"
    assert found["num_gaussians"] == 150 == len(gsut.formats.load_ply(out / RunFile.SCENE))
    options = RunFolder.open(out).read_options()
    assert (options.max_gaussians, options.steps) == (150, found["steps"])
    assert options.steps > 100
    why = "differ in light and 50% of 300 Gaussians are kept, where training beats compacting"
    assert any(why in note for note in found["notes"])
    assert why in told.err and why in (out / "report.html").read_text()
    assert f"300 -> 150 Gaussians from the start, {options.steps} steps in" in told.out
    assert main(["compact", str(run), *HALF, "-o", str(out)]) == 2
    assert "already holds a run" in capsys.readouterr().err


def test_training_from_the_start_has_the_same_bits_on_any_number_of_threads(run, tmp_path):
    made = []
    for threads in (1, 3):
        source = shutil.copytree(run, tmp_path / f"run{threads}")
        options = dataclasses.replace(RunFolder.open(run).read_options(), threads=threads)
        (source / RunFile.OPTIONS).write_text(options.to_json())
        out = tmp_path / f"small{threads}"
        assert compacted(source, out, *HALF, "--quiet")["compaction"]["method"] == "from_start"
        made.append((out / RunFile.SCENE).read_bytes())
    assert made[0] == made[1]


@pytest.mark.parametrize(
    ("words", "method"),
    [
        ((*HALF, "--method", "ghap"), "ghap"),
        ((*HALF, "--method", "lightgaussian"), "lightgaussian"),
        (("--keep", "0.5"), "ghap"),
        (("--keep", "0.2", "--finetune", "10"), "ghap"),
        (("--target-psnr-drop", "3", "--finetune", "2"), "ghap"),
        (("--target-size", "12kB", "--finetune", "10"), "from_start"),
    ],
)
def test_method_is_obeyed_and_auto_merges_where_it_should(run, tmp_path, words, method):
    found = compacted(run, tmp_path / "small", *words, "--quiet")
    assert found["compaction"]["method"] == method
    assert any("from the start" in note for note in found["notes"]) == (method == "from_start")


def test_auto_of_a_fine_tuned_run_merges(run, tmp_path):
    """Its options are those of the fine-tuning, which grow no Gaussians."""
    first = tmp_path / "first"
    assert compacted(run, first, *HALF, "--method", "ghap", "--quiet")["num_gaussians"] == 150
    found = compacted(first, tmp_path / "second", *HALF, "--quiet")
    assert found["compaction"]["method"] == "ghap" and found["num_gaussians"] == 75


def test_auto_of_a_run_in_blocks_merges(run, tmp_path):
    """As a whole it may be too large to be trained."""
    source = shutil.copytree(run, tmp_path / "run")
    plan = dict.fromkeys(("blocks", "rounds", "version", "isa", "options"))
    (source / RunFile.PLAN).parent.mkdir()
    (source / RunFile.PLAN).write_text(json.dumps(plan))
    values = json.loads((source / RunFile.ENVIRONMENT).read_text())
    # A run in blocks digests the dataset as it is in the files.
    values["digests"] = digest_scene(gsut.load_dataset(values["dataset"]))
    (source / RunFile.ENVIRONMENT).write_text(json.dumps(values))
    found = compacted(source, tmp_path / "small", *HALF, "--quiet")
    assert found["compaction"]["method"] == "ghap" and found["num_gaussians"] == 150


def test_light_that_hardly_differs_is_no_reason():
    options = TrainOptions(steps=80).resolve()
    for spread, better in ((0.0, False), (0.004, False), (0.05, True)):
        light = Light(np.exp(spread * np.array([[-1.0] * 3, [1.0] * 3])), (None,))
        assert FromStart(options, 1000, 300, 100, light).is_better() == better
    assert not FromStart(options, 1000, 300, 100, None).is_better()


@pytest.mark.parametrize("steps", [500, 2000])
@pytest.mark.parametrize("keep", [0.3, 0.7])
def test_steps_are_as_much_work_as_run_compaction_and_finetuning(run, steps, keep):
    scene = gsut.load_dataset(RunFolder.open(run).read_json("environment.json")["dataset"])
    megapixels = scene.cameras[0].width * scene.cameras[0].height / 1e6
    own, first = 50_000, 10_000
    o = TrainOptions(steps=steps, max_gaussians=own, lr_scales=0.01).resolve()
    start = FromStart(o, own, round(keep * own), 300, None)
    chosen = start.choose_options(scene, first)

    def work(options, begin):
        return predict_training_steps(options, begin, megapixels).sum()

    few = dataclasses.replace(o, max_gaussians=round(keep * own))
    tuned = finetune_options(few, 300, few.max_gaussians)
    wanted = work(o, first) + work(tuned, few.max_gaussians)
    compaction = work(finetune_options(o, len(scene.train_indices), own), own)
    assert 5 * compaction < work(chosen, first) - wanted < 6 * compaction
    # What the recipe says of a number of steps follows it, what was given stays.
    expected = TrainOptions(steps=chosen.steps, max_gaussians=few.max_gaussians).resolve()
    assert math.isclose(chosen.lr_scales, 0.01)
    for name in ("lr_means", "lr_sh_rest", "densify_every", "noise", "coarse_to_fine"):
        assert getattr(chosen, name) == getattr(expected, name), name
