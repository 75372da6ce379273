"""Python threads may share every object of the API: the same bits as one after the other, or a
sentence. `lab/run sanitize thread` runs this, too."""

import dataclasses
import functools
import importlib
import inspect
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import gsut
import rendered_dataset
from public_names import list_public_names
from random_scenes import fisheye, gaussians_in_view, rng_of

pytestmark = pytest.mark.threads
THREADS, ROUNDS = 8, 3
POSE = np.eye(4)


def in_threads(function, items):
    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(function, items))


def bits(value):
    """What two answers have in common where they are the same."""
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if isinstance(value, gsut.Camera):
        return value.model, value.width, tuple(value.params)
    if isinstance(value, gsut.Render):
        return bits(value.image), bits(value.alpha), bits(value.depth)
    if dataclasses.is_dataclass(value):
        return tuple(bits(getattr(value, field.name)) for field in dataclasses.fields(value))
    return tuple(bits(each) for each in value) if isinstance(value, tuple | list) else repr(value)


@functools.cache
def blobs():
    return gaussians_in_view(rng_of("threads"), fisheye(), POSE, 200, sh_degree=1)


def weights(number):
    """(48, 48, 3) a gradient to an image."""
    return np.random.default_rng(number).normal(size=(48, 48, 3)).astype(np.float32)


def image(number=0):
    return np.clip(0.5 + 0.2 * weights(number), 0, 1)


def moved(x):
    pose = np.eye(4)
    pose[0, 3] = x
    return pose


def rolling():
    return gsut.CameraMotion(POSE, moved(0.1), gsut.Shutter("top_to_bottom"))


def tetrahedra():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    return gsut.Mesh(np.concatenate([corners, corners + 5]), np.concatenate([faces, faces + 4]))


RAYS = np.random.default_rng(1).normal(size=(500, 3))
PIXELS = np.random.default_rng(2).uniform(0, 48, (500, 2))


def blocks(folder):
    gsut.formats.save_ply(folder / "blocks.ply", blobs())
    return gsut.BlocksResult(folder / "blocks.ply", {}, None, None)


def lifted():
    features = np.random.default_rng(3).uniform(size=(len(blobs()), 2)).astype(np.float32)
    return gsut.rendering.Lifted(features, blobs().means[:, 2].copy(), np.array([4, 7], np.int32))


def confidence():
    sums = np.random.default_rng(4).uniform(1, 2, (3, len(blobs()))).astype(np.float32)
    return gsut.rendering.Confidence.from_sums(blobs(), *sums)


def take_sigmas(sure, pose):
    found = gsut.render(blobs(), fisheye(), pose, confidence=sure)
    return bits((found.color_sigma, found.depth_sigma, found.seen_views))


# Of each class with methods: how to make one, and what threads ask of it.
SHARED = {
    "Scene": (
        lambda folder: gsut.load_dataset(folder),
        [lambda scene, i=i: (scene.image(i), scene.mask(i), scene.extent) for i in range(6)]
        + [lambda scene: scene.scale_images(0.5).image(1), lambda scene: scene.poses([0, 1]),
           lambda scene: scene.centred.image(2), lambda scene: scene.centred.points],
    ),
    "Camera": (
        lambda _: fisheye(),
        [lambda camera: camera.rays(), lambda camera: camera.origins(),
         lambda camera: camera.project(RAYS), lambda camera: camera.unproject(PIXELS),
         lambda camera: camera.project_jacobian(RAYS), lambda camera: camera.resize(24, 24),
         lambda camera: camera.valid_field_angle,
         lambda camera: gsut.render(blobs(), camera, POSE)],
    ),
    "LensProfile": (
        lambda _: gsut.lens.find_lenses("gopro")[0],
        [lambda lens: lens.fov_degrees, lambda lens: lens.doubts,
         lambda lens: lens.make_camera(640, 480), lambda lens: lens.rate_size(640, 480)],
    ),
    "Conversion": (
        lambda _: gsut.lens.convert_camera(fisheye(), "opencv8", max_angle=0.5),
        [lambda found: found.format_rings()] * 6,
    ),
    "SceneOptions": (lambda _: gsut.SceneOptions(), [lambda o: o.list_words()]),
    "TrainOptions": (
        lambda _: gsut.TrainOptions(), [lambda o: o.to_json(), lambda o: o.recipe]),
    "BlockOptions": (
        lambda _: gsut.BlockOptions(blocks="4", memory="2GB"),
        [lambda o: (o.count(), o.parse_memory())],
    ),
    "BlocksResult": (blocks, [lambda result: result.gaussians] * 6),  # read when asked for
    "Gaussians": (
        lambda _: blobs().copy(),
        [lambda g, i=i: gsut.render(g, fisheye(), moved(0.05 * i)) for i in range(6)]
        + [lambda g: g.translate(np.ones(3)), lambda g: g.to_dtype(np.float64), lambda g: g.copy(),
           lambda g: gsut.project(g, fisheye(), POSE).centers,
           lambda g: gsut.compact(g, 0.5).gaussians],
    ),
    "PhotometricTarget": (
        lambda _: gsut.PhotometricTarget(image(), keep_statistics=True),
        [lambda target, i=i: gsut.photometric_loss(target, image(i)) for i in range(1, 6)]
        + [lambda target: target.value(image(7)), lambda target: target.light_sums(image(8))],
    ),
    "Render": (
        lambda _: gsut.render(blobs(), fisheye(), POSE),
        [lambda r, i=i: gsut.render_backward(r, weights(i)) for i in range(6)]
        + [lambda r: gsut.render_backward(r, weights(6), with_lens=True)]
        + [lambda r: gsut.render_surface(r)]
        + [lambda r: gsut.loop.render_surface_backward(r, weights(9))]
        + [lambda r: {k: v for k, v in r.get_statistics().items() if "time" not in k}]
        + [lambda r: gsut.render_backward(dataclasses.replace(r, sh_degree=0), weights(7))],
    ),
    "Shutter": (
        lambda _: gsut.Shutter("left_to_right"),
        [lambda shutter: shutter.line_times(48, 48), lambda shutter: shutter.direction],
    ),
    "CameraMotion": (
        lambda _: rolling(),
        [lambda motion: motion.at(0.3), lambda motion: (motion.start, motion.end),
         lambda motion: gsut.render(blobs(), fisheye(), motion)],
    ),
    "BlendRule": (
        lambda _: gsut.BlendRule("3dgrut"),
        [lambda rule: gsut.render(blobs(), fisheye(), POSE, blend=rule), lambda rule: rule.near_z],
    ),
    "Lifted": (
        lambda _: lifted(),
        [lambda found, i=i: found.render(blobs(), fisheye(), moved(0.05 * i)) for i in range(5)]
        + [lambda found: found.labels],
    ),
    "Confidence": (
        lambda _: confidence(),
        [lambda sure, i=i: take_sigmas(sure, moved(0.05 * i)) for i in range(5)]
        + [lambda sure: sure.describe()],
    ),
    "Verdict": (lambda _: gsut.Verdict("good", "a scene"), [str, lambda v: v.as_dict()]),
    "CaptureAlignment": (
        lambda _: gsut.poses.CaptureAlignment(
            2.0, np.eye(3), np.ones(3), 0.01, 0.1, 0.1, ("a",), ()
        ),
        [lambda found: found.apply(blobs()), lambda found: found.move_pose(np.eye(4))],
    ),
    "Mesh": (
        lambda _: tetrahedra(),
        [lambda mesh: mesh.compute_normals(), lambda mesh: mesh.compute_face_vectors(),
         lambda mesh: mesh.without_small_parts(0.5),
         lambda mesh: mesh.crop(np.zeros(3), np.ones(3))],
    ),
}  # fmt: skip
APART = {"GaussianOptimizer"}  # what changes with each call: below


