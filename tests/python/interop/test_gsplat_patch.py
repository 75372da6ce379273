"""patch_gsplat: gsplat's functions are ours, by a stand-in of its modules and by gsplat itself."""

import importlib
import math
import runpy
import sys
import types
import warnings

import numpy as np
import pytest

import gsut
import tolerances
from random_scenes import fisheye, gaussians_in_view, random_pose, relative_error
from torch_or_skip import import_torch

torch = import_torch()
from gsut.torch import patch_gsplat, rasterization  # noqa: E402
from gsut.torch.arrays import to_array, to_tensor  # noqa: E402
from gsut.torch.functions import (  # noqa: E402
    compute_relocation,
    make_covariances,
    project_cameras,
)
from gsut.torch.harmonics import evaluate_harmonics, evaluate_view_harmonics  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore:gsut evaluates Gaussians in 3D:RuntimeWarning")
SIZE = 32
# Where gsplat keeps each of its functions, apart from cuda._wrapper or relocation.
PLACES = {
    "rasterization": ("gsplat", "gsplat.rendering"),
    "fully_fused_projection_with_ut": ("gsplat", "gsplat.cuda._wrapper", "gsplat.rendering"),
    "spherical_harmonics": ("gsplat", "gsplat.cuda._wrapper", "gsplat.rendering"),
    "quat_scale_to_covar_preci": ("gsplat", "gsplat.cuda._wrapper", "gsplat.strategy.ops"),
    "compute_relocation": ("gsplat.relocation", "gsplat.strategy.ops"),
}


def tensor(values, dtype=torch.float32):
    return to_tensor(np.array(values, np.float64)).to(dtype)


def array(values):
    return to_array(values, "values")


def make_stand_in(version):
    """gsplat's modules and the names of its functions, which do nothing."""
    modules = {}
    for name in ("gsplat.strategy", "gsplat.cuda", *sum(PLACES.values(), ())):
        modules[name] = types.ModuleType(name)
        modules[name].__path__ = []
    for function, places in PLACES.items():
        original = types.FunctionType((lambda: None).__code__, {}, function)
        for place in places:
            setattr(modules[place], function, original)
    modules["gsplat"].__version__ = version
    wrapper = modules["gsplat.cuda._wrapper"]
    wrapper._make_lazy_cuda_func = lambda name: None
    exec("def isect_tiles(*a): return _make_lazy_cuda_func('intersect_tile')(*a)", vars(wrapper))
    return modules


@pytest.fixture(params=["1.4.0", "1.5.3", "1.6.0"])
def stand_in(request, monkeypatch):
    modules = make_stand_in(request.param)
    for name in [n for n in sys.modules if n.split(".")[0] == "gsplat"]:
        monkeypatch.delitem(sys.modules, name)
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    return modules


