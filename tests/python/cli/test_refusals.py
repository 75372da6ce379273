"""Wrong words on the command line are refused at once, in one sentence, and nothing is written."""

import shlex

import numpy as np
import pytest

import gsut
import small_run
from formats.scene_cases import plain_scene
from gsut.cli import EXIT_INPUT, main

LARGE = "9" * 25
FISHEYE = gsut.Camera("kannala_brandt", [99, 99, 64, 48, 0.1, 0, 0, 0], 128, 96)

# The words after gsut, and what the sentence says. The folder holds run, data, in.ply, in.yaml and
# an empty file.
REFUSED = {
    # commands and flags that there are not, or that lack something
    "": "COMMAND",
    "trian": "invalid choice: 'trian'",
    "train": "required: DATA",
    "train data": "required: -o/--out",
    "train data -o new --step 3": "unrecognized arguments: --step",
    "render run --foo": "(see gsut render --help)",
    "data convert a b --foo": "(see gsut data convert --help)",
    "mesh": "(see gsut mesh --help)",
    # numbers
    "train data -o new --steps 0": "--steps must be >= 1",
    "train data -o new --steps ten": "--steps must be a whole number",
    "train data -o new --serve a:99999": "--serve: must be like 127.0.0.1:8000",
    "render run --frames 0": "--frames must be from 1 to",
    "render in.ply -o new --frames 1000000000": "from 1 to 100000",
    "render run --size big": "--size must be like 1280x720",
    "render in.ply -o new --size 100000x100000": "from 1 to 65536",
    "render in.ply -o new --fov 0": "--fov: takes a number above 0, up to 360",
    "edit in.ply -o new.ply --scale inf": "--scale: takes a finite",
    "edit in.ply -o new.ply --scale 1e30": "--scale must be above 0, from",
    "edit in.ply -o new.ply --up 1e300 0 0": "--up: takes a number from",
    "compact in.ply -o new.ply --keep nan": "--keep: takes a finite number",
    f"mesh run -o new.ply --holes {LARGE}": "--holes: takes a whole number",
    f"poses data -o new --fov {LARGE}": "--fov must be >= ",
    # places that are not there, or of another kind
    "train data -o file": "is a file",
    "eval absent": "no such folder",
    "eval data": "holds no run",
    "render run --data moved": "the dataset moved does not exist",
    "render run --path absent.json": "absent.json: cannot be opened",
    "train data -o ''": "the name is empty",
    "poses data -o ''": "the name is empty",
    "doctor ''": "after doctor the name is empty",
    "render run --data ''": "after --data the name is empty",
    # names whose end says that they are of another kind
    **{
        f"{words} {name}": "ends as a file's name does"
        for words, name in (
            ("train data -o", "k.gif"), ("scene data -o", "small.splat"),
            ("poses data -o", "scan.LAZ"), ("eval run -o", "photo.heic"), ("demo -o", "a.spz"),
            ("data convert data", "k.gif"), ("train data -o", "poses.json"),
        )
    },
    "render in.ply -o small.splat": ".splat is no film that can be written",
    "render in.ply -o film.avi": "give .mp4, .webm, .gif, or a folder",
    "render run --frames 1 -o k.mov": "give .mp4, .webm, .gif, or a folder",
    "compact in.ply --keep 0.5 -o k.gif": "give a name ending in .ply",
    "compact run --keep 0.5 -o small.splat": "small.splat",
    "convert in.ply k.gif": "no format to write has this suffix",
    "edit in.ply -o k.gif": "no format to write has this suffix",
    "convert in.ply in.ply": "exists; give another name (nothing was overwritten)",
    "convert nowhere.ply out.spz": "nowhere.ply: no such file or folder",
    "convert . out.spz": "holds no run",
    "convert run out.sog --stream": "--stream writes a folder",
    "edit in.ply -o in.ply": "exists; give another name",
    "render run -o a.mp4 --depth ray": "a film has no depths",
    "poses data/images -o new --rig none.json": "none.json: cannot be opened",
    # flags that contradict each other, or what they are given
    "--wrong train": "the following arguments are required",
    "train data -o new --resume": "new holds no run to resume; check the name, or leave",
    "train data -o new --blocks 0": "--blocks 0: auto, or a number from 1",
    "train data -o new --blocks none.json": "--blocks none.json: auto, or a number",
    "train data -o new --blocks 2 --memory much": "--memory must be like",
    "train data -o new --workers 2": "--workers is for a training in --blocks",
    "train data -o new --blocks 2 --view": "--view shows a training as a whole",
    "convert in.ply out.spz --for viewers": "in.ply is a file, give the folder of a run",
    "convert in.ply out.html --for viewers": "draws the scene as gsut does; leave --for",
    "convert run out --for viewers --stream": "levels hold the scene as gsut draws it",
    "convert run out --title x --stream": "only a page has --title",
    "edit in.ply -o out.ply --crop-box 1 2 3": "--crop-box: expected 6 arguments",
    "edit in.ply -o out.ply --crop-box 99 99 99 100 100 100": "nothing is left",
    "edit in.ply -o out.ply --scale 0": "--scale must be above 0",
    "edit in.ply -o out.ply --min-opacity 2": "must lie in 0 to 1",
    "edit in.ply -o out.ply --up 0 0 0": "must be a direction",
    "edit in.ply -o out.ply --up 0 0 1 --upright": "not both",
    "edit in.ply -o out.ply --ground": "is a file, which has no cameras",
    "edit in.ply -o out.ply --floaters": "which has no cameras: give a run for --floaters",
    **{
        f"edit run -o a.ply --positions p.csv {flag}": "--positions says scale and up"
        for flag in ("--scale 2", "--upright", "--up 0 0 1", "--ground")
    },
    "compact run -o new --keep 0": "keep must be above 0 and at most 1, found 0.0",
    "compact run -o new --keep 1.5": "keep must be above 0 and at most 1, found 1.5",
    "compact run -o new": "give one of --keep and --target-psnr-drop",
    "compact run -o new --keep 0.1 --target-psnr-drop 1": "give one of --keep",
    "compact run -o new --keep 0.1 --method best": "known: ghap",
    "compact run -o new --keep 0.1 --finetune -1": "--finetune must be 0 or more",
    "compact run -o new --target-psnr-drop 0": "--target-psnr-drop must be above 0",
    **{
        f"calibrate data/images --board 7x5 --spacing 0.03 {words}": said
        for words, said in (
            ("--board 9 -o lens.yaml", "COLUMNSxROWS"), ("-o lens.dat", "must end in"),
            ("--spacing -1 -o lens.yaml", "side of a square"),
            ("-o lens.yaml --lens splined", "needs a .cameramodel"),
            ("-o l.cameramodel --lens splined --solver opencv", "opencv has no splined lens"),
        )
    },
    "poses data/images -o new --refine-rig": "--refine-rig needs a rig",
    "poses data/images -o new --shutter global --readout-time 0.5": "contradict each other",
    "train data -o new --serve 127.0.0.1:0": "add --view",
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("refused")
    gsut.formats.save_ply(folder / "in.ply", plain_scene(np.random.default_rng(1), 20, 1))
    gsut.save_camera(FISHEYE, folder / "in.yaml")
    (folder / "file").write_text("")
    with pytest.MonkeyPatch.context() as patch:
        scene = small_run.scene_from_arrays(folder / "data")
        small_run.install(patch, scene)
        small_run.finished_run(folder / "run", scene, report=False)
        yield folder


@pytest.mark.parametrize("words", REFUSED)
def test_wrong_words_are_refused_in_one_sentence(words, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    before = sorted(folder.rglob("*"))
    assert main(shlex.split(words)) == EXIT_INPUT
    told = capsys.readouterr()
    assert told.out == "" and REFUSED[words] in told.err
    assert told.err.splitlines()[-1].startswith("gsut: error: ") and "Traceback" not in told.err
    assert sorted(folder.rglob("*")) == before
