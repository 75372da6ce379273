"""The focal length that a camera or a user states, weighed against that of the images."""

import dataclasses
import math

import numpy as np
import pytest

import tolerances
from gsut.lens import convert_camera, with_scaled_focal
from gsut.sfm.lens import measure_lens_difference, measure_pose_differences
from gsut.sfm.lens.candidates import list_focal_lengths
from gsut.sfm.lens.covariance import estimate_focal_spread, estimate_lens_sigmas
from gsut.sfm.lens.doubt import judge_lens
from gsut.sfm.lens.prior import find_focal
from gsut.sfm.mapping import PosesLog
from gsut.sfm.report.verdict import judge_solution
from gsut.sfm.solution import adjust_registered
from made_flight import FREE, LENS, OPTIONS, fly, fly_again, list_true_poses


def judge(flight, px=None, sigma=0.06, fov=None):
    """Judges the lens of a flight with the focal length that EXIF states."""
    photographs = dataclasses.replace(
        flight.photographs, exif_focal_px=px, focal_sigma=None if px is None else sigma
    )
    options = dataclasses.replace(OPTIONS, fov=fov)
    run = dataclasses.replace(
        flight, photographs=photographs, options=options, log=PosesLog(),
        found=type(flight.found)(),
    )  # fmt: skip
    run = judge_lens(run)
    return run, math.log(run.solved.cameras[0].params[0] / LENS.params[0])


@pytest.fixture(scope="module")
def flight():
    """Straight down over nearly flat ground: hardly anything tells the focal length."""
    return fly(np.random.default_rng(35), relief=0.02)


@pytest.fixture(scope="module")
def walk():
    """The same camera among deep relief, turned: the images tell the focal length."""
    return fly_again(36, relief=0.3, turn=0.3)


@pytest.mark.parametrize("given", [{"px": 530.0}, {"fov": 63.0}])
def test_focal_prior_where_images_hardly_tell_is_weighed_in(flight, given):
    alone, _ = judge(flight)
    run, error = judge(flight, **given)
    row = run.found.figures["focal_prior"]
    assert row["used"] and row["source"] == ("EXIF" if "px" in given else "--fov")
    ends = sorted(math.log(row[key] / LENS.params[0]) for key in ("px", "images_px"))
    assert ends[0] <= error <= ends[1]
    assert run.found.focal_sigma < min(alone.found.focal_sigma, row["sigma_percent"] / 100)
    assert abs(error) < tolerances.FOCAL_SIGMAS * run.found.focal_sigma
    assert "the images alone give" in run.log.notes[-1]


def test_focal_prior_far_from_the_images_is_not_used(walk):
    run, _ = judge(walk, px=1.5 * LENS.params[0])
    row = run.found.figures["focal_prior"]
    assert not row["agrees"] and not row["used"] and run.solution is walk.solution
    named, _ = judge(walk, fov=25.0)
    for each, source in ((run, "EXIF"), (named, "--fov")):
        assert f"px of {source}: these are not used" in each.log.notes[-1]


def test_focal_prior_that_images_know_better_changes_nothing(walk):
    alone, error = judge(walk)
    run, _ = judge(walk, px=1.03 * LENS.params[0])
    assert run.found.figures["focal_prior"]["agrees"] and run.solution is walk.solution
    assert run.found.focal_sigma == alone.found.focal_sigma
    assert abs(error) < tolerances.FOCAL_SIGMAS * alone.found.focal_sigma


@pytest.mark.parametrize(("fov", "kinds"), [(60.0, 1), (100.0, 3), (150.0, 2), (280.0, 1)])
def test_focal_lengths_of_a_field_are_those_of_the_lenses_that_see_it(fov, kinds):
    found = list_focal_lengths(640, fov)
    assert len(found) == kinds and found == sorted(found)
    fisheye = [320 / math.radians(fov / 2)]
    perspective = [320 / math.tan(math.radians(fov / 2))]
    assert found[-1:] == pytest.approx(fisheye if fov > 75 else perspective)
    assert (found[:1] == pytest.approx(perspective)) == (fov < 130)


@pytest.mark.slow
def test_focal_sigma_with_errors_that_features_share_covers_the_error():
    errors, spreads = [], []
    for seed in range(5):
        flight = fly(np.random.default_rng(seed), relief=0.1, stretch=0.004)
        run, error = judge(flight)
        errors.append(error / run.found.focal_sigma)
        spreads.append(error / estimate_focal_spread(flight.solution, FREE))
    assert len(errors) == 5 and max(map(abs, errors)) < tolerances.FOCAL_SIGMAS
    size = math.sqrt(np.mean(np.square(spreads)))
    assert 1 / tolerances.FOCAL_SPREADS < size < tolerances.FOCAL_SPREADS


