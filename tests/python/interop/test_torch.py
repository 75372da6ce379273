"""gsut.torch: bits of `gsut.render_backward`, gradcheck in float64, gsplat's vectors and shapes."""

import dataclasses
import importlib
import inspect
import types
from pathlib import Path

import numpy as np
import pytest

import gsut
import tolerances
from random_scenes import fisheye, gaussians_in_view, random_pose, relative_error
from torch_or_skip import import_torch

torch = import_torch()
from gsut.torch import View, rasterization, render_view  # noqa: E402
from gsut.torch.arrays import to_array, to_tensor  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore:gsut evaluates Gaussians in 3D:RuntimeWarning")
SIZE = 40


def tensor(values, dtype=torch.float32, grad=False):
    out = to_tensor(np.array(values, np.float64)).to(dtype)
    return out.requires_grad_(grad)


def make_scene(rng, count=80, size=SIZE, dtype=torch.float32):
    """Means, quats, scales, opacities and harmonics with gradients, a fisheye, and its pose."""
    camera, pose = fisheye(size), random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, count, sh_degree=1)
    opacities = 1 / (1 + np.exp(-g.opacity_logits))
    arrays = (g.means, g.quats, np.exp(g.log_scales), opacities, g.sh)
    return [tensor(array, dtype, True) for array in arrays], camera, tensor(pose, dtype, True)


