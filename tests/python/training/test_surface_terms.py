"""`--surface`: its gradients, known distances, what it makes of a plane, and resumed runs."""

import dataclasses
import json

import cv2
import numpy as np
import pytest

import gsut
import small_datasets
import tolerances
from box_room import BoxRoom, plan_walk, write_box_room
from gsut import InputError, TrainOptions, _core
from gsut.data.scene import DISTANCES, DepthForm, read_depth
from gsut.rendering import measure_depth
from gsut.training.loop import TrainingLoop
from gsut.training.surface.known_depth import KnownDepth, check_maps
from gsut.training.surface.surface_terms import SurfaceTerms, SurfaceWeights
from random_scenes import relative_error
from surface_scenes import lines_of

FIELDS = ("means", "quats", "log_scales", "opacity_logits")
STEP = 1e-5


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return small_datasets.write_nerfstudio(tmp_path_factory.mktemp("surface") / "data")


@pytest.fixture
def scene(folder):
    return gsut.load_dataset(folder)


def true_distance(scene, view):
    """(H, W) along the rays to the plane z = 0."""
    origins, rays, _ = lines_of(scene.camera(view), scene.views[view].motion)
    return -origins[..., 2] / rays[..., 2]


def wavy_plane(rng, count=60):
    """Large flat Gaussians about z = 0."""
    means = np.c_[rng.uniform(-1.2, 1.2, (count, 2)), 0.05 * rng.normal(size=count)]
    quats = np.c_[np.ones(count), 0.1 * rng.normal(size=(count, 3))]
    scales = np.log(np.c_[rng.uniform(0.3, 0.5, (count, 2)), rng.uniform(0.02, 0.05, count)])
    return gsut.Gaussians(means, quats, scales, np.full(count, 0.5), np.zeros((count, 1, 3)))


def total(g, camera, pose, known, weights, extent):
    """The surface terms of the double reference."""
    center = list(-pose[:3, :3].T @ pose[:3, 3])
    sh = np.empty((len(g), 1, 3))
    _core.facing_axes(g, center, sh)
    colored = gsut.Gaussians(g.means, g.quats, g.log_scales, g.opacity_logits, sh)
    seen = gsut.render(colored, camera, pose, background=(0.5, 0.5, 0.5), dtype="float64")
    origins, rays, _ = lines_of(camera, pose)
    maps = {
        "directions": rays, "origins": np.ascontiguousarray(origins), "alpha": seen.alpha,
        "depth": seen.depth, "distortion": seen.distortion, "normals": seen.image, "known": known,
    }  # fmt: skip
    out = [np.zeros_like(maps[name]) for name in ("alpha", "depth", "distortion", "normals")]
    terms = _core.surface_loss(maps, (weights.normal, 0, weights.known, extent), *out)
    # The distortion's divisor is a constant: that of the Gaussians that are given.
    flat = weights.flatten / extent * np.exp(g.log_scales).min(axis=1).mean()
    return sum(terms) + flat, seen


def test_gradients_of_all_terms_equal_differences_of_the_double_reference(rng, scene):
    weights = SurfaceWeights(1.0, 2.0, 0.3, 0.5, start=0.0, size=1, every=1)
    exact, view = wavy_plane(rng), scene.train_indices[0]
    terms = SurfaceTerms(weights, scene)
    camera, pose = scene.camera(view), scene.views[view].motion
    known = terms.known.map(scene, view, camera).astype(np.float64)
    assert np.count_nonzero(known) > 100
    # From a tenth of the steps on all count fully; the known distances have faded a little.
    fraction = 0.2
    g = exact.to_dtype(np.float32)
    found = terms.compute_gradients(g, scene, view, _core.BlendRule(), fraction)
    assert all(term > 0 for term in terms.last_terms)
    faded = dataclasses.replace(weights, known=0.5 * 0.01**fraction)
    base, seen = total(exact, camera, pose, known, faded, scene.extent)
    mean = np.where(seen.alpha >= 0.5, seen.depth / np.maximum(seen.alpha, 1e-9), np.inf)
    share = faded.distortion / mean.size / (mean**2 + scene.extent**2)
    for name in FIELDS:
        array = getattr(exact, name)
        chosen = rng.permutation(array.size)[:16]
        numeric = []
        for index in chosen:
            kept, sides = array.flat[index], []
            for sign in (1, -1):
                array.flat[index] = kept + sign * STEP
                value, at = total(exact, camera, pose, known, faded, scene.extent)
                sides.append(value + np.sum(share * at.distortion))
            array.flat[index] = kept
            numeric.append((sides[0] - sides[1]) / (2 * STEP))
        error = relative_error(getattr(found, name).ravel()[chosen], np.array(numeric))
        assert error < tolerances.SURFACE_TERMS, (name, error)
    assert base > 0