def test_focal_sigma_where_features_leave_no_doubt_counts_what_they_share():
    bent = fly(np.random.default_rng(1), relief=0.3, turn=0.3, stretch=0.004)
    run, error = judge(bent)
    (known,) = estimate_lens_sigmas(bent.solution, FREE)
    alone = known[0] / bent.solution.cameras[0].params[0]
    assert run.found.focal_sigma > tolerances.FOCAL_SIGMA_SHARED * alone
    assert abs(error) < tolerances.FOCAL_SIGMAS * run.found.focal_sigma


def test_focal_sigma_of_three_images_is_not_stated(walk):
    three = dataclasses.replace(walk.solution, registered=np.arange(12) < 3)
    run, _ = judge(dataclasses.replace(walk, solution=three))
    assert math.isinf(run.found.focal_sigma)
    assert run.found.figures["focal_sigma_percent"] is None


def give_lens(flight, factor):
    """Judges a flight through a given lens with so much of the true focal length."""
    lens = with_scaled_focal(LENS, factor)
    solution = adjust_registered(
        dataclasses.replace(flight.solution, cameras=[lens] * len(flight.solution.names)),
        flight.features, flight.pairs, OPTIONS,
    )  # fmt: skip
    run = dataclasses.replace(
        flight, solution=solution, lens_free=None, log=PosesLog(), found=type(flight.found)()
    )
    run = judge_lens(run)
    return run, judge_solution(run.solution, run.features, run.found)


@pytest.mark.parametrize(
    ("images", "factor", "word"), [(12, 0.85, "by +1"), (12, 1.2, "by -1"), (5, 1.2, "by -1")]
)
def test_given_lens_of_another_focal_length_is_contradicted(walk, images, factor, word):
    some = dataclasses.replace(walk.solution, registered=np.arange(12) < images)
    run, verdict = give_lens(dataclasses.replace(walk, solution=some), factor)
    row = run.found.figures["given_lens"]
    error = math.log(row["images_px"] / LENS.params[0])
    assert abs(error) < tolerances.FOCAL_SIGMAS * row["images_sigma_percent"] / 100
    assert not row["agrees"] and verdict.level == "poor"
    assert "--unknown-lens" in run.log.notes[-1]
    assert any(word in reason for reason in verdict.reasons)


def test_focal_length_is_found_where_parameters_begin_with_others(walk):
    lens = convert_camera(LENS, "splined_stereographic").camera
    assert lens.params[0] != lens.params[4]
    splined = dataclasses.replace(walk.solution, cameras=[lens] * len(walk.solution.cameras))
    assert find_focal(splined) == lens.params[4]


def test_given_lens_that_is_right_is_not_contradicted(walk, flight):
    for made in (walk, flight):
        run, verdict = give_lens(made, 1.0)
        assert run.found.figures["given_lens"]["agrees"] and run.found.lens_gap_px == 0
        assert not run.log.notes and verdict.level == "good"


def test_given_lens_that_images_do_not_determine_is_left_alone(flight):
    run, _ = give_lens(flight, 1.05)
    assert run.found.figures["given_lens"]["agrees"] and not run.log.notes


def test_errors_without_groups_are_about_those_of_poses_and_lens(walk, flight):
    for made, turn in ((walk, 0.3), (flight, 0.0)):
        run, _ = judge(made)
        most, many = run.found.pose_errors_px
        right = dataclasses.replace(run.solved, camera_from_world=list_true_poses(turn))
        error = np.quantile(measure_pose_differences(run.solved, right, run.solved), 0.9)
        lens = measure_lens_difference(run.solved.cameras[0], LENS)
        assert 0 < many < most and error < tolerances.FOCAL_SIGMAS * most
        assert lens < tolerances.FOCAL_SIGMAS * run.found.lens_sigma_px
        assert made is flight or most < tolerances.HALVES_FACTOR * error


def test_lens_difference_is_that_of_the_focal_length_and_not_of_a_turn():
    far = with_scaled_focal(LENS, 20.0)  # so narrow that a turn only shifts the picture
    assert measure_lens_difference(LENS, LENS) < 1e-9
    x, y = (np.arange(0.5, side) - side / 2 for side in (LENS.width, LENS.height))
    size = 0.01 * math.sqrt(np.mean(x**2) + np.mean(y**2))
    found = measure_lens_difference(far, with_scaled_focal(far, 1.01))
    assert found == pytest.approx(size, rel=0.1)
    moved = np.array(far.params)
    moved[2] += 3.0
    assert measure_lens_difference(far, far.with_params(moved)) < 0.1
