"""gsplat's 3DGUT vectors: image, depth, gradients and projection of the double reference."""

import numpy as np
import pytest

import gsut
import tolerances
from random_scenes import relative_error
from ray_model import rotations

# With the shared data absent, test_raster.py and test_projection.py cover the same ground with
# vectors of this project's own.
CASES = ("pinhole", "fisheye", "opencv12")
MODELS = {"pinhole": "pinhole", "fisheye": "kannala_brandt", "opencv12": "opencv12"}
# alpha, beta, kappa of the sets of projection vectors.
UNSCENTED = {"a1": (1.0, 2.0, 0.0), "a0.1": (0.1, 2.0, 0.0)}
# Gaussians of 200 that can be compared in the projection: all seven sigma points in front of the
# camera, and inside gsplat's own domain of the lens (see `comparable`).
COMPARABLE = {
    ("pinhole", "a1"): 200,
    ("pinhole", "a0.1"): 200,
    ("fisheye", "a1"): 197,
    ("fisheye", "a0.1"): 200,
    ("opencv12", "a1"): 200,
    ("opencv12", "a0.1"): 200,
}


class Oracle:
    """One file of vectors, in gsut's terms."""

    def __init__(self, path):
        self.vectors = dict(np.load(path))
        v = self.vectors
        self.name = path.stem
        k = v["K"]
        params = [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]
        if self.name == "fisheye":
            params += list(v["radial"])
        if self.name == "opencv12":
            r, p, s = v["radial"], v["tangential"], v["thin_prism"]
            params += [r[0], r[1], p[0], p[1], r[2], r[3], r[4], r[5], *s]
        self.camera = gsut.Camera(MODELS[self.name], params, int(v["width"]), int(v["height"]))
        self.pose = v["viewmat"]
        self.gaussians = gsut.Gaussians(
            v["means"],
            v["quats"],
            np.log(v["scales"]),
            np.log(v["opacities"] / (1 - v["opacities"])),
            ((v["colors"] - 0.5) / SH0)[:, None, :],
        )
        # The `all_*` vectors have no near cut: every Gaussian is offered to every pixel.
        self.rule = gsut.BlendRule("gsplat")
        self.rule.near_z, self.rule.far_z = -np.inf, np.inf

    def __getitem__(self, name):
        return self.vectors[name]


SH0 = 0.5 / np.sqrt(np.pi)  # harmonic of degree 0


@pytest.fixture(scope="module", params=CASES)
def oracle(request, shared):
    """The vectors of one lens."""
    return Oracle(shared / "oracle" / f"{request.param}.npz")


def render(oracle):
    return gsut.render(
        oracle.gaussians, oracle.camera, oracle.pose, blend=oracle.rule, dtype="float64"
    )


def test_rays_of_the_camera_match_the_vectors(oracle):
    rays, valid = oracle.camera.rays()
    assert valid.all()
    world = rays.reshape(-1, 3) @ oracle.pose[:3, :3]
    assert np.abs(world - oracle["rays"][:, 3:]).max() < tolerances.ORACLE_RAY


def test_render_double_matches_image_alpha_and_depth(oracle):
    result = render(oracle)
    assert (oracle["all_nsamples"] > 0).sum() > 1000
    assert np.abs(result.image - oracle["all_rgb"]).max() < tolerances.ORACLE_IMAGE
    assert np.abs(result.alpha - oracle["all_alpha"]).max() < tolerances.ORACLE_IMAGE
    assert np.abs(result.depth - oracle["all_depth"]).max() < tolerances.ORACLE_IMAGE


def test_render_backward_double_matches_gradients(oracle):
    result = render(oracle)
    found = gsut.render_backward(result, oracle["w_rgb"], oracle["w_alpha"], oracle["w_depth"])
    opacities = oracle["opacities"]
    expected = {
        "means": (found.gaussians.means, oracle["all_grad_means"]),
        "quats": (found.gaussians.quats, oracle["all_grad_quats"]),
        "scales": (found.gaussians.log_scales, oracle["all_grad_scales"] * oracle["scales"]),
        "opacities": (
            found.gaussians.opacity_logits,
            oracle["all_grad_opacities"] * opacities * (1 - opacities),
        ),
        "colors": (found.gaussians.sh[:, 0], oracle["all_grad_colors"] * SH0),
        "xi": (found.pose, oracle["all_grad_xi"]),
    }
    errors = {name: relative_error(*pair) for name, pair in expected.items()}
    assert len(errors) == 6
    assert max(errors.values()) < tolerances.ORACLE_GRADIENT, errors


