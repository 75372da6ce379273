"""Two lenses in one frame: their rig is found from the images alone, or its absence is said."""

import dataclasses

import numpy as np
import pytest

import gsut
import tolerances
from gsut.data.rigs import measure_changes, read_rig
from gsut.sfm.photographs.options import PosesOptions
from gsut.sfm.rig import find_lens_pair, write_rig_fit
from gsut.sfm.solution import Adjustment
from gsut.sfm.solution.solver import solve_poses
from gsut.sfm.world.comparison import compare_poses
from synthetic_rig import BACKWARD, SyntheticRig

FLAGS = np.array([2, 2, 0, 0, 1, 1, 0, 0], np.uint8)
FRONT = [300.0, 300.0, 400.0, 400.0, 0.02, -0.01, 0.0, 0.0]
BACK = [303.0, 303.0, 402.0, 399.0, 0.02, -0.01, 0.0, 0.0]


def lens(params):
    return gsut.Camera("kannala_brandt", params, 800, 800, valid_field_angle=np.radians(80))


class Pair:
    """A made rig of two lenses that differ, and its images placed one by one through one lens."""

    def __init__(self, rng, **settings):
        self.scene = SyntheticRig(
            rng,
            BACKWARD,
            noise=0.2,
            points=400,
            frames=8,
            lenses=(lens(FRONT), lens(BACK)),
            **settings,
        )
        self.mapping = self.scene.mapping(lens_free=FLAGS)
        self.alone = solve_poses(
            self.mapping.images.with_lens(lens(FRONT)), self.scene.pairs, PosesOptions(),
            adjustment=Adjustment(FLAGS),
        )  # fmt: skip
        self.mapping = self.mapping.replace(solution=self.alone)

    def find(self, **changes):
        mapping = dataclasses.replace(self.mapping, **changes)
        mapping = find_lens_pair(mapping)
        return mapping.solved, mapping.found.rig, mapping.log.notes[-1]


def test_rig_and_both_lenses_are_found_from_the_images(rng, tmp_path):
    pair = Pair(rng, absent=((3, 1),))
    solution, fit, words = pair.find()
    assert "the two lenses are a rig: 8 frames" in words
    assert solution.registered.all()
    errors = compare_poses(solution.camera_from_world, pair.scene.poses)
    assert errors.rotation_degrees.max() < tolerances.RIG_DEGREES
    ((turn, _),) = measure_changes(pair.scene.rig, fit.rig.camera_from_reference)[1:]
    assert np.degrees(turn) < tolerances.RIG_FOUND_DEGREES
    for found, params in zip(fit.rig.cameras, (FRONT, BACK), strict=True):
        off = np.abs(found.params[:4] - params[:4])
        assert off.max() < tolerances.RIG_FOUND_LENS_PX
    write_rig_fit(fit, tmp_path)
    again = read_rig(tmp_path / "rig.json")
    assert again.names == ("front", "back") and again.cameras[1] == fit.rig.cameras[1]
    larger = fit.rescale(10.0)
    assert larger.rig.baseline == pytest.approx(10 * fit.rig.baseline)


def test_images_that_were_not_taken_together_stay_single(rng):
    pair = Pair(rng)
    photographs = pair.scene.photographs
    # The back lens' images belong to other frames than their names say.
    frames = photographs.frames.copy()
    back = photographs.rig_cameras == 1
    frames[back] = (frames[back] + 3) % 8
    wrong = dataclasses.replace(photographs, frames=frames)
    solution, fit, words = pair.find(photographs=wrong)
    assert solution is pair.alone and fit is None
    assert "placed one by one" in words
