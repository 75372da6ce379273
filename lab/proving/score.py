"""Scores gsut on one capture: doctor, poses and, for some, training, against the truth."""

from __future__ import annotations

import json
import math
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import gsut
from gsut.data import CAPTURE_FOLDER
from lab.mistakes import MISTAKES, judge
from lab.proving.capture import Capture, capture
from lab.proving.causes import score_causes
from lab.proving.commands import Outcome, run_gsut, run_training
from lab.proving.misfires import is_true_of_exact
from lab.proving.scene import score_scene
from lab.proving.truth import (
    ON_ITS_SIDE,
    classify,
    compare_lenses,
    find_truth_poses,
    list_shifts,
    measure_areas,
    measure_pair_errors,
)
from lab.proving.writing import GIVEN, TRUTH, make_capture

TRAIN_EVERY = 3  # of the seeds: the share of the captures that are trained on
_THINNED = (1, 1, 2, 3, 4, 8)  # of exact datasets: every such view is left
BITS_EVERY = 8  # of the seeds: the share of the captures that run on two numbers of threads
_THREADS = (1, 3)
_SHORT = ("--preset", "fast", "--max-side", "128", "--steps", "40", "--force", "--quiet")

Row = dict[str, Any]


def score_capture(seed: int, parts: tuple[str, ...] = ("doctor", "poses", "train")) -> Row:
    """Scores the capture of a seed; a row of JSON values."""
    started = time.process_time()
    made = capture(seed)
    folder = make_capture(made)
    rendered = {"render_seconds": time.process_time() - started}
    return made.list_factors() | rendered | score_made(made, folder, parts)


def score_made(made: Capture, folder: Path, parts: tuple[str, ...]) -> Row:
    """Scores a capture that was written to a folder."""
    row: Row = {}
    with tempfile.TemporaryDirectory(prefix="gsut-prove-") as name:
        work = Path(name)
        if "doctor" in parts:
            row |= _score_doctor(made, folder, work)
        if "mistakes" in parts:
            row["mistakes"] = judge_mistakes(folder / TRUTH, work / "mistakes")
        if "exact" in parts:
            row["exact"] = check_exact(folder / TRUTH, work, 2 + made.seed % 7)
        if "poses" in parts:
            row |= _score_poses(made, folder, work, "scene" in parts)
        if "train" in parts and made.seed % TRAIN_EVERY == 0:
            row |= _score_training(made, folder, work)
        if "bits" in parts and made.seed % BITS_EVERY == 0:
            row["other_bits"] = compare_threads(made, folder, work)
        if "causes" in parts:
            row |= score_causes(folder / TRUTH, work, made.seed)
        if "movers" in parts:
            row |= score_causes(folder / TRUTH, work, made.seed, only="movers")
    return row


def _list_end(name: str, outcome: Outcome) -> Row:
    return {
        f"{name}_status": outcome.status, f"{name}_seconds": outcome.cpu_seconds,
        f"{name}_traceback": outcome.errors[-2000:] if outcome.has_traceback else None,
        f"{name}_refused": outcome.last_line if outcome.status not in (0, None) else None,
    }  # fmt: skip


def _score_doctor(made: Capture, folder: Path, work: Path) -> Row:
    if made.kind == "dataset":
        data, thinned = folder / GIVEN, 1
        planted = (data / "mistake.txt").read_text("utf-8").strip()
    else:
        thinned, planted = _THINNED[made.seed % len(_THINNED)], "none"
        data = _thin(folder / TRUTH, work / "thinned", thinned)
    outcome = run_gsut("doctor", data, "--json", work=work)
    row = _list_end("doctor", outcome) | {"planted": planted, "thinned": thinned}
    try:
        findings = json.loads(outcome.output)
    except ValueError:
        findings = [{"severity": "error", "text": outcome.last_line}]
    said = [f for f in findings if f["severity"] != "info"]
    texts = [" ".join(str(value) for value in finding.values()) for finding in said]
    mistake = next((m for m in MISTAKES if m.name == planted), None)
    named = mistake is not None and any(word in text for word in mistake.says for text in texts)
    return row | {
        "doctor_says": [text[:300] for text in texts], "doctor_named": named if mistake else None,
        "doctor_errors": sum(finding["severity"] == "error" for finding in said),
    }  # fmt: skip