def comparable(oracle, spread):
    """Gaussians whose seven sigma points gsplat projects as gsut does.

    gsplat clamps a fisheye point beyond its max_angle (the angle of the farthest image corner, or
    the polynomial's first extremum) to that angle before it evaluates the polynomial, and projects
    a pinhole point behind the camera to (0, 0); it averages these in. gsut never does: such
    Gaussians have no ellipse (valid is False, or the angle lies between the two limits).
    """
    v = oracle.vectors
    in_camera = v["means"] @ oracle.pose[:3, :3].T + oracle.pose[:3, 3]
    steps = spread * (oracle.pose[:3, :3] @ rotations(v["quats"])) * v["scales"][:, None, :]
    points = np.concatenate(
        [in_camera[:, None], in_camera[:, None] + steps.transpose(0, 2, 1),
         in_camera[:, None] - steps.transpose(0, 2, 1)], axis=1,
    )  # fmt: skip
    _, valid = oracle.camera.project(points.reshape(-1, 3))
    inside = valid.reshape(-1, 7).all(axis=1)
    if oracle.name == "fisheye":
        k, size = v["K"], (int(v["width"]), int(v["height"]))
        corners = np.array([[a * size[0], b * size[1]] for a in (0, 1) for b in (0, 1)])
        limit = np.linalg.norm((corners - k[:2, 2]) / k[[0, 1], [0, 1]], axis=1).max()
        angle = np.arctan2(np.linalg.norm(points[..., :2], axis=2), points[..., 2])
        inside &= (angle < min(limit, oracle.camera.max_angle)).all(axis=1)
    return inside


@pytest.mark.parametrize("tag", UNSCENTED)
def test_project_double_matches_raw_means_and_covariances(oracle, tag):
    found = gsut.project(
        oracle.gaussians, oracle.camera, oracle.pose, unscented=UNSCENTED[tag], dtype="float64"
    )
    rows = comparable(oracle, UNSCENTED[tag][0] * np.sqrt(3))
    assert rows.sum() == COMPARABLE[oracle.name, tag]
    assert found.valid[rows].all()
    centers = found.centers[rows] - oracle[f"proj_{tag}_raw_means2d"][rows]
    expected = oracle[f"proj_{tag}_raw_cov2d_noblur"][rows]
    size = np.maximum(1.0, np.abs(expected).max(axis=(1, 2)))[:, None, None]
    print(np.abs(centers).max(), (np.abs(found.covariances[rows] - expected) / size).max())
    assert np.abs(centers).max() < tolerances.ORACLE_PROJECTION
    assert (np.abs(found.covariances[rows] - expected) / size).max() < tolerances.ORACLE_PROJECTION


def test_lens_and_ray_gradients_double_match(oracle):
    found = gsut.render_backward(
        render(oracle), oracle["w_rgb"], oracle["w_alpha"], oracle["w_depth"], with_lens=True
    )
    k = oracle["all_grad_K"][0]
    expected = [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]
    if oracle.name == "fisheye":
        expected += list(oracle["all_grad_radial"][0])
    if oracle.name == "opencv12":
        r, p, s = (oracle[f"all_grad_{name}"][0] for name in ("radial", "tangential", "thin_prism"))
        expected += [r[0], r[1], p[0], p[1], r[2], r[3], r[4], r[5], *s]
    assert len(expected) == len(oracle.camera.params)
    assert relative_error(found.lens, np.array(expected)) < tolerances.ORACLE_LENS_GRADIENT
    # gsplat takes a direction as three free numbers: only what is across the ray can be compared.
    directions = oracle["rays"][:, 3:]
    to_rays = oracle["all_grad_rays"][0, :, 3:]
    to_rays = to_rays - directions * (to_rays * directions).sum(axis=1, keepdims=True)
    in_world = found.rays.reshape(-1, 3) @ oracle.pose[:3, :3]
    assert relative_error(in_world, to_rays) < tolerances.ORACLE_LENS_GRADIENT
