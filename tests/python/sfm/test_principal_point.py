"""Principal points: found where images determine them, else held near the middle of the picture."""

import dataclasses
import math

import numpy as np
import pytest

import tolerances
from gsut.lens import Camera
from gsut.sfm.lens import free_center, judge_lens
from gsut.sfm.lens.covariance import estimate_lens_sigmas
from gsut.sfm.lens.information import spread_free_parameters
from gsut.sfm.mapping import PosesLog
from gsut.sfm.solution import (
    CENTER,
    Adjustment,
    LensFlag,
    adjust_registered,
    find_lens_prior,
)
from made_flight import FREE, LENS, fly_again

WIDER = 60  # pixels that the picture reaches farther to the right: its middle moves by half of it
STRETCH = 1.003  # height of a pixel over its width
CENTER_FREE = FREE.copy()
CENTER_FREE[list(CENTER)] = 1


def widen(run):
    """The flight by a lens whose centre is taken to be in the middle of a wider picture."""
    width = LENS.width + WIDER
    middle = [*LENS.params[:2], width / 2, LENS.height / 2, *LENS.params[4:]]
    start = Camera(LENS.model, middle, width, LENS.height)
    return dataclasses.replace(run.solved, cameras=[start] * len(run.solved.cameras))


def find_center(run, sigma=Adjustment.center_sigma, flags=CENTER_FREE):
    """Estimates a flight's lens from the middle of a wider picture: error and sigma, pixels."""
    found = adjust_registered(
        widen(run), run.features, run.pairs, run.options,
        adjustment=Adjustment(flags, center_sigma=sigma),
    )  # fmt: skip
    error = found.cameras[0].params[list(CENTER)] - LENS.params[list(CENTER)]
    known = estimate_lens_sigmas(found, flags)[0]
    return error, known[list(CENTER)]


def test_center_is_found_where_turns_determine_it():
    run = fly_again(1, relief=0.3, turn=0.5)
    error, sigma = find_center(run)
    assert (np.abs(error) < tolerances.CENTER_SIGMAS * sigma).all()
    assert (sigma < WIDER / 10).all()
    free, _ = find_center(run, math.inf)
    assert (np.abs(error - free) < sigma).all()  # the prior matters less than the features


def test_center_that_images_leave_open_stays_at_the_middle_with_the_priors_sigma():
    run = fly_again(1, relief=0.02)
    error, sigma = find_center(run)
    width = Adjustment.center_sigma * math.hypot(LENS.width + WIDER, LENS.height)
    assert np.abs(error - [WIDER / 2, 0]).max() < tolerances.CENTER_SIGMAS * width
    assert sigma == pytest.approx([width, width], rel=tolerances.CENTER_OPEN)
    held, _ = find_center(run, 1e-9)
    assert held == pytest.approx([WIDER / 2, 0], abs=tolerances.CENTER_HELD_PX)


def test_pixels_that_are_not_square_are_found_where_turns_determine_them():
    run = fly_again(1, relief=0.3, turn=0.5)
    stretched = [
        dataclasses.replace(each, pixels=each.pixels * [1.0, STRETCH]) for each in run.features
    ]
    found = free_center(run.replace(features=stretched))
    across, down = found.solved.cameras[0].params[:2]
    assert abs(down / across - STRETCH) < (STRETCH - 1) / 2  # as square ones it is twice as much


def test_pixels_are_square_as_far_as_is_known_beforehand_where_features_are_few():
    lens = Camera(LENS.model, [520, 530, *LENS.params[2:]], LENS.width, LENS.height)
    flags = np.array([LensFlag.TIED, LensFlag.NEAR, 0, 0, 0, 0, 0, 0])
    mean, sigma = find_lens_prior(lens, flags)
    assert mean[1] == 520 and np.isinf(sigma[2:]).all()
    assert 0 < sigma[1] < 520 * (STRETCH - 1)
    columns = spread_free_parameters(flags)
    assert np.array_equal(columns[:2], [[1, 0], [1, 1]]) and not columns[2:].any()


@pytest.mark.parametrize(("signs", "is_estimated"), [(None, True), (1.0, True), (3.0, False)])
def test_center_is_estimated_unless_a_video_may_have_a_rolling_shutter(signs, is_estimated):
    run = fly_again(1, relief=0.3, turn=0.5)
    run = run.replace(
        solution=adjust_registered(
            widen(run), run.features, run.pairs, run.options, adjustment=Adjustment(FREE)
        )
    )
    if signs is not None:
        run = run.replace(
            photographs=dataclasses.replace(run.photographs, flows={"00.jpg": np.zeros((1, 4))})
        )
        run = run.add_findings({"shutter_signs": signs})
    heard: list[str] = []
    run = free_center(run.replace(log=PosesLog(on_note=heard.append)))
    run = judge_lens(run)
    error = run.solved.cameras[0].params[list(CENTER)] - LENS.params[list(CENTER)]
    row = run.found.figures["principal_point"]
    assert row["estimated"] is is_estimated
    if is_estimated:
        assert (np.abs(error) < tolerances.CENTER_SIGMAS * np.array(row["sigma_px"])).all()
        assert "the principal point lies -30.0" in " ".join(heard)
    else:
        assert error == pytest.approx([WIDER / 2, 0], abs=tolerances.CENTER_HELD_PX)
        assert "was not estimated" in " ".join(run.log.notes) and not heard


@pytest.mark.parametrize(("turn", "pixels", "says"), [(0.5, 0, ""), (0.0, WIDER, "leave it open")])
def test_center_in_the_middle_and_one_that_the_motion_leaves_open_stay_near_the_middle(
    turn, pixels, says
):
    run = fly_again(1, relief=0.3, turn=turn)
    if pixels:
        run = run.replace(
            solution=adjust_registered(
                widen(run), run.features, run.pairs, run.options, adjustment=Adjustment(FREE)
            )
        )
    run = judge_lens(free_center(run))
    row = run.found.figures["principal_point"]
    assert row["estimated"] is True
    assert (np.abs(row["off_px"]) < tolerances.CENTER_SIGMAS * np.array(row["sigma_px"])).all()
    assert says in " ".join(run.log.notes)
