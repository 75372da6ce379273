"""An unknown lens: first lenses and their ranking, what is refused, what is open, the verdict."""

import dataclasses
import math

import numpy as np
import pytest

import gsut
import tolerances
from gsut.lens import with_scaled_focal
from gsut.lens.database import load_profiles
from gsut.run import Verdict
from gsut.sfm.lens.candidates import list_lens_ladder, make_lens
from gsut.sfm.lens.information import spread_free_parameters
from gsut.sfm.lens.ranking import LensRanking
from gsut.sfm.lens.search import search_lens
from gsut.sfm.mapping import Findings
from gsut.sfm.mapping.log import PosesLog
from gsut.sfm.matches.matching import RawMatches, match_images
from gsut.sfm.matches.verification import explain_failure, require_overlap
from gsut.sfm.photographs import Images
from gsut.sfm.photographs.features import Features
from gsut.sfm.photographs.options import PosesOptions
from gsut.sfm.report.verdict import judge_solution
from gsut.sfm.solution import Adjustment, find_lens_prior
from gsut.sfm.solution.solver import solve_poses
from synthetic_walk import Synthetic, quiet


@pytest.fixture(scope="module")
def walk():
    """A walk through square pixels, its matches, and its poses with the lens known."""
    lens = gsut.Camera("kannala_brandt", [300, 300, 500, 505, 0.02, -0.01, 0, 0], 1000, 1010)
    scene = Synthetic(np.random.default_rng(5), images=8, points=400, noise=0.1, camera=lens)
    raw = match_images(scene.images().names, scene.features, PosesOptions(), quiet)
    pairs = scene.verified()
    solution = solve_poses(scene.images(), pairs, PosesOptions())
    return scene, raw, pairs, solution


def edge_angle(lens: gsut.Camera) -> float:
    """Of the middle of the longer side, from the axis."""
    x, y = (0.0, lens.height / 2) if lens.width >= lens.height else (lens.width / 2, 0.0)
    ray = lens.unproject(np.array([[x, y]]))[0][0]
    return 2 * math.degrees(math.atan2(math.hypot(ray[0], ray[1]), ray[2]))


def test_lens_ladder_has_square_pixels_and_fields_from_narrow_to_wide():
    ladder = list_lens_ladder(1080, 1920, None)
    fields = [edge_angle(lens) for lens in ladder]
    assert min(fields) < 30 and max(fields) > 190
    for lens in ladder:
        assert lens.params[0] == lens.params[1]
        assert tuple(lens.params[2:4]) == (540, 960)


def test_lens_ladder_of_a_given_field_has_that_field():
    for lens in list_lens_ladder(640, 480, 80.0):
        assert edge_angle(lens) == pytest.approx(80, rel=0.01)


def test_ranking_finds_the_field_of_view(walk):
    scene, raw, _, _ = walk
    few = RawMatches(raw.pairs[:6], [matches[:60] for matches in raw.matches[:6]])
    ranking = LensRanking(scene.features, few, PosesOptions())
    told = []
    ladder = list_lens_ladder(1000, 1010, None)[9::3]
    best = ranking.rank_lenses([], ladder, lambda done, total: told.append(done / total))
    assert best[0].share >= best[1].share
    assert best[0].camera.params[0] == pytest.approx(300, rel=0.15)
    assert told == sorted(told)
    # A likely lens is preferred where it is right, and not where it is wrong.
    assert ranking.rank_lenses([scene.camera], ladder[:1], quiet)[0].camera == scene.camera
    wrong = with_scaled_focal(scene.camera, 2.0)
    assert ranking.rank_lenses([wrong], [scene.camera], quiet)[0].camera == scene.camera


def test_free_columns_tie_parameters_of_one_flag():
    columns = spread_free_parameters(np.array([2, 2, 0, 1]))
    assert np.array_equal(columns, [[1, 0], [1, 0], [0, 0], [0, 1]])


def test_tied_focal_lengths_change_alike(walk):
    scene, _, pairs, _ = walk
    guess = gsut.Camera("kannala_brandt", [310, 312, 500, 505, 0, 0, 0, 0], 1000, 1010)
    flags = np.array([2, 2, 0, 0, 1, 1, 0, 0])
    found = solve_poses(
        scene.images(guess), pairs, PosesOptions(max_error=5.0), quiet, Adjustment(flags)
    )
    fx, fy, *rest = found.cameras[0].params
    assert fy - fx == pytest.approx(2, abs=1e-9) and fx != 310
    assert list(rest[:2]) == [500, 505] and list(rest[4:]) == [0, 0]


