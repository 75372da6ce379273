"""Lenses of every family through every command, on a scene that the lens itself photographed.

A row is a test function with the argument `case`; GSUT_EVERY_LENS=1 takes all lenses, as the night
does, and adding a lens adds no line here. What a command cannot do with a lens whose rays do not
meet, it must refuse in words; those are stated at the row.
Poses, rigs and localisation have theirs in sfm/test_every_lens_poses.py, camera convert in
lens/test_camera_convert.py. Rows of compact run the command; the others call the one function
that the command calls (doctor: `diagnose`, train: `train`, eval: `evaluate`), which is faster;
flags and files of these commands are tested in cli/.
"""

import dataclasses
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest

import gsut
import tolerances as tol
from gsut import _core
from gsut.check import diagnose
from gsut.cli import main
from gsut.data.scene import TrainingViews
from gsut.evaluate import evaluate
from gsut.lens import Camera
from gsut.refine import TrainingRefiner
from random_scenes import list_models, small_camera
from rendered_dataset import poses, truth, write_views

WIDTH, STEPS = 64, 40
TEST_VIEW = 2  # of those below
VIEWS = range(0, 12, 2)  # of the ring of poses


class Case:
    """A small camera of one lens, the scene that it photographed, and what rows share."""

    def __init__(self, model: str, folder: Path) -> None:
        self.model = model
        self.folder = folder
        self.camera: Camera = small_camera(model, 0, WIDTH)
        self.truth = truth(np.random.default_rng(7)).to_dtype(np.float32)
        self.poses = [poses()[index] for index in VIEWS]

    def write(self, name: str, camera_from_world: list[np.ndarray]) -> Path:
        """The photographs with these poses, right or not."""
        points = self.truth.means + np.random.default_rng(8).normal(0, 0.03, (len(self.truth), 3))
        return write_views(
            self.folder / name, self.truth, self.camera, self.poses, points=points,
            test=[TEST_VIEW], stated=camera_from_world,
        )  # fmt: skip

    @cached_property
    def data(self) -> Path:
        return self.write("data", self.poses)

    @cached_property
    def perturbed(self) -> Path:
        """The photographs with poses off by 2 cm and 0.004 radians, as a standard deviation."""
        rng = np.random.default_rng(9)
        off = [_core.exp_pose(rng.normal(0, [0.02] * 3 + [0.004] * 3)) @ p for p in self.poses]
        return self.write("perturbed", off)

    @cached_property
    def trained(self) -> gsut.TrainResult:
        """A short training of the data."""
        return self.train(self.data, steps=STEPS)

    def train(self, data: Path, **options) -> gsut.TrainResult:
        black = (0.0, 0.0, 0.0)  # as the truth was rendered
        settings = gsut.TrainOptions(
            sh_degree=0, seed=1, max_gaussians=300, background=black, **options
        )
        return gsut.train(gsut.load_dataset(data), settings, progress=False)


_CASES: dict[str, Case] = {}


@pytest.fixture(params=list_models())
def case(request, tmp_path_factory) -> Case:
    model = request.param
    if model not in _CASES:
        _CASES[model] = Case(model, tmp_path_factory.mktemp(model))
    return _CASES[model]


def test_dataset_comes_back_and_the_doctor_finds_no_error(case):
    scene = gsut.load_dataset(case.data)
    assert list(scene.cameras) == [case.camera] and list(scene.test_indices) == [TEST_VIEW]
    errors = [f for f in diagnose(case.data, progress=False) if f.severity == "error"]
    assert errors == []


def test_render_of_the_truth_is_the_photograph(case):
    scene = gsut.load_dataset(case.data)
    moved = dataclasses.replace(
        case.truth, means=(case.truth.means - scene.world_offset).astype(np.float32)
    )
    for index in (0, TEST_VIEW):
        image = gsut.render(moved, scene.camera(index), scene.views[index].motion).image
        off = np.abs(255 * np.clip(image, 0, 1) - scene.image(index))[scene.mask(index)]
        assert np.median(off) <= 0.5 and np.mean(off) < tol.EVERY_LENS_GREY_LEVELS


def test_train_learns_and_eval_measures_the_same(case):
    first = case.train(case.data, steps=1).metrics["psnr"]
    psnr = case.trained.metrics["psnr"]
    print(case.model, first, "->", psnr, "dB")
    assert psnr > first + tol.EVERY_LENS_GAIN_DB
    again = evaluate(case.trained.gaussians, case.trained.scene, [TEST_VIEW])
    assert again["psnr"] == pytest.approx(psnr, abs=tol.EVERY_LENS_SAME_DB)


def test_compact_keeps_most_of_the_picture(case):
    ply, out = case.folder / "scene.ply", case.folder / "compact.ply"
    gsut.formats.save_ply(ply, case.trained.gaussians)
    assert main(["compact", str(ply), "-o", str(out), "--keep", "0.7", "--quiet"]) == 0
    fewer = gsut.formats.load_ply(out)
    assert len(fewer) == pytest.approx(0.7 * len(case.trained.gaussians), abs=1)
    psnr = evaluate(fewer, case.trained.scene, [TEST_VIEW])["psnr"]
    print(case.model, case.trained.metrics["psnr"], "->", psnr, "dB")
    assert psnr > case.trained.metrics["psnr"] - tol.EVERY_LENS_COMPACT_DB


@pytest.mark.parametrize("refine_lens", [False, True])
def test_refine_undoes_pose_errors_against_the_true_gaussians(case, refine_lens):
    scene = gsut.load_dataset(case.perturbed)
    views = TrainingViews(scene, (0, 0))
    options = gsut.TrainOptions(refine_poses=True, refine_lens=refine_lens)
    if not case.camera.is_central:  # its rays have no derivative to the pose of a centre
        with pytest.raises(gsut.InputError, match="needs a lens with one centre"):
            TrainingRefiner(views, options)
        return
    refiner = TrainingRefiner(views, options)
    truth = dataclasses.replace(
        case.truth, means=(case.truth.means - scene.world_offset).astype(np.float32)
    )

    def turns(poses: np.ndarray) -> np.ndarray:  # from view to view: free of the world's axes
        return np.einsum("aij,bkj->abik", poses[:, :3, :3], poses[:, :3, :3])

    right = turns(np.array(case.poses)[list(scene.train_indices)])
    before = np.abs(turns(views.poses) - right).mean()
    for step in range(3 if refine_lens else 2):
        refiner.finish(truth, views.select_level(1.0), step)
    after = np.abs(turns(views.poses) - right).mean()
    print(case.model, refine_lens, before, "->", after)
    assert after < tol.EVERY_LENS_REFINED[refine_lens] * before


def test_refine_trains_on_and_keeps_the_lens_model_or_says_why_not(case):
    data = case.perturbed
    options = {"steps": 4, "refine_lens": True}
    if not case.camera.is_central:  # its rays have no derivative to the pose of a centre
        with pytest.raises(gsut.InputError, match="needs a lens with one centre"):
            case.train(data, **options)
        return
    try:
        refined = case.train(data, **options)
    except gsut.InputError as error:  # the smallest picture of the pyramid, through a wide lens
        rays, valid = case.camera.rays()
        assert np.arccos(rays[valid][:, 2].min()) > np.radians(85.0)
        assert "too small for its field of view" in str(error)
        return
    assert refined.scene.cameras[0].model == case.model
    assert np.isfinite(refined.metrics["psnr"]) and refined.metrics["refinement"]