def make_params(count=60, seed=1):
    """A scene before the camera as gsplat's scripts keep it, and the camera."""
    rng = np.random.default_rng(seed)
    camera, pose = fisheye(SIZE), random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, count, sh_degree=1)
    arrays = {
        "means": g.means, "quats": g.quats, "scales": g.log_scales,
        "opacities": g.opacity_logits, "sh": g.sh,
    }  # fmt: skip
    params = {name: torch.nn.Parameter(tensor(a)) for name, a in arrays.items()}
    fx, fy, cx, cy = camera.params[:4]
    matrix = tensor([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return torch.nn.ParameterDict(params), tensor(pose)[None], matrix[None]


def draw(function, params, poses, matrices, **options):
    return function(
        params["means"], params["quats"], torch.exp(params["scales"]),
        torch.sigmoid(params["opacities"]), params["sh"], poses, matrices, SIZE, SIZE,
        sh_degree=1, camera_model="fisheye", **options,
    )  # fmt: skip


def test_patch_replaces_every_name_and_undo_puts_them_back(stand_in):
    before = {name: dict(vars(module)) for name, module in stand_in.items()}
    version = stand_in["gsplat"].__version__[:3]
    with patch_gsplat():
        expected = {f"{place}.{name}" for name, places in PLACES.items() for place in places}
        found = {
            f"{name}.{key}" for name, module in stand_in.items() for key, value in
            vars(module).items() if value is not before[name].get(key)
        }  # fmt: skip
        assert found == expected | {"gsplat.cuda._wrapper._make_lazy_cuda_func"}
        harmonics = evaluate_view_harmonics if version == "1.6" else evaluate_harmonics
        assert stand_in["gsplat.rendering"].spherical_harmonics is harmonics
        image, _, info = draw(stand_in["gsplat"].rasterization, *make_params(), packed=False)
        assert image.shape == (1, SIZE, SIZE, 3) and image.max() > 0.05
        assert info["radii"].ndim == (2 if version == "1.4" else 3)
        with pytest.raises(gsut.InputError, match="gsplat's intersect_tile needs CUDA"):
            stand_in["gsplat.cuda._wrapper"].isect_tiles()
    assert {name: dict(vars(module)) for name, module in stand_in.items()} == before


def test_patch_without_gsplat_names_what_to_install(monkeypatch):
    for name in [n for n in sys.modules if n.split(".")[0] == "gsplat"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(gsut.InputError, match="pip install gsplat"):
        patch_gsplat()


def test_patch_of_a_folder_named_gsplat_says_where_it_is(monkeypatch, tmp_path):
    for name in [n for n in sys.modules if n.split(".")[0] == "gsplat"]:
        monkeypatch.delitem(sys.modules, name)
    (tmp_path / "gsplat").mkdir()
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    with pytest.raises(gsut.InputError, match="has no rasterization: a folder of that name"):
        patch_gsplat()
    del sys.modules["gsplat"]


def test_a_script_runs_with_gsplat_patched(stand_in, tmp_path, monkeypatch, capsys):
    script = tmp_path / "train.py"
    script.write_text(
        "import sys\nfrom gsplat import rasterization\nimport beside\n"
        "print(rasterization.__module__, sys.argv[1:], beside.WORD)\n"
    )
    (tmp_path / "beside.py").write_text("WORD = 'beside'\n")
    monkeypatch.setattr(sys, "argv", ["gsut.torch", str(script), "--steps", "3"])
    monkeypatch.setattr(sys, "path", list(sys.path))
    runpy.run_module("gsut.torch", run_name="__main__")
    assert "gsut.torch.rasterization ['--steps', '3'] beside" in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", ["gsut.torch", str(tmp_path / "absent.py")])
    with pytest.raises(SystemExit, match=r"absent\.py is not a file"):
        runpy.run_module("gsut.torch", run_name="__main__")


# --- the functions --------------------------------------------------------------------------------


def test_harmonics_are_the_cores_and_pass_gradcheck(rng):
    directions = rng.normal(size=(40, 3))
    unit = directions / np.linalg.norm(directions, axis=1)[:, None]
    for degree in range(4):
        count = (degree + 1) ** 2
        basis = gsut._core.harmonics_basis(degree, unit)
        found = evaluate_harmonics(
            degree, tensor(directions, torch.float64), torch.eye(count, dtype=torch.float64)
            .expand(40, count, count),
        )  # fmt: skip
        assert np.abs(array(found) - basis).max() < tolerances.TORCH_HARMONICS, degree
    dirs, coeffs = (
        tensor(rng.normal(size=shape), torch.float64).requires_grad_()
        for shape in ((4, 3), (4, 25, 2))
    )
    masks = torch.tensor([True, False, True, True])
    assert torch.autograd.gradcheck(lambda d, c: evaluate_harmonics(4, d, c, masks), (dirs, coeffs))
    assert (evaluate_harmonics(4, dirs, coeffs, masks)[1] == 0).all()
    with pytest.raises(gsut.InputError, match="degree 3 needs 16 coefficients, found 9"):
        evaluate_harmonics(3, dirs, coeffs[:, :9])


def test_harmonics_of_cameras_are_those_of_their_directions(rng):
    means, coeffs = tensor(rng.normal(size=(5, 3))), tensor(rng.normal(size=(5, 9, 6)))
    poses = torch.stack([tensor(random_pose(rng)) for _ in range(2)])
    found = evaluate_view_harmonics(2, means, poses, coeffs)
    for pose, values in zip(poses, found, strict=True):
        center = torch.inverse(pose)[:3, 3]
        assert torch.allclose(values, evaluate_harmonics(2, means - center, coeffs), atol=1e-5)
    with pytest.raises(gsut.InputError, match="camera_ids is not supported"):
        evaluate_view_harmonics(2, means, poses, coeffs, camera_ids=torch.zeros(5))


def test_covariances_and_inverses_are_those_of_rotated_scales(rng):
    quats = tensor(rng.normal(size=(7, 4)), torch.float64)
    scales = tensor(rng.uniform(0.5, 2, (7, 3)), torch.float64)
    covars, precis = make_covariances(quats, scales)
    identity = torch.eye(3, dtype=torch.float64).expand(7, 3, 3)
    assert torch.allclose(covars @ precis, identity)
    values = torch.linalg.eigvalsh(covars)
    assert torch.allclose(values, torch.sort(scales**2, dim=1).values)
    upper, none = make_covariances(quats, scales, compute_preci=False, triu=True)
    assert none is None and torch.equal(upper[:, 4], covars[:, 1, 2])


def test_relocation_keeps_the_center_and_mass_of_what_it_divides():
    n_max = 51
    binoms = torch.zeros(n_max, n_max)
    for n in range(n_max):
        for k in range(n + 1):
            binoms[n, k] = math.comb(n, k)
    opacities = torch.tensor([0.9, 0.5, 0.0, 1.0, 0.7])
    ratios = torch.tensor([3, 51, 2, 2, 1])
    new, scales = compute_relocation(opacities, torch.ones(5, 3), ratios, binoms)
    together = 1 - (1 - new.double()) ** ratios
    assert torch.allclose(together, opacities.double(), atol=1e-6)
    assert torch.equal(scales[4], torch.ones(3)) and torch.isfinite(scales[[0, 1, 3, 4]]).all()
    # Equation 9: the blend's integral along a line through the centre stays.
    x = np.linspace(-8, 8, 20001)
    for case in range(2):
        old, copy, count, scale = opacities[case], new[case], ratios[case], scales[case, 0]
        one = float(old) * np.exp(-0.5 * x**2)
        many = 1 - (1 - float(copy) * np.exp(-0.5 * (x / float(scale)) ** 2)) ** int(count)
        error = abs(np.sum(many) / np.sum(one) - 1)
        assert error < tolerances.TORCH_RELOCATION
    assert (
        float(compute_relocation(opacities, torch.ones(5, 3), ratios, binoms, 0.005)[0].min()) > 0
    )


def test_projection_has_the_radii_of_info_and_thins_by_the_added_variance():
    params, poses, matrices = make_params()
    scene = [
        params["means"], params["quats"], torch.exp(params["scales"]),
        torch.sigmoid(params["opacities"]),
    ]  # fmt: skip
    radii, means2d, depths, conics, ratios = project_cameras(
        *scene, poses, matrices, SIZE, SIZE, camera_model="fisheye", calc_compensations=True
    )
    _, _, info = draw(rasterization, params, poses, matrices, packed=False)
    seen = (info["radii"] > 0).all(-1)
    assert seen.sum() > 20
    for found, name in ((radii, "radii"), (means2d, "means2d"), (depths, "depths")):
        assert torch.equal(found, info[name].detach()), name
    assert torch.equal(conics, info["conics"])
    assert ((ratios[seen] > 0) & (ratios[seen] < 1)).all() and (ratios[~seen] == 0).all()
    smaller = project_cameras(*scene, poses, matrices, SIZE, SIZE, 0.3, radius_clip=3.0,
                              camera_model="fisheye")[0]  # fmt: skip
    kept = (smaller > 0).all(-1)
    assert 0 < kept.sum() < seen.sum() and (radii[kept].max(-1).values > 3).all()


# --- gsplat itself --------------------------------------------------------------------------------


@pytest.fixture
def gsplat():
    """gsplat with our functions in it; skips where it is not installed."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = pytest.importorskip("gsplat", reason="needs gsplat: pip install --no-deps gsplat")
    with patch_gsplat():
        yield found


def test_gsplats_own_torch_functions_agree(gsplat, rng):
    impl = importlib.import_module("gsplat.cuda._torch_impl")
    dirs, coeffs = tensor(rng.normal(size=(30, 3))), tensor(rng.normal(size=(30, 25, 3)))
    unit = torch.nn.functional.normalize(dirs, dim=-1)
    for degree in range(5):
        theirs = impl._spherical_harmonics(degree, unit, coeffs)
        ours = gsplat.spherical_harmonics(degree, dirs, coeffs)
        assert relative_error(array(ours), array(theirs)) < tolerances.TORCH_GSPLAT, degree
    quats, scales = tensor(rng.normal(size=(30, 4))), tensor(rng.uniform(0.5, 2, (30, 3)))
    theirs = impl._quat_scale_to_covar_preci(quats, scales, triu=True)
    ours = gsplat.quat_scale_to_covar_preci(quats, scales, triu=True)
    for our, their in zip(ours, theirs, strict=True):
        assert relative_error(array(our), array(their)) < tolerances.TORCH_GSPLAT


@pytest.mark.parametrize("name", ["DefaultStrategy", "MCMCStrategy"])
def test_gsplats_strategies_densify_on_the_cpu(gsplat, name):
    torch.manual_seed(0)
    params, poses, matrices = make_params()
    optimizers = {key: torch.optim.Adam([value], lr=1e-3) for key, value in params.items()}
    options = {"DefaultStrategy": {"grow_grad2d": 1e-6}, "MCMCStrategy": {"cap_max": 70}}[name]
    strategy = getattr(gsplat, name)(refine_start_iter=0, refine_every=2, **options)
    strategy.check_sanity(params, optimizers)
    state = strategy.initialize_state()
    for step in range(1, 5):
        image, _, info = draw(gsplat.rasterization, params, poses, matrices, packed=False)
        strategy.step_pre_backward(params, optimizers, state, step, info)
        image.square().mean().backward()
        for optimizer in optimizers.values():
            optimizer.step()
            optimizer.zero_grad()
        more = {"lr": 1e-3} if name == "MCMCStrategy" else {}
        strategy.step_post_backward(params, optimizers, state, step, info, **more)
    assert 60 < len(params["means"]) <= (70 if name == "MCMCStrategy" else 10_000)
    assert torch.isfinite(params["means"]).all()