def test_terms_of_every_fourth_step_count_four_times(rng, scene):
    view, g = scene.train_indices[0], wavy_plane(rng).to_dtype(np.float32)
    found = []
    for every in (1, 4):
        terms = SurfaceTerms(SurfaceWeights(every=every), scene)
        due = [step for step in range(1, 9) if terms.is_due(step, 0.5)]
        assert due == list(range(every, 9, every))
        assert not terms.is_due(4, terms.weights.start)
        found.append(terms.compute_gradients(g, scene, view, _core.BlendRule(), 0.5))
    for name in FIELDS:
        assert relative_error(getattr(found[1], name), 4 * getattr(found[0], name)) < 1e-5


def test_points_are_known_where_a_view_sees_them_and_not_behind_others(scene):
    view = scene.train_indices[0]
    below = scene.points - np.array([0, 0, 2.0])
    both = scene.replace(
        points=np.r_[below, scene.points],
        point_colors=np.r_[[scene.point_colors] * 2].reshape(-1, 3),
    )
    camera = scene.camera(view)
    known = KnownDepth(both).map(both, view, camera)
    truth = true_distance(scene, view)
    has = known > 0
    assert has.sum() > 150
    # The pixel's ray and the point's differ by half a pixel.
    error = np.abs(known / truth - 1)[has]
    assert np.median(error) < 0.01 and np.mean(error > 0.05) < 0.1
    half = camera.resize(24, 18)
    assert np.count_nonzero(KnownDepth(both).map(both, view, half)) > 80


def test_depth_files_are_known_at_any_size_and_damaged_ones_are_named(tmp_path):
    folder = small_datasets.write_nerfstudio(tmp_path / "data")
    values = json.loads((folder / "transforms.json").read_text())
    plain = gsut.load_dataset(folder)
    view = plain.train_indices[0]
    frame = next(f for f in values["frames"] if plain.views[view].name.endswith(f["file_path"]))
    frame["depth_file_path"] = "depth.png"
    truth = true_distance(plain, view)
    cv2.imwrite(str(folder / "depth.png"), np.round(truth * 1000).astype(np.uint16))
    (folder / "transforms.json").write_text(json.dumps(values))
    scene = gsut.load_dataset(folder)
    known = KnownDepth(scene)
    assert known.by_files
    camera = scene.camera(view)
    assert np.abs(known.map(scene, view, camera) - truth).max() < 1e-3
    assert known.map(scene, scene.train_indices[1], camera) is None
    half = known.map(scene, view, camera.resize(24, 18))
    assert np.all(half > 0)
    cv2.imwrite(str(folder / "metres.tif"), truth.astype(np.float32))
    assert np.abs(read_depth(scene, view, folder / "metres.tif") - truth).max() < 1e-5
    cv2.imwrite(str(folder / "shown.png"), np.round(truth * 20).astype(np.uint8))
    with pytest.raises(InputError, match=r"shown.png: no depth picture .* 16 bits"):
        read_depth(scene, view, folder / "shown.png")
    cv2.imwrite(str(folder / "depth.png"), np.ones((5, 4), np.uint16))
    with pytest.raises(InputError, match=r"depth.png is 4 x 5"):
        read_depth(scene, view)
    (folder / "depth.png").write_bytes(b"")
    with pytest.raises(InputError, match=r"depth.png"):
        read_depth(scene, view)


