"""Several cameras in one run: each unknown lens is estimated, beside those that are known."""

import dataclasses

import numpy as np
import pytest

import gsut
import tolerances
from disturbances import disturb_rig
from gsut._core import SolveError
from gsut.data.rigs import measure_changes
from gsut.sfm import PosesOptions, compare_poses
from gsut.sfm.lens.cameras import search_lenses
from gsut.sfm.lens.candidates import DEFAULT_FIELD, guess_lens, guess_lenses
from gsut.sfm.lens.covariance import estimate_lens_sigmas
from gsut.sfm.lens.doubt import describe_cameras, judge_lens
from gsut.sfm.matches.matching import match_images
from gsut.sfm.photographs.listing import LensGroup, _group_by_folder
from gsut.sfm.rig import solve_rig
from synthetic_rig import STEREO, SyntheticRig
from synthetic_walk import Synthetic, quiet

LENSES = (
    gsut.Camera("opencv4", [940, 940, 640, 480, 0, 0, 0, 0], 1280, 960),
    gsut.Camera("kannala_brandt", [393, 393, 640, 480, 0.02, -0.01, 0.002, 0], 1280, 960),
)
FRAMES = 12
OPTIONS = PosesOptions()


@pytest.fixture(scope="module")
def scene():
    """Two cameras of one size and different lenses, which nothing is known of."""
    rng = np.random.default_rng(20261124)
    return SyntheticRig(rng, STEREO, frames=FRAMES, points=1500, noise=0.1, lenses=LENSES)


def start(scene, known=(), monkeypatch=None):
    """A run whose lenses are unknown but for those of the known cameras."""
    given = scene.photographs
    cameras = [
        camera if number in known else None
        for camera, number in zip(given.cameras, given.rig_cameras, strict=True)
    ]
    photographs = dataclasses.replace(given, cameras=cameras, frames=None, rig_cameras=None)
    return _group_by_folder(photographs)


def run(scene, photographs, monkeypatch):
    sizes = {str(p): c for p, c in zip(photographs.paths, scene.photographs.cameras, strict=True)}
    monkeypatch.setattr("gsut.sfm.lens.candidates.read_header", lambda path: sizes[str(path)])
    raw = match_images(photographs.names, scene.features, OPTIONS, quiet)
    mapping = dataclasses.replace(
        scene.mapping(), photographs=guess_lenses(photographs, None), options=OPTIONS, raw=raw,
        pairs=[],
    )  # fmt: skip
    mapping = search_lenses(mapping)
    return mapping