def doubt(sigma):
    return Findings(focal_sigma=sigma)


def many(solution):
    """The solution as if of 30 images."""
    return dataclasses.replace(
        solution,
        names=[f"{i}" for i in range(30)],
        registered=np.ones(30, bool),
        observations=np.stack([np.arange(30 * 200)] * 3, axis=1) % [1, 30, 1],
    )


def reject(pairs, worst):
    """Poses that reject such a share of the pairs, and of the matches of an image."""
    return Findings(contradicted=pairs, contradicted_images={"3": worst, "4": worst / 2})


@pytest.mark.parametrize(
    "change, level, words",
    [
        ({}, "good", ""),
        # Pairs whose matches are rejected as a whole: right poses have some where things repeat.
        ({"doubt": reject(0.16, 0.17)}, "good", ""),
        ({"doubt": reject(0.03, 0.45)}, "good", ""),
        ({"doubt": reject(0.08, 0.3)}, "poor", "reject all matches of 8 % of the pairs of images"),
        # Either half of the points: all pairs alike, a tenth apart, most apart, images lost.
        ({"doubt": Findings(pose_errors_px=(90.0, 0.5))}, "usable", "poses are 90.0 px off"),
        ({"doubt": Findings(pose_errors_px=(200.0, 90.0))}, "poor", "poses are 200.0 px off"),
        ({"doubt": Findings(pose_errors_px=(math.inf, 0.5))}, "usable", "lose their pose"),
        # The lens: where its error was measured its focal length alone does not judge.
        ({"doubt": Findings(lens_sigma_px=1.0, focal_sigma=0.1)}, "good", ""),
        ({"doubt": Findings(lens_sigma_px=15.0, focal_sigma=0.1)}, "usable", "only to 20.0 %"),
        ({"doubt": Findings(lens_sigma_px=133.4, focal_sigma=0.01)}, "poor", "is probably 90.0 px"),
        ({"doubt": doubt(0.03)}, "usable", "known only to 6.0 %"),
        ({"doubt": doubt(0.08)}, "usable", "known only to 16.0 %"),
        ({"doubt": doubt(0.1)}, "poor", "known only to 20.0 %"),
        ({"doubt": doubt(math.inf)}, "poor", "not determined"),
        ({"registered": np.arange(30) < 25}, "usable", "5 of 30 images could not"),
        ({"registered": np.arange(30) < 5}, "poor", "only 5 views"),
        ({"colors": 5, "such": 10}, "usable", "10 of 30 images are too dark"),
        ({"colors": 5}, "poor", "30 of 30 images are too dark"),
        # Small pictures have few features; those that have a pose had enough.
        ({"features": 100}, "good", ""),
        (
            {"features": 100, "registered": np.arange(30) < 5},
            "poor",
            "25 of 30 images have few features",
        ),
        # What is wrong with the pictures comes before what it leads to.
        (
            {"colors": 5, "registered": np.arange(30) < 5},
            "poor",
            "(30 of 30 images are too dark",
        ),
    ],
)
def test_poses_verdict_says_level_and_reason(walk, change, level, words):
    usual = {"doubt": Findings(), "colors": 120, "features": 2000, "such": 30}
    change = {**usual, **change}
    such = change.pop("such")

    def seen(values):
        count = values["features"]
        return Features(
            np.zeros((count, 2)), np.ones(count), np.zeros((count, 128)),
            np.full((count, 3), values["colors"], np.uint8),
        )  # fmt: skip

    features = [seen(change)] * such + [seen(usual)] * (30 - such)
    change = {key: value for key, value in change.items() if key not in ("features", "colors")}
    found = change.pop("doubt")
    solution = dataclasses.replace(many(walk[3]), **change)
    verdict = judge_solution(solution, features, found)
    assert verdict.level == level
    assert words in str(verdict) and verdict.advice
    assert Verdict.from_dict(verdict.as_dict()) == verdict


def test_poses_log_of_a_mapper_never_goes_back():
    told = []
    show = PosesLog(lambda stage, done, total, text: told.append((done, total))).follow_steps("m")
    steps = [(2, "first pair"), (10, "image"), (4, "image"), (20, "adjustment"), (20, "settling")]
    last = ("longer tracks", "longer tracks", "longer tracks", "final adjustment", "covariances")
    for done, step in [*steps, *((20, step) for step in last)]:
        show(done, 20, 100, step)
    shares = [done / total for done, total in told]
    assert shares == sorted(shares) and shares[0] < shares[4] < shares[-1] <= 1