def has_methods(kind):
    """Whether it is more than what it was made of."""
    members = [value for name, value in vars(kind).items() if not name.startswith("_")]
    calls = (staticmethod, classmethod, functools.cached_property)
    return kind.__module__ == "gsut._core" or any(
        inspect.isfunction(member) or isinstance(member, calls) for member in members
    )


def test_every_class_of_the_api_with_methods_is_here():
    public = list_public_names().items()
    classes = [getattr(importlib.import_module(m), name) for m, names in public for name in names]
    classes = [each for each in classes if inspect.isclass(each)]
    found = {c.__name__ for c in classes if not issubclass(c, Exception) and has_methods(c)}
    assert found == set(SHARED) | APART


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return rendered_dataset.write_dataset(tmp_path_factory.mktemp("threads"), rng_of("ds"))


@pytest.mark.parametrize("name", SHARED)
def test_eight_threads_share_an_object(name, folder):
    make, calls = SHARED[name]
    alone = make(folder)
    expected = [bits(call(alone)) for call in calls]
    shared = make(folder)  # nothing has been asked of it yet
    found = in_threads(lambda call: bits(call(shared)), calls * ROUNDS)
    assert len(found) == ROUNDS * len(calls)
    assert found == expected * ROUNDS


def test_a_loss_is_of_the_light_before_or_after_another_threads_change():
    target = gsut.PhotometricTarget(image(), keep_statistics=True)
    lights = [(1.0, 1.0, 1.0), (0.5, 0.8, 1.25)]
    expected = set()
    for light in lights:
        target.set_light(light)
        expected.add(target.value(image(1)))
    assert len(expected) == 2

    def use(number):
        if number % 3 == 0:
            target.set_light(lights[number % 2])
        return target.value(image(1))

    assert set(in_threads(use, range(8 * THREADS))) <= expected


def test_an_optimizer_that_a_thread_is_at_refuses_the_others():
    gaussians = gaussians_in_view(rng_of("steps"), fisheye(), POSE, 30_000, sh_degree=2)
    rates = gsut.loop.LearningRates(1e-3, 1e-3, 1e-3, 1e-2, 1e-2, 1e-3)
    shared, alone = gsut.GaussianOptimizer(gaussians), gsut.GaussianOptimizer(gaussians)

    def step(_):
        try:
            shared.step(gaussians, rates)
        except gsut.InputError as error:
            assert "another thread" in str(error)
            return False
        return True

    done = sum(in_threads(step, range(4 * THREADS)))
    assert 1 <= done == shared.steps
    for _ in range(done):
        alone.step(gaussians, rates)
    expected = alone.state_dict()
    for name, array in shared.state_dict().items():
        np.testing.assert_array_equal(array, expected[name])