@pytest.fixture(scope="module")
def found(scene):
    """A run that has estimated both lenses."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        return run(scene, start(scene), monkeypatch)


def check(scene, mapping, registered, focal_error=tolerances.SEVERAL_LENSES_FOCAL):
    solution = mapping.solved
    assert solution.num_registered == registered
    focal = [solution.cameras[i].params[0] for i in range(len(solution.names))]
    for found, number in zip(focal, scene.photographs.rig_cameras, strict=True):
        assert found == pytest.approx(LENSES[number].params[0], rel=focal_error)
    errors = compare_poses(solution.camera_from_world, scene.poses)
    assert errors.ate_percent < tolerances.SEVERAL_LENSES_ATE_PERCENT


def test_two_unknown_lenses_of_one_size_are_both_found(scene, found):
    mapping = found
    assert [group.name for group in start(scene).groups] == ["left", "right"]
    check(scene, mapping, 2 * FRAMES)
    mapping = judge_lens(mapping)
    assert mapping.found.focal_sigma < tolerances.SEVERAL_LENSES_FOCAL


def test_two_unknown_lenses_on_a_rig_are_found_with_the_rigs_turns(scene, found):
    rig = disturb_rig(scene.rig).forget_lenses()
    given = scene.photographs
    mapping = dataclasses.replace(
        found, rig=rig, options=dataclasses.replace(OPTIONS, refine_rig=True),
        photographs=dataclasses.replace(
            found.photographs, frames=given.frames, rig_cameras=given.rig_cameras
        ),
    )  # fmt: skip
    mapping = solve_rig(mapping)
    check(scene, mapping, 2 * FRAMES)
    fit = mapping.found.rig
    off = [
        np.abs(lens.params[2:4] - truth.params[2:4]).max()
        for lens, truth in zip(fit.rig.cameras, LENSES, strict=True)
    ]
    assert max(off) < tolerances.RIG_CENTER_PX
    ((turn, _),) = measure_changes(scene.rig, fit.rig.camera_from_reference)[1:]
    assert np.degrees(turn) < tolerances.RIG_FOUND_DEGREES  # was 0.5


@pytest.mark.slow
def test_an_unknown_lens_beside_a_known_one_is_found_and_the_known_one_held(scene, monkeypatch):
    mapping = run(scene, start(scene, known=(0,)), monkeypatch)
    check(scene, mapping, 2 * FRAMES)
    assert mapping.solved.cameras[0] is scene.photographs.cameras[0]


@pytest.mark.slow
def test_a_camera_of_two_photographs_gets_its_lens_from_points_of_the_others(scene, monkeypatch):
    photographs = start(scene)
    left, right = photographs.groups
    kept = [*left.images, *right.images[:2]]
    few = dataclasses.replace(scene.photographs)
    scene_few = object.__new__(SyntheticRig)
    vars(scene_few).update(vars(scene))
    pick = lambda values: [values[i] for i in sorted(kept)]  # noqa: E731
    scene_few.features, scene_few.poses = pick(scene.features), scene.poses[sorted(kept)]
    scene_few.photographs = dataclasses.replace(
        few, names=pick(few.names), paths=pick(few.paths), masks=pick(few.masks),
        cameras=pick(few.cameras), rig_cameras=few.rig_cameras[sorted(kept)],
        frames=few.frames[sorted(kept)],
    )  # fmt: skip
    mapping = run(scene_few, start(scene_few), monkeypatch)
    check(scene_few, mapping, FRAMES + 2, tolerances.SEVERAL_LENSES_FEW_FOCAL)


def split_cameras(walk):
    """A run of photographs by a camera each, of which nothing is known."""
    mapping, count = walk.mapping(OPTIONS), len(walk.features)
    photographs = dataclasses.replace(
        mapping.photographs,
        cameras=[guess_lens(1000, 1010, DEFAULT_FIELD)] * count,
        groups=tuple(LensGroup(str(i), np.array([i]), (), None, None) for i in range(count)),
    )
    return mapping.replace(photographs=photographs, pairs=[])


def test_photographs_by_a_camera_each_are_found_through_lenses_far_from_the_guess():
    rng = np.random.default_rng(1)
    zooms = np.exp(rng.uniform(np.log(0.6), np.log(3.0), 8)).tolist()
    lens = gsut.Camera("opencv4", [800, 800, 500, 505, 0, 0, 0, 0], 1000, 1010)
    walk = Synthetic(
        rng, images=len(zooms), points=1500, noise=0.5, turn=0.3, camera=lens, zooms=zooms
    )
    solution = search_lenses(split_cameras(walk)).solved
    assert solution.registered.all()  # 7 of 8 by one start alone
    found = [camera.params[0] / 800 for camera in solution.cameras]
    assert found == pytest.approx(zooms, rel=tolerances.SEVERAL_LENSES_FEW_FOCAL)


def test_photographs_by_a_camera_each_from_one_place_are_refused_with_the_cause(rng):
    lens = gsut.Camera("opencv4", [800, 800, 500, 505, 0, 0, 0, 0], 1000, 1010)
    walk = Synthetic(rng, images=6, points=1500, noise=0.3, turn=0.1, reach=1e-3, camera=lens)
    with pytest.raises(SolveError, match="the camera hardly moved between them"):
        search_lenses(split_cameras(walk))


def test_a_camera_that_sees_nothing_of_the_others_gets_no_pose_and_a_note(scene, monkeypatch):
    photographs = start(scene)
    blind = dataclasses.replace(photographs)
    mapping = run_without_matches(scene, blind, monkeypatch)
    assert not mapping.solved.registered[photographs.groups[1].images].any()
    found, missing = describe_cameras(mapping)
    assert found == "the lens of each of these cameras was found: left"
    assert "no lens was found" in missing and "the camera right" in missing


def run_without_matches(scene, photographs, monkeypatch):
    right = photographs.groups[1].images
    alone = object.__new__(SyntheticRig)
    vars(alone).update(vars(scene))
    alone.features = [
        dataclasses.replace(f, pixels=f.pixels[:0], sizes=f.sizes[:0],
                            descriptors=f.descriptors[:0], colors=f.colors[:0])
        if i in right else f for i, f in enumerate(scene.features)
    ]  # fmt: skip
    return run(alone, photographs, monkeypatch)


def test_photographs_of_a_camera_each_all_get_a_pose_and_their_focal_length(monkeypatch):
    lens = gsut.Camera("opencv4", [600, 600, 500, 505, 0, 0, 0, 0], 1000, 1010)
    zooms = [1.0, 0.9, 1.2, 1.1, 0.85, 1.0, 1.15, 0.95]
    walk = Synthetic(np.random.default_rng(11), camera=lens, zooms=zooms)
    mapping = walk.mapping(OPTIONS)
    each = tuple(LensGroup(f"{i}", np.array([i])) for i in range(len(zooms)))
    unknown = dataclasses.replace(mapping.photographs, cameras=[None] * len(zooms), groups=each)
    monkeypatch.setattr("gsut.sfm.lens.candidates.read_header", lambda path: lens)
    mapping = dataclasses.replace(mapping, photographs=guess_lenses(unknown, None))
    mapping = search_lenses(mapping)
    assert mapping.solved.num_registered == len(zooms)
    for found, zoom in zip(mapping.solved.cameras, zooms, strict=True):
        assert found.params[0] == pytest.approx(600 * zoom, rel=tolerances.LENS_EACH_FOCAL)
    by_features = max(
        sigmas[0] / lens.params[0]
        for sigmas, lens in zip(
            estimate_lens_sigmas(mapping.solved, mapping.lens_free), mapping.solved.cameras,
            strict=True,
        )
    )  # fmt: skip
    assert by_features <= judge_lens(mapping).found.focal_sigma < tolerances.LENS_EACH_FOCAL