@pytest.mark.parametrize("strategy", ["mcmc", "mini"])
def test_surfels_stay_surfels(scene, strategy):
    options = TrainOptions(
        steps=60, max_gaussians=300, primitive="surfel", surface=strategy == "mcmc",
        strategy=strategy,
    )  # fmt: skip
    loop = TrainingLoop(scene, options)
    first = loop.gaussians.log_scales.copy()
    while loop.step < 60:
        loop.advance()
        assert loop.gaussians.are_surfels
    assert loop.make_result().are_surfels
    assert not np.isin(loop.gaussians.log_scales[:, :2], first).any()


def test_training_for_surfaces_flattens(scene):
    flatness = []
    for surface in (True, False):
        options = TrainOptions(steps=60, max_gaussians=300, surface=surface)
        loop = TrainingLoop(scene, options)
        while loop.step < 60:
            loop.advance()
        scales = np.sort(loop.gaussians.log_scales, axis=1)
        flatness.append(np.median(scales[:, 0] - scales[:, 1]))
    assert flatness[0] < flatness[1] - 0.05


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    camera = gsut.Camera("pinhole", [96, 96, 80, 60], 160, 120)
    return write_box_room(tmp_path_factory.mktemp("room") / "room", camera, plan_walk(10))


def load_with_depths(room, change, form=DISTANCES):
    """Loads the room with a depth file a view: what `change` makes of distances and cosines."""
    scene, views = gsut.load_dataset(room, test_every=0), []
    for number, (view, pose) in enumerate(zip(scene.views, plan_walk(10), strict=True)):
        distance = BoxRoom().measure_distances(scene.camera(0), pose)
        file = room / f"{number}.npy"
        np.save(file, change(distance, np.asarray(scene.camera(0).rays()[0])[..., 2]))
        views.append(dataclasses.replace(view, depth_path=file, depth_form=form))
    return scene.replace(views=tuple(views))


def test_plain_training_keeps_to_depth_files(room):
    scene, off = load_with_depths(room, lambda distance, cosine: distance), []
    for each in (scene, gsut.load_dataset(room, test_every=0)):
        loop = TrainingLoop(each, TrainOptions(steps=80, max_gaussians=1500, init="points"))
        assert (loop.surface is not None) == (each is scene)
        while loop.step < 80:
            loop.advance()
        view = scene.views[0]
        result = gsut.render(loop.make_result(), scene.camera(0), view.camera_from_world)
        off.append(np.nanmedian(np.abs(measure_depth(result, "mean") / read_depth(scene, 0) - 1)))
    assert off[0] < 0.9 * off[1], off


@pytest.mark.parametrize(
    ("change", "words", "cure"),
    [
        (lambda distance, cosine: distance, "", ""),
        (lambda distance, cosine: distance * cosine, "as z along the camera's axis", "depth_along"),
        (
            lambda distance, cosine: 1000 * distance,
            "as distances along the rays times 1e+03",
            "depth_unit",
        ),
        (
            lambda distance, cosine: 5 / distance,
            "as the inverse of distances times 5",
            "depth_unit",
        ),
        (
            lambda distance, cosine: np.exp(7 * np.random.default_rng(0).random(distance.shape)),
            "do not agree",
            "of these images",
        ),
    ],
)
def test_doctor_and_training_name_the_unit_of_depths(change, words, cure, room):
    scene = load_with_depths(room, change)
    said = [each.what for each in gsut.doctor(scene) if "depth files" in each.what]
    assert len(said) == (words != "") and words in "".join(said), said
    without_points = scene.replace(points=np.zeros((0, 3)), point_colors=np.zeros((0, 3), np.uint8))
    for each, others in ((scene, "the points"), (without_points, "the matches")):
        if not words:
            check_maps(each)
            continue
        with pytest.raises(InputError, match=rf"depth files.*{others}.*poses' unit.*{cure}"):
            check_maps(each)


def test_depths_stated_as_z_are_read_as_z(room):
    check_maps(
        load_with_depths(room, lambda distance, cosine: distance * cosine, DepthForm(is_z=True))
    )