def test_search_lens_of_few_images_that_hardly_move_says_so():
    lens = gsut.Camera("kannala_brandt", [300, 300, 500, 505, 0, 0, 0, 0], 1000, 1010)
    scene = Synthetic(np.random.default_rng(1), images=3, points=300, camera=lens)
    features = [scene.features[0], scene.features[0], scene.features[1]]
    scene.features = features
    raw = match_images(["0", "1", "2"], features, PosesOptions(), quiet)
    few = RawMatches(raw.pairs, [matches[:25] for matches in raw.matches])
    with pytest.raises(gsut.SolveError, match="3 images are few"):
        search_lens(scene.mapping(PosesOptions(fov=100.0), raw=few))


@pytest.mark.parametrize("seed", [0, 2])
def test_lens_of_few_noisy_images_is_held_by_what_is_known_of_distortion(seed):
    lens = gsut.Camera("opencv4", [800, 800, 500, 505, 0.03, -0.04, 0, 0], 1000, 1010)
    walk = Synthetic(np.random.default_rng(seed), images=6, points=400, noise=0.7, camera=lens)
    found = search_lens(walk.mapping(PosesOptions())).solved.cameras[0]
    assert found.model == "opencv4"
    assert found.params[0] == pytest.approx(800, rel=tolerances.SFM_FEW_NOISY_FOCAL)


def test_prior_of_coefficients_is_a_lens_that_bends_as_the_first_one_says():
    bend = 0.7
    lens = make_lens(640, 480, 60.0, bend)
    free = np.ones(8, np.uint8)
    mean, sigma = find_lens_prior(lens, free)
    # The coefficients of such a lens, and the middle.
    assert mean[1:] == pytest.approx(lens.params[1:])
    assert np.isinf(sigma[[1, 4]]).all() and np.isfinite(sigma[[2, 3, 5, 6, 7]]).all()
    assert (np.diff(sigma[5:]) > 0).all()  # inside one radian the higher ones shift the edge less
    held = find_lens_prior(lens, np.where(np.arange(8) < 5, free, 0))[1]
    assert np.isinf(held[5:]).all() and np.isinf(find_lens_prior(lens, free, math.inf)[1]).all()


def test_focal_length_is_known_beforehand_as_of_all_lenses():
    lens, free = make_lens(640, 480, 60.0, 1.0), np.ones(8, np.uint8)
    mean, sigma = find_lens_prior(lens, free)
    some = [profile.make_camera(640, 480) for profile in load_profiles()[::20]]
    logs = [math.log(float(camera.params[0])) for camera in some]
    assert math.log(mean[0]) == pytest.approx(np.mean(logs), abs=0.05)
    assert sigma[0] == pytest.approx(np.std(logs), abs=0.05)
    free[0] = 0
    assert np.isinf(find_lens_prior(lens, free)[1][0])


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_focal_length_goes_where_it_is_known_beforehand(monkeypatch, factor):
    lens = gsut.Camera("opencv4", [800, 800, 500, 505, 0, 0, 0, 0], 1000, 1010)
    walk = Synthetic(np.random.default_rng(5), images=6, points=400, camera=lens)
    known = math.log(factor * 800 / 1010), 1e-5  # as if sure, and wrong
    monkeypatch.setattr("gsut.sfm.solution.adjustment._FOCAL", known)
    mapping = walk.mapping(PosesOptions())
    free = Adjustment(np.array([2, 2, 0, 0, 0, 0, 0, 0], np.uint8))
    found = solve_poses(walk.images(), walk.verified(), mapping.options, adjustment=free)
    assert found.cameras[0].params[0] == pytest.approx(factor * 800, rel=0.01)


def test_nothing_found_names_causes_and_what_to_do():
    few = [
        Features(np.zeros((9, 2)), np.ones(9), np.zeros((9, 128)), np.full((9, 3), 9, np.uint8))
    ] * 12
    words = str(explain_failure(gsut.SolveError("no start"), few, [], "give --fov"))
    assert words.startswith("no start; 12 of 12 images are too dark")
    assert "have few features" in words
    assert words.endswith("; walk sideways to what you photograph, or give --fov")
    seen = [Features(np.zeros((99, 2)), *(np.ones((99, n)) for n in (1, 128, 3)))] * 4
    for known in (True, False):  # pictures that have nothing to do with each other
        with pytest.raises(gsut.SolveError, match="photographs of one place") as refused:
            images = Images(["a", "b", "c", "d"], [], seen)
            require_overlap(images, [], is_lens_known=known)
        assert ("lens" in str(refused.value)) == known