def judge_mistakes(data: Path, work: Path) -> dict[str, str]:
    """Makes every mistake on copies of exact data: its name -> named, said, missed or false."""
    rows = judge(data, work, points=(True,))
    verdicts = {row["mistake"]: row["verdict"] for row in rows[1:]}
    return {"none": rows[0]["verdict"]} | verdicts


def check_exact(data: Path, work: Path, every: int) -> dict[str, list[str]]:
    """Returns what the doctor says against exact data, whole and every n-th view of them."""
    said = {}
    for step in (1, every):
        thinned = data if step == 1 else _thin(data, work / "exact", step)
        found = [f for f in gsut.doctor(thinned, progress=False) if f.severity != "info"]
        said[str(step)] = [f"{f.severity}: {f.what}" for f in found if not is_true_of_exact(f.what)]
    return said


def _thin(data: Path, folder: Path, every: int) -> Path:
    """Copies a dataset with every such view only."""
    folder.mkdir()
    for each in data.iterdir():
        if each.name != "transforms.json":
            (folder / each.name).symlink_to(each)
    values = json.loads((data / "transforms.json").read_text("utf-8"))
    values["frames"] = values["frames"][::every]
    (folder / "transforms.json").write_text(json.dumps(values), encoding="utf-8")
    return folder


def compare_threads(made: Capture, folder: Path, work: Path) -> list[str]:
    """Returns the files of poses and of a short training that depend on the number of threads."""
    commands = {
        "poses": (_list_words(made, folder), ("transforms.json", "points3D.ply")),
        "train": (["train", folder / TRUTH, *_SHORT], ("scene.ply",)),
    }
    other = []
    for name, (words, files) in commands.items():
        outs = [work / f"{name}-of-{threads}" for threads in _THREADS]
        for out, threads in zip(outs, _THREADS, strict=True):
            run_gsut(*words, "-o", out, "--threads", str(threads), work=work)
        for file in files:
            first, second = (out / file for out in outs)
            same = first.is_file() == second.is_file()
            if not same or (first.is_file() and first.read_bytes() != second.read_bytes()):
                other.append(f"{name}: {file}")
    return other


def find_given(made: Capture, folder: Path) -> Path:
    """Returns what poses are found for: a dataset, photographs or a film."""
    names = {"dataset": TRUTH, "photographs": GIVEN, "film": "film.mp4"}
    return folder / names[made.kind]


def _list_words(made: Capture, folder: Path) -> list[str | Path]:
    """Lists the words of `gsut poses` on what gsut is given of a capture."""
    words: list[str | Path] = ["poses", find_given(made, folder), "--quiet"]
    if made.kind != "dataset" and made.told.lens == "file":
        words += ["--camera", folder / "given.lens.json"]
    elif made.told.name:
        words += ["--camera", made.told.name]
    return words


def _score_poses(made: Capture, folder: Path, work: Path, with_scene: bool) -> Row:
    outcome = run_gsut(*_list_words(made, folder), "-o", work / "poses", work=work)
    row = _list_end("poses", outcome)
    if outcome.status != 0:
        return row
    figures = json.loads((work / "poses/poses.json").read_text("utf-8"))
    numbers = _number_pictures(made, work / "poses", figures)
    row |= _measure_poses(made, work / "poses", figures, numbers)
    if with_scene:
        found = {numbers[name]: pose for name, pose in _list_poses(made, figures).items()}
        row |= score_scene(made, work / "poses", found, row["registered"], work)
    return row


def _list_poses(made: Capture, figures: Row) -> dict[str, np.ndarray]:
    """Lists camera_from_world (4, 4), as it was held, of the pictures that have a pose, by name."""
    views = [view for view in figures["views"] if view["registered"]]
    held = ON_ITS_SIDE.T if made.told.turned else np.eye(4)
    return {view["name"]: held @ np.array(view["camera_from_world"]) for view in views}


