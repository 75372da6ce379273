"""Gives `gsut localize` photographs that are damaged, foreign or taken through another lens."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np

import gsut
import rendered_dataset
import small_videos
from gsut.refine.secants import place_lines
from gsut.run.folder import RunFile
from lab.attack.harness import Case, Outcome
from random_scenes import fisheye, pinhole

SEED = 5  # of the world's dataset
VIEW = 3  # of it, which the photograph shows
SIDE = 48  # pixels
MOTION = np.array([0.1, -0.05, 0.05, 0.02, -0.06, 0.03])  # from the first line to the last
FAR_OFF = 25.0  # square of an error by the stated covariance, per degree of freedom
FEW = "shows too little|does not determine|was not found"
SMALL = "at least 24 a side"
REFUSED = "was not found in the scene|led to a pose|does not determine"
Picture = Callable[[np.ndarray], np.ndarray]


def install_truth(folder: Path) -> None:
    """Puts the true Gaussians into the run, which localises what belongs to it."""
    scene = gsut.load_dataset(folder / "ds")
    truth = rendered_dataset.truth(np.random.default_rng(SEED)).to_dtype(np.float32)
    moved = dataclasses.replace(truth, means=(truth.means - scene.world_offset).astype(np.float32))
    gsut.formats.save_ply(folder / "run" / RunFile.SCENE, moved)


def draw_others(_: np.ndarray) -> np.ndarray:
    """Draws other Gaussians from the same pose."""
    others = rendered_dataset.truth(np.random.default_rng(SEED + 1))
    image = gsut.render(others, pinhole(SIDE), rendered_dataset.poses()[VIEW]).image
    return np.round(255 * np.clip(image, 0, 1)).astype(np.uint8)


def draw_rolling(_: np.ndarray) -> np.ndarray:
    """Draws what moves while its lines are read; the pose is that of the middle line."""
    truth = rendered_dataset.truth(np.random.default_rng(SEED))
    lines = place_lines(rendered_dataset.poses()[VIEW], MOTION, gsut.Shutter("top_to_bottom"))
    image = gsut.render(truth, pinhole(SIDE), lines).image
    return np.round(255 * np.clip(image[..., ::-1], 0, 1)).astype(np.uint8)


def light_from_left(pixels: np.ndarray) -> np.ndarray:
    side = np.linspace(1.0, 0.7, pixels.shape[1])[None, :, None]
    return np.round(pixels * side).astype(np.uint8)


def resize_picture(side: int) -> Picture:
    return lambda pixels: cv2.resize(pixels, (side, side), interpolation=cv2.INTER_AREA)


def hide_left(share: float) -> Picture:
    def hide(pixels: np.ndarray) -> np.ndarray:
        hidden = pixels.copy()
        hidden[:, : round(share * pixels.shape[1])] = 0
        return hidden

    return hide


def fill_picture(value: int) -> Picture:
    return lambda pixels: np.full_like(pixels, value)


def draw_noise(pixels: np.ndarray) -> np.ndarray:
    return np.random.default_rng(1).integers(0, 256, pixels.shape, dtype=np.uint8)


def draw_texture(_: np.ndarray) -> np.ndarray:
    return cv2.resize(small_videos.view(small_videos.texture(), 300), (SIDE, SIDE))


# What is done to the photograph, and what a refusal says; "": it belongs, and its pose is right.
PICTURES: dict[str, tuple[Picture, str]] = {
    "itself": (lambda pixels: pixels, ""),
    "at 8000 pixels": (resize_picture(8000), ""),
    "darker": (lambda pixels: pixels // 3, ""),
    "lit from the left": (light_from_left, ""),
    "blurred": (lambda pixels: cv2.GaussianBlur(pixels, (5, 5), 1.0), ""),
    "through a rolling shutter": (draw_rolling, ""),
    "hidden by a third": (hide_left(0.33), ""),
    "black": (fill_picture(0), FEW),
    "white": (fill_picture(255), FEW),
    "noise": (draw_noise, REFUSED),
    "of another place": (draw_texture, REFUSED),
    "of other Gaussians": (draw_others, REFUSED),
    "mirrored": (lambda pixels: pixels[:, ::-1], REFUSED),
    "upside down": (lambda pixels: pixels[::-1], REFUSED),
    "a negative": (lambda pixels: 255 - pixels, REFUSED),
    "hidden but for a strip": (hide_left(0.95), REFUSED),
    "at 1 pixel": (resize_picture(1), SMALL),
    "at 2 pixels": (resize_picture(2), SMALL),
    "at 5 pixels": (resize_picture(5), SMALL),
}
LENSES: dict[str, Callable[[], gsut.Camera]] = {
    "half as long": lambda: scale_focal(0.5),
    "twice as long": lambda: scale_focal(2.0),
    "a fifth longer": lambda: scale_focal(1.2),
    "a fisheye": lambda: fisheye(SIDE),
}


def scale_focal(factor: float) -> gsut.Camera:
    params = np.array(pinhole(SIDE).params)
    params[:2] *= factor
    return pinhole(SIDE).with_params(params)


def find_wrong_pose(done: Outcome) -> str | None:
    """Returns what is wrong with a pose that the command printed; None for one within its error."""
    found = json.loads(done.output)
    pose = np.array(found["camera_from_world"])
    true = rendered_dataset.poses()[VIEW]
    turn = pose[:3, :3] @ true[:3, :3].T
    error = np.array(found["center"]) + true[:3, :3].T @ true[:3, 3]
    vector = [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
    error = np.concatenate([error, np.array(vector) / 2])
    square = float(error @ np.linalg.solve(np.array(found["covariance"]), error)) / len(error)
    if square < FAR_OFF:
        return None
    return f"wrong by {np.round(error, 4)}, {square:.1f} times its variance: {done.errors[-300:]}"


def list_query_cases() -> Iterator[Case]:
    """Lists photographs to localise: each is refused, or its pose is right."""
    words = ("localize", "photo.png", "--run", "run", "--json")
    needs = ("ds", "run", "photo.png")
    for name, (change, said) in PICTURES.items():

        def spoil(folder: Path, change: Picture = change) -> None:
            install_truth(folder)
            path = str(folder / "photo.png")
            cv2.imwrite(path, change(cv2.imread(path)))

        yield Case("query", f"photograph {name}", words, needs, spoil, (said,),
                   may_pass=not said, judge=find_wrong_pose)  # fmt: skip
    for name, make in LENSES.items():

        def use_lens(folder: Path, make: Callable[[], gsut.Camera] = make) -> None:
            install_truth(folder)
            gsut.save_camera(make(), folder / "other.json")

        yield Case("query", f"lens {name}", (*words, "--camera", "other.json"), needs, use_lens,
                   (REFUSED,), may_pass=True, judge=find_wrong_pose)  # fmt: skip
