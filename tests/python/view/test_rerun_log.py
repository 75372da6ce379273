"""A run is logged to rerun; a stand-in records what the library is given, where it is absent."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

import gsut
import small_run
from gsut.data.poses import invert_pose
from gsut.view.rerun_log import describe_splats
from random_scenes import gaussians_in_view, pinhole, rng_of

SCENE_VIEWS = (0, 3)  # that small_run holds out


@pytest.fixture
def run(tmp_path):
    scene = small_run.scene_from_arrays(tmp_path / "data")
    gsut.save_dataset(
        tmp_path / "set", [scene.image(i) for i in range(len(scene))], scene.cameras[0],
        np.array([view.camera_from_world for view in scene.views]),
        points=np.random.default_rng(1).uniform(-1, 1, (300, 3)),
        test_names=["000000.png", "000003.png"],
    )  # fmt: skip
    data = gsut.load_dataset(tmp_path / "set")
    options = gsut.TrainOptions(steps=5, preset="fast")
    gsut.train(data, options, out=tmp_path / "run", progress=False)
    return tmp_path / "run"


class StandIn(SimpleNamespace):
    """The names of rerun that are used; `logged` keeps (path, kind, arguments)."""

    def __init__(self):
        super().__init__(logged=[], times=[], ViewCoordinates=self)
        for kind in ("GaussianSplats3D", "Points3D", "Transform3D", "LineStrips3D", "Image",
                     "Scalars"):  # fmt: skip
            setattr(self, kind, lambda *args, kind=kind, **named: (kind, args, named))

    def __getattr__(self, name):
        assert name.startswith("RIGHT_HAND_"), name
        return ("ViewCoordinates", (name,), {})

    def RecordingStream(self, application):
        return SimpleNamespace(save=lambda file: None, flush=lambda: None)

    def log(self, path, what, static=False, recording=None):
        self.logged.append((path, *what))

    def set_time(self, line, *, sequence, recording=None):
        self.times.append((line, sequence))


def test_run_is_logged_with_poses_rays_and_pictures(run, monkeypatch):
    rerun = StandIn()
    monkeypatch.setitem(sys.modules, "rerun", rerun)
    gsut.to_rerun(run, run / "run.rrd")
    paths = [path for path, *_ in rerun.logged]
    assert paths[:3] == ["world", "world/gaussians", "world/points"]
    views = [sequence for line, sequence in rerun.times if line == "view"]
    assert views == list(SCENE_VIEWS)
    scene = gsut.load_run(run).scene
    poses = [named for path, _, _, named in rerun.logged if path == "world/camera"]
    for pose, index in zip(poses, views, strict=True):
        expected = invert_pose(scene.views[index].camera_from_world)
        np.testing.assert_array_equal(pose["translation"], expected[:3, 3])
    for name in ("photograph", "render"):
        pictures = [args[0] for path, _, args, _ in rerun.logged if path == name]
        assert [p.shape for p in pictures] == [scene.image(0).shape] * 2
        assert all(p.dtype == np.uint8 for p in pictures)
    rays = [args[0] for path, _, args, _ in rerun.logged if path == "world/camera/rays"]
    assert len(rays) == 2 and (rays[0][:, 1, 2] < 0).any()  # of a fisheye beyond 90 degrees


def test_values_of_splats_are_linear():
    gaussians = gaussians_in_view(rng_of("rerun"), pinhole(), np.eye(4), 20, sh_degree=1)
    found = describe_splats(gaussians)
    np.testing.assert_array_equal(found["scales"], np.exp(gaussians.log_scales))
    np.testing.assert_allclose(np.linalg.norm(found["quaternions"], axis=1), 1, rtol=1e-6)
    turned = gaussians.quats[:, 0] / np.linalg.norm(gaussians.quats, axis=1)
    np.testing.assert_allclose(found["quaternions"][:, 3], turned, rtol=1e-6)
    np.testing.assert_array_equal(found["centers"], gaussians.means)
    far = gaussians.translate([1000.0, 2000.0, 0.0])
    np.testing.assert_array_equal(
        describe_splats(far)["centers"], (far.means + far.origin).astype(np.float32)
    )
    assert far.origin[0] == 1000
    assert found["sh_coefficients"].shape == (20, 15, 3)
    assert not found["sh_coefficients"][:, 3:].any()


def test_without_rerun_the_cure_is_named(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(gsut.InputError, match="pip install rerun-sdk"):
        gsut.to_rerun(run)


def test_file_is_written_by_the_library_itself(run, tmp_path):
    pytest.importorskip("rerun", reason="needs rerun-sdk")
    gsut.to_rerun(run, tmp_path / "run.rrd")
    assert (tmp_path / "run.rrd").read_bytes()[:3] == b"RRF"