def _number_pictures(made: Capture, out: Path, figures: Row) -> dict[str, int]:
    """Returns each picture's number in the truth by its name in the result."""
    names = [view["name"] for view in figures["views"]]
    if made.kind != "film":
        return {name: int(Path(name).stem) for name in names}
    chosen = json.loads((out / CAPTURE_FOLDER / "capture.json").read_text("utf-8"))["frames"]
    times = {row["name"]: row["time"] for row in chosen}
    return {name: round(times[name] / made.motion.interval) for name in names}


def _measure_poses(made: Capture, out: Path, figures: Row, numbers: dict[str, int]) -> Row:
    order = sorted(numbers.values())
    truth = find_truth_poses([made.path(made.times[[k]])[0] for k in order])
    found = {order.index(numbers[name]): pose for name, pose in _list_poses(made, figures).items()}
    errors, shifts = measure_pair_errors(found, truth, made.stage.reach)
    areas = measure_areas(errors)
    registered = len(found) / max(1, len(order))
    verdict = figures["verdict"]
    lens: Row = {"lens_px": 0.0}
    diagonal = math.hypot(made.lens.camera.width, made.lens.camera.height)
    if figures["lens"] != "known":
        estimated = gsut.load_dataset(out, test_every=0).cameras[0]
        lens = compare_lenses(estimated, made.lens.camera, made.told.turned)
    row: Row = areas | lens | {
        "pictures": len(order), "registered": registered,
        "shift_degrees": float(np.quantile(shifts, 0.9)), "verdict": verdict["level"],
        "verdict_reasons": verdict["reasons"],
        "residual_px": figures["reprojection_error_px"]["median"],
        "track_length": figures["mean_track_length"], "agreement": figures["matches_in_points"],
        "contradicted": figures.get("contradicted_pairs"), "given_lens": figures.get("given_lens"),
        "pose_errors_px": figures.get("pose_errors_px"),
        "lens_sigma_px": figures.get("lens_sigma_px"), "diagonal_px": diagonal,
        "shift_px": list_shifts(shifts, made.lens.camera),
        "centers": [[None if pose is None else np.linalg.inv(pose)[:3, 3].tolist()
                     for pose in (truth[k], found.get(k))] for k in range(len(truth))],
        "notes": figures["notes"], "lens_known": figures["lens"],
        "shutter_found": figures.get("shutter"),
        "focal_sigma_percent": figures.get("focal_sigma_percent"),
        "observations": figures["observations"],
        "points_found": figures["points"],
        "look_alikes": figures.get("look_alikes"),
        "readout_found": (figures.get("readout") or {}).get("seconds"),
        "readout_sigma": (figures.get("readout") or {}).get("sigma_seconds"),
    }  # fmt: skip
    return row | {"true_class": classify(shifts, registered, made.lens.camera, lens["lens_px"])}


def _score_training(made: Capture, folder: Path, work: Path) -> Row:
    out = work / "trained"
    outcome, metrics = run_training(folder / TRUTH, out, "--preset", "fast", work=work)
    row = _list_end("train", outcome)
    if not metrics:
        return row
    row |= {
        "psnr": metrics.get("psnr"), "psnr_train": metrics.get("psnr_train"),
        "psnr_clean": _measure_clean(folder / TRUTH, out), "steps": metrics.get("steps"),
        "train_verdict": (metrics.get("verdict") or {}).get("level"),
        "train_reasons": (metrics.get("verdict") or {}).get("reasons"),
        "gaussians": metrics.get("gaussians"),
        "sh_degree": metrics.get("sh_degree"),
    }  # fmt: skip
    return row


def _measure_clean(data: Path, run: Path) -> float | None:
    """Measures held-out renders against the truth without noise, in dB."""
    import cv2

    scene = gsut.load_dataset(data)
    gaussians = gsut.load_gaussians(run / "scene.ply")
    squares = []
    for index in scene.test_indices:
        view = scene.views[index]
        clean = cv2.imread(str(data / "clean" / f"{Path(view.name).stem}.png"))[..., ::-1] / 255.0
        image = gsut.render(gaussians, scene.cameras[view.camera_index], view.motion).image
        mask = scene.mask(index)
        squares.append(float(np.mean((np.clip(image, 0, 1) - clean)[mask] ** 2)))
    return -10 * math.log10(float(np.mean(squares))) if squares else None