def make_matrix(camera, dtype=torch.float32):
    fx, fy, cx, cy = camera.params[:4]
    return tensor([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype, True)


@pytest.mark.parametrize("rolling", [False, True], ids=["still", "rolling"])
def test_a_view_has_the_bits_of_render_and_render_backward(rng, rolling):
    leaves, camera, pose = make_scene(rng)
    features = tensor(rng.normal(size=(80, 5)), grad=True)
    lens = tensor(camera.params, torch.float64, True)
    motion = end = None
    if rolling:
        end = gsut.exp_pose(np.full(6, 0.02)) @ to_array(pose, "pose").astype(np.float64)
        start = to_array(pose, "pose").astype(np.float64)
        motion = gsut.CameraMotion(start, end, gsut.Shutter("top_to_bottom"))
        end = tensor(end, torch.float64, True)
    view = View(
        camera.model, SIZE, SIZE, shutter=gsut.Shutter("top_to_bottom") if rolling else None,
        valid_field_angle=camera.valid_field_angle,
    )  # fmt: skip
    found = render_view(
        view, *leaves[:4], pose, lens, sh=leaves[4], features=features, pose_end=end
    )
    arrays = [to_array(leaf, "leaf") for leaf in leaves]
    values = to_array(features, "features")
    place = to_array(pose, "pose").astype(np.float64) if motion is None else motion
    plain = gsut.render(gsut.LinearGaussians(*arrays), camera, place, features=values)
    images = (plain.image, plain.alpha, plain.depth, plain.features)
    for image, expected in zip(found, images, strict=True):
        assert np.array_equal(to_array(image, "image"), expected)
    weights = [rng.normal(size=image.shape).astype(np.float32) for image in images]
    sum((a * tensor(w)).sum() for a, w in zip(found, weights, strict=True)).backward()
    slopes = gsut.render_backward(plain, *weights[:3], dfeatures=weights[3], with_lens=True)
    for leaf, field in zip(leaves, dataclasses.fields(slopes.gaussians), strict=True):
        expected = getattr(slopes.gaussians, field.name)
        assert np.array_equal(to_array(leaf.grad, "grad"), expected), field.name
    assert np.array_equal(to_array(features.grad, "grad"), slopes.features)
    assert np.array_equal(to_array(lens.grad, "grad"), slopes.lens)
    assert pose.grad.abs().sum() > 0
    assert not rolling or end.grad.abs().sum() > 0


def turn(xi, pose):
    """exp(xi) pose, differentiable in xi = (v, w)."""
    v, w = xi[:3], xi[3:]
    zero = torch.zeros((), dtype=xi.dtype)
    generator = torch.stack([
        torch.stack([zero, -w[2], w[1], v[0]]), torch.stack([w[2], zero, -w[0], v[1]]),
        torch.stack([-w[1], w[0], zero, v[2]]), torch.stack([zero, zero, zero, zero]),
    ])  # fmt: skip
    return torch.matrix_exp(generator) @ pose


@pytest.mark.parametrize("mode", ["RGB", "RGB+ED"])
def test_gradcheck_in_double_passes_for_scene_pose_matrix_and_coefficients(mode):
    rng = np.random.default_rng(5)
    dtype = torch.float64
    count = 3
    means = tensor(rng.uniform(-0.4, 0.4, (count, 3)) + np.array([0, 0, 3]), dtype, True)
    quats = tensor(rng.normal(size=(count, 4)), dtype, True)
    scales = tensor(rng.uniform(0.8, 1.2, (count, 3)), dtype, True)
    opacities = tensor(rng.uniform(0.3, 0.7, count), dtype, True)
    colors = tensor(rng.normal(size=(count, 4)), dtype, True)
    xi = tensor(rng.normal(size=6) * 0.02, dtype, True)
    matrix = tensor([6.0, 6.5, 3.0, 2.5], dtype, True)
    radial = tensor([0.02, -0.01, 0.003, 0.001], dtype, True)

    def draw(means, quats, scales, opacities, colors, xi, matrix, radial):
        fx, fy, cx, cy = matrix
        zero, one = torch.zeros((), dtype=dtype), torch.ones((), dtype=dtype)
        k = torch.stack([fx, zero, cx, zero, fy, cy, zero, zero, one]).reshape(1, 3, 3)
        image, alpha, _ = rasterization(
            means, quats, scales, opacities, colors, turn(xi, torch.eye(4, dtype=dtype))[None], k,
            6, 5, render_mode=mode, camera_model="fisheye", radial_coeffs=radial[None],
            packed=False, backgrounds=torch.full((1, 4), 0.3, dtype=dtype),
        )  # fmt: skip
        return image, alpha

    leaves = (means, quats, scales, opacities, colors, xi, matrix, radial)
    assert torch.autograd.gradcheck(draw, leaves, eps=1e-6, atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("name", ["pinhole", "fisheye", "opencv12", "opencv12_rs_ttb"])
def test_oracle_vectors_images_and_gradients_of_everything_match(shared, name):
    v = dict(np.load(shared / "oracle" / f"{name}.npz"))
    dtype = torch.float64
    names = ("means", "quats", "scales", "opacities", "colors", "K")
    leaves = {key: tensor(v[key], dtype, True) for key in names}
    lens = {
        key: tensor(v[key][None], dtype, True)
        for key in ("radial", "tangential", "thin_prism")
        if not name.startswith("pinhole") and (key == "radial" or name.startswith("opencv"))
    }
    rolling = name.endswith("rs_ttb")
    twists = {"xi": "viewmat", **({"xi_end": "viewmat_end"} if rolling else {})}
    xi = {key: torch.zeros(6, dtype=dtype, requires_grad=True) for key in twists}
    poses = [turn(xi[key], tensor(v[of], dtype))[None] for key, of in twists.items()]
    scene = [leaves[key] for key in ("means", "quats", "scales", "opacities", "colors")]
    image, alpha, _ = rasterization(
        *scene, poses[0], leaves["K"][None], int(v["width"]), int(v["height"]),
        near_plane=-np.inf, far_plane=np.inf, packed=False, with_ut=True, with_eval3d=True,
        camera_model="fisheye" if name == "fisheye" else "pinhole", render_mode="RGB-d",
        **{f"{key}_coeffs": value for key, value in lens.items()},
        **({"rolling_shutter": 0, "viewmats_rs": poses[1]} if rolling else {}),
    )  # fmt: skip
    limit = tolerances.ORACLE_SLERP_IMAGE if rolling else tolerances.ORACLE_IMAGE
    found = {"rgb": image[0, ..., :3], "alpha": alpha[0, ..., 0], "depth": image[0, ..., 3]}
    for key, values in found.items():
        assert np.abs(to_array(values, key) - v[f"all_{key}"]).max() < limit, key
    sum((values * tensor(v[f"w_{key}"], dtype)).sum() for key, values in found.items()).backward()
    limit = tolerances.ORACLE_SLERP_GRADIENT if rolling else tolerances.ORACLE_GRADIENT
    for key, leaf in {**leaves, **lens, **xi}.items():
        expected = v[f"all_grad_{key}"]
        error = relative_error(to_array(leaf.grad, key).reshape(expected.shape), expected)
        assert error < limit, (key, error)


def test_modes_backgrounds_masks_and_batches_are_as_in_gsplat(rng):
    (means, quats, scales, opacities, sh), camera, pose = make_scene(rng)
    poses = torch.stack([pose, turn(torch.full((6,), 0.02), pose)])
    matrix = make_matrix(camera)[None].expand(2, 3, 3)
    scene = (means, quats, scales, opacities)
    colors = torch.rand(2, 80, 4)

    def draw(colors=colors, **options):
        return rasterization(
            *scene, colors, poses, matrix, SIZE, SIZE, camera_model="fisheye", **options
        )

    image, alpha, info = draw(packed=False)
    assert image.shape == (2, SIZE, SIZE, 4) and alpha.shape == (2, SIZE, SIZE, 1)
    both, _, _ = draw(render_mode="RGB+D")
    depths, _, _ = draw(render_mode="D")
    expected, _, _ = draw(render_mode="ED")
    assert torch.equal(both[..., :4], image) and torch.equal(both[..., 4:], depths)
    assert torch.equal(expected, depths / alpha.clamp(min=1e-10))
    behind = torch.rand(2, 4)
    over, _, _ = draw(backgrounds=behind)
    assert torch.allclose(over, image + (1 - alpha) * behind[:, None, None])
    masks = torch.ones(2, 3, 3, dtype=torch.bool)
    masks[0, 0, 1] = False
    masked, covered, _ = draw(backgrounds=behind, masks=masks)
    assert torch.equal(masked[1], over[1]) and torch.equal(masked[0, 16:], over[0, 16:])
    assert torch.equal(masked[0, :16, 16:32], behind[0].expand(16, 16, 4))
    assert covered[0, :16, 16:32].max() == 0
    lit, _, _ = draw(sh, sh_degree=1)
    assert lit.shape == (2, SIZE, SIZE, 3) and lit.max() > 0.1
    batch = [t[None].expand(2, *t.shape) for t in scene]
    many, _, _ = rasterization(
        *batch, colors[0][None].expand(2, 80, 4), poses[None].expand(2, 2, 4, 4),
        matrix[None].expand(2, 2, 3, 3), SIZE, SIZE, camera_model="fisheye",
    )  # fmt: skip
    assert many.shape == (2, 2, SIZE, SIZE, 4)
    assert torch.equal(many[1, 0], image[0])
    assert info["radii"].shape == (2, 80, 2) and info["means2d"].shape == (2, 80, 2)


@pytest.mark.parametrize("packed", [False, True])
def test_info_has_what_strategies_read_and_means2d_gets_the_gradient_in_pixels(rng, packed):
    (means, quats, scales, opacities, sh), camera, pose = make_scene(rng)
    image, _, info = rasterization(
        means, quats, scales, opacities, sh, pose[None], make_matrix(camera)[None], SIZE, SIZE,
        sh_degree=1, camera_model="fisheye", packed=packed, api="1.5",
    )  # fmt: skip
    info["means2d"].retain_grad()
    (image * tensor(rng.normal(size=image.shape))).sum().backward()
    assert info["n_cameras"] == 1 and info["width"] == SIZE
    slopes = info["means2d"].grad
    if packed:
        slopes = torch.zeros(80, 2).index_add(0, info["gaussian_ids"], slopes)
        assert (info["radii"] > 0).all() and len(info["radii"]) == len(info["gaussian_ids"])
        assert info["conics"].shape == (len(info["radii"]), 3)
    else:
        slopes = slopes[0]
    seen = info["gaussian_ids"] if packed else torch.where((info["radii"][0] > 0).all(-1))[0]
    place = to_array(pose, "pose").astype(np.float64)
    points = to_array(means, "means") @ place[:3, :3].T + place[:3, 3]
    jacobian, _ = camera.project_jacobian(points)
    back = np.einsum("nij,ni->nj", jacobian, to_array(slopes, "slopes")) @ place[:3, :3]
    to_means = to_array(means.grad, "grad")
    rays = points @ place[:3, :3] / np.linalg.norm(points, axis=1)[:, None]
    across = to_means - rays * np.sum(rays * to_means, axis=1)[:, None]
    rows = np.array(seen.tolist())
    assert len(rows) > 20
    assert relative_error(back[rows], across[rows]) < tolerances.RENDER_GRADIENT


def test_any_lens_renders_and_its_parameters_get_gradients(rng):
    (means, quats, scales, opacities, sh), _, pose = make_scene(rng)
    for model in ("double_sphere", "equirectangular", "ocam"):
        _, params, width, height = gsut._core.camera_examples(model)[0]
        camera = gsut.Camera(model, params, width, height).resize(48, round(48 * height / width))
        values = tensor(camera.params, torch.float64, len(camera.params) > 0)
        image, _, _ = rasterization(
            means, quats, scales, opacities, sh, pose[None], None, 48, camera.height, sh_degree=1,
            camera=camera, camera_params=values,
        )  # fmt: skip
        assert image.max() > 0.05, model
        image.sum().backward()
        assert len(camera.params) == 0 or values.grad.abs().sum() > 0


# gsplat 1.6's signature, an argument a line: how a value that is not the default is taken.
CHANGES_THE_IMAGE, CHANGES_NO_PIXEL = "changes the image", "changes no pixel"
SIGNATURE = {
    "means": CHANGES_THE_IMAGE,
    "quats": CHANGES_THE_IMAGE,
    "scales": CHANGES_THE_IMAGE,
    "opacities": CHANGES_THE_IMAGE,
    "colors": CHANGES_THE_IMAGE,
    "viewmats": CHANGES_THE_IMAGE,
    "Ks": CHANGES_THE_IMAGE,
    "width": CHANGES_THE_IMAGE,
    "height": CHANGES_THE_IMAGE,
    "near_plane": CHANGES_THE_IMAGE,
    "far_plane": CHANGES_THE_IMAGE,
    "radius_clip": CHANGES_THE_IMAGE,
    "eps2d": CHANGES_NO_PIXEL,
    "sh_degree": CHANGES_THE_IMAGE,
    "packed": CHANGES_NO_PIXEL,
    "tile_size": CHANGES_NO_PIXEL,
    "backgrounds": CHANGES_THE_IMAGE,
    "render_mode": CHANGES_THE_IMAGE,
    "sparse_grad": "gradients are dense",
    "absgrad": "means2d has no absolute gradient",
    "rasterize_mode": "antialiased belongs to the 2D kernels",
    "channel_chunk": CHANGES_NO_PIXEL,
    "distributed": "one process renders",
    "camera_model": CHANGES_THE_IMAGE,
    "segmented": CHANGES_NO_PIXEL,
    "covars": "rays meet Gaussians of quats and scales",
    "with_ut": CHANGES_NO_PIXEL,
    "with_eval3d": CHANGES_NO_PIXEL,
    "return_normals": CHANGES_NO_PIXEL,
    "global_z_order": CHANGES_THE_IMAGE,
    "rays": "rays are the lens'",
    "radial_coeffs": CHANGES_THE_IMAGE,
    "tangential_coeffs": CHANGES_THE_IMAGE,
    "thin_prism_coeffs": CHANGES_THE_IMAGE,
    "ftheta_coeffs": CHANGES_THE_IMAGE,
    "lidar_coeffs": "there is no spinning lidar",
    "external_distortion_coeffs": "there is no windshield",
    "rolling_shutter": CHANGES_THE_IMAGE,
    "viewmats_rs": CHANGES_THE_IMAGE,
    "ut_params": CHANGES_NO_PIXEL,
    "extra_signals": CHANGES_NO_PIXEL,
    "extra_signals_sh_degree": CHANGES_NO_PIXEL,
    "renderer_config": CHANGES_NO_PIXEL,
}
OURS = {"masks", "camera", "camera_params", "api"}


def make_values(rng):
    """A call of `rasterization`, and a second value of each argument with what it needs."""
    (means, quats, scales, opacities, sh), _, pose = make_scene(rng)
    matrix = tensor([[30, 0, 20], [0, 30, 20], [0, 0, 1]])[None]
    base = {
        "means": means, "quats": quats, "scales": scales, "opacities": opacities, "colors": sh,
        "viewmats": pose[None], "Ks": matrix, "width": SIZE, "height": SIZE, "sh_degree": 1,
    }  # fmt: skip
    end = turn(torch.full((6,), 0.05), pose)[None]
    polynomial = {
        "reference_poly": 1, "pixeldist_to_angle_poly": [0, 1 / 30, 0, 0, 0, 0],
        "angle_to_pixeldist_poly": [0, 30.0, 0, 0, 0, 0], "max_angle": 1.2,
        "linear_cde": [1, 0, 0],
    }  # fmt: skip
    second = {
        "means": means + 0.1, "quats": quats.flip(1), "scales": 0.7 * scales,
        "opacities": 0.5 * opacities, "colors": sh + 0.1, "viewmats": end, "Ks": 1.1 * matrix,
        "width": SIZE - 8, "height": SIZE - 8, "near_plane": 3.0, "far_plane": 2.0,
        "radius_clip": 4.0, "eps2d": 1.0, "sh_degree": 0, "packed": False, "tile_size": 8,
        "backgrounds": torch.ones(1, 3), "render_mode": "ED", "sparse_grad": True,
        "absgrad": True, "rasterize_mode": "antialiased", "channel_chunk": 2, "distributed": True,
        "camera_model": "ortho", "segmented": True, "covars": torch.ones(80, 6), "with_ut": True,
        "with_eval3d": True, "return_normals": True, "global_z_order": False,
        "rays": torch.ones(1, SIZE, SIZE, 6), "radial_coeffs": torch.full((1, 4), 0.1),
        "tangential_coeffs": torch.full((1, 2), 0.05), "thin_prism_coeffs": torch.full((1, 4), 0.1),
        "ftheta_coeffs": types.SimpleNamespace(**polynomial), "lidar_coeffs": object(),
        "external_distortion_coeffs": object(), "rolling_shutter": 1, "viewmats_rs": end,
        "ut_params": object(), "extra_signals": torch.rand(80, 2),
        "extra_signals_sh_degree": 1, "renderer_config": object(),
    }  # fmt: skip
    needs = {
        "ftheta_coeffs": {"camera_model": "ftheta"}, "rolling_shutter": {"viewmats_rs": end},
        "viewmats_rs": {"rolling_shutter": 0},
        "extra_signals_sh_degree": {"extra_signals": torch.rand(80, 4, 5)},
    }  # fmt: skip
    return base, second, needs


def test_every_argument_of_gsplat_is_supported_or_refused_by_name_and_reason(rng):
    assert set(inspect.signature(rasterization).parameters) == set(SIGNATURE) | OURS
    base, second, needs = make_values(rng)
    plain, _, _ = rasterization(**base)
    for name, effect in SIGNATURE.items():
        call = {**base, **needs.get(name, {}), name: second[name]}
        if effect not in (CHANGES_THE_IMAGE, CHANGES_NO_PIXEL):
            with pytest.raises(gsut.InputError, match=f"{name} is not supported .*: {effect}"):
                rasterization(**call)
        else:
            image, _, info = rasterization(**call)
            # other channels beside the colours are blended by other kernels: another last bit
            limit = tolerances.TORCH_SHADING
            is_same = image.shape == plain.shape and torch.allclose(image, plain, atol=limit)
            assert is_same == (effect == CHANGES_NO_PIXEL), name
            if name.startswith("extra_signals"):
                assert info["render_extra_signals"].shape[:3] == image.shape[:3], name


def test_words_that_are_not_known_are_refused(rng):
    base, _, _ = make_values(rng)
    cases = {
        "render_mode": ("median", 'render_mode "median" is not supported; known: RGB'),
        "camera_model": ("lidar", 'camera_model "lidar" is not supported; known: pinhole'),
        "api": ("2.0", 'api "2.0" is unknown'),
        "rolling_shutter": (7, "rolling_shutter 7 is unknown; known: 0 to 4"),
        "colors": (torch.ones(3, 80, 4, 3), r"colors has shape \(3, 80, 4, 3\), which fits no"),
        "extra_signals": (torch.ones(5), r"extra_signals has shape \(5,\), which fits no batch"),
    }
    for name, (value, message) in cases.items():
        with pytest.raises(gsut.InputError, match=message):
            rasterization(**{**base, name: value})
    with pytest.raises(gsut.InputError, match=r"colors is torch.int64: convert"):
        numbers = torch.ones(80, 3, dtype=torch.int64)
        rasterization(**{**base, "colors": numbers, "sh_degree": None})


def test_signals_normals_and_harmonics_of_other_widths_are_channels(rng):
    base, _, _ = make_values(rng)
    plain, alphas, _ = rasterization(**base)
    doubled = torch.cat([base["colors"], base["colors"]], -1)
    signals = torch.rand(80, 5)
    image, _, info = rasterization(
        **{**base, "colors": doubled}, extra_signals=signals, return_normals=True
    )
    assert image.shape[-1] == 6
    for half in (image[..., :3], image[..., 3:]):
        assert torch.allclose(half, plain, atol=tolerances.TORCH_SHADING)
    expected, _, _ = rasterization(**{**base, "colors": signals, "sh_degree": None})
    assert torch.equal(info["render_extra_signals"], expected)
    # Harmonics of signals stand about a half and are not clamped.
    low = torch.full((80, 4, 1), -10.0)
    _, _, info = rasterization(**base, extra_signals=low, extra_signals_sh_degree=0)
    level = -10 * 0.28209479177 + 0.5
    assert torch.allclose(info["render_extra_signals"], level * alphas, atol=1e-5)
    # Normals are unit vectors that face the camera.
    _, _, info = rasterization(**base, return_normals=True)
    normals, rays = info["normals"][0], tensor(gsut.Camera(
        "pinhole", [30, 30, 20, 20], SIZE, SIZE).rays()[0])  # fmt: skip
    towards = (normals * (rays @ base["viewmats"][0, :3, :3])).sum(-1)
    assert (normals.norm(dim=-1) <= alphas[0, ..., 0] + 1e-5).all()
    assert (towards[alphas[0, ..., 0] > 0.3] < 0).float().mean() > 0.9


def test_info_that_nobody_reads_costs_no_projection_and_no_gradient(rng, monkeypatch):
    base, _, _ = make_values(rng)
    calls = []
    module = importlib.import_module("gsut.torch.info")
    project = module.project_view
    monkeypatch.setattr(module, "project_view", lambda *a: calls.append(1) or project(*a))
    image, _, info = rasterization(**base, packed=False)
    image.sum().backward()
    assert calls == [] and info["means2d"].grad is None and calls == [1]
    assert "radii" in info and info["width"] == SIZE and len(dict(info)) == len(info)
    # What is read after an optimizer's step is what was rendered.
    image, _, info = rasterization(**base, packed=False)
    _, _, other = rasterization(**base, packed=False)
    expected = other["depths"].clone()
    with torch.no_grad():
        base["means"] += 1.0
    assert torch.equal(info["depths"], expected)


def test_code_of_the_page_runs(capsys):
    page = (Path(__file__).parents[3] / "docs" / "torch.md").read_text("utf-8")
    blocks = page.split("```python\n")[1:]
    torch.manual_seed(0)
    for block in blocks:
        exec(block.split("```")[0], {})
    assert len(blocks) == 1
    assert "torch.Size([1, 500, 2])" in capsys.readouterr().out


def test_tensor_changed_in_place_before_backward_is_noticed():
    scales = torch.full((3, 3), 0.1)
    means = torch.tensor([[0.0, 0.0, 2.0]] * 3, requires_grad=True)
    quats, opacities, colors = torch.rand(3, 4), torch.full((3,), 0.5), torch.rand(3, 3)
    matrix = torch.tensor([[[20.0, 0, 8], [0, 20.0, 8], [0, 0, 1]]])
    image, _, _ = rasterization(
        means, quats, scales, opacities, colors, torch.eye(4)[None], matrix, 16, 16,
        with_ut=True, with_eval3d=True, packed=False,
    )  # fmt: skip
    scales.mul_(2.0)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        image.sum().backward()


def test_cameras_without_their_dimension_and_lists_of_tiles_are_refused_by_a_sentence(rng):
    base, _, _ = make_values(rng)
    _, _, info = rasterization(**base, packed=False)
    for name in ("isect_ids", "isect_offsets", "flatten_ids", "tiles_per_gauss"):
        assert info.get(name) is None
        with pytest.raises(KeyError, match="keeps no such list"):
            info[name]
    for name, words in (("viewmats", r"viewmats\[None\]"), ("Ks", r"Ks\[None\]")):
        with pytest.raises(gsut.InputError, match=words):
            rasterization(**base | {name: base[name][0]}, packed=False)
    skewed = base["Ks"].clone()
    skewed[..., 0, 1] = 0.1
    with pytest.raises(gsut.InputError, match="for gradcheck make Ks of fx, fy, cx and cy"):
        rasterization(**base | {"Ks": skewed}, packed=False)
