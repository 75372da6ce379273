"""`lab/run bench torch`: the cost of gsut.torch, beside gsplat's reference and strategies."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any

import numpy as np

import gsut
from tests.bench.harness import HALL, WRONG, Benchmark, Column, Option, Row, Settings
from tests.find_torch import find_torch

_FOCAL = 0.4  # of the image's width: a wide fisheye
_REFERENCE_FOCAL = 1.0  # of the width, a pinhole
_SH_DEGREE = 3
_FIRST_SIDE = 60_000  # Gaussians whose sizes are as drawn; fewer are larger
_GSPLAT = "needs gsplat 1.5: pip install --no-deps gsplat==1.5.3"


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists steps of several sizes, gsplat's reference, and trainings by three programs."""
    for size in settings.sizes:
        yield {"what": "step", "size": size}
    yield {"what": "gsplat's reference", "size": settings.reference}
    for data in settings.sets or (HALL,):
        for program in ("gsut train", "gsplat MCMC", "gsplat Default"):
            yield {"what": program, "data": data}


def measure(case: Row, settings: Settings) -> Row:
    """Measures one row; those that lack torch or gsplat say so."""
    try:
        find_torch()
    except ImportError as error:
        return {WRONG: f"needs torch, which ./run test --torch installs ({error})"}
    if case["what"] == "step":
        return _measure_step(case["size"], settings.steps)
    if case["what"] == "gsut train":
        return _train(settings, settings.path(case["data"]))
    try:
        gsplat = importlib.import_module("gsplat")
    except ImportError:
        return {WRONG: _GSPLAT}
    if "reference" in case["what"]:
        return _measure_reference(gsplat, case["size"])
    from gsut.torch import patch_gsplat
    from lab.bench.torch_training import train_with_gsplat

    strategy = case["what"].removeprefix("gsplat ")
    with patch_gsplat():
        return train_with_gsplat(
            gsplat, settings.path(case["data"]), strategy, settings.train_steps, settings.most
        )


class _Job:
    """Gaussians before a camera, as arrays and as tensors.

    Args:
        words: "N_WxH".
        model: "fisheye" or "pinhole", gsplat's.
    """

    def __init__(self, words: str, model: str) -> None:
        import torch

        from gsut.torch.arrays import to_tensor

        number, size = words.split("_")
        count, (width, height) = int(number), map(int, size.split("x"))
        rng = np.random.default_rng(0)
        grow = (_FIRST_SIDE / count) ** (1 / 3)
        self.arrays: dict[str, np.ndarray] = {
            "means": rng.uniform(-3, 3, (count, 3)) + np.array([0, 0, 4]),
            "quats": rng.normal(size=(count, 4)),
            "scales": rng.uniform(0.01, 0.06, (count, 3)) * grow,
            "opacities": rng.uniform(0.1, 0.9, count),
            "sh": rng.normal(size=(count, (_SH_DEGREE + 1) ** 2, 3)) * 0.2,
        }
        self.arrays = {key: array.astype(np.float32) for key, array in self.arrays.items()}
        self.slopes = rng.normal(size=(height, width, 3)).astype(np.float32)
        focal = width * (_FOCAL if model == "fisheye" else _REFERENCE_FOCAL)
        params = [focal, focal, width / 2, height / 2]
        self.camera = (
            gsut.Camera("kannala_brandt", [*params, 0, 0, 0, 0], width, height)
            if model == "fisheye"
            else gsut.Camera("pinhole", params, width, height)
        )
        self.model, self.size = model, (width, height)
        self.leaves = {
            key: to_tensor(array.copy()).requires_grad_() for key, array in self.arrays.items()
        }
        self.outer = to_tensor(self.slopes[None].copy())
        self.pose = torch.eye(4)[None]
        fx, fy, cx, cy = params
        self.matrix = torch.tensor([[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]])
        self.rule = gsut.BlendRule("gsplat")
        self.rule.near_z, self.rule.far_z, self.rule.order = 0.01, 1e10, "z"

    def call_engine(self) -> Any:
        """Renders and differentiates without torch."""
        gaussians = gsut.LinearGaussians(**self.arrays)
        rendered = gsut.render(gaussians, self.camera, np.eye(4), blend=self.rule)
        gsut.render_backward(rendered, self.slopes)
        return rendered.image

    def call(self, function: Callable[..., Any], **options: Any) -> Any:
        """Renders and differentiates by a function with gsplat's signature."""
        for leaf in self.leaves.values():
            leaf.grad = None
        image, _, _ = function(
            self.leaves["means"], self.leaves["quats"], self.leaves["scales"],
            self.leaves["opacities"], self.leaves["sh"], self.pose, self.matrix, *self.size,
            sh_degree=_SH_DEGREE, **options,
        )  # fmt: skip
        image.backward(self.outer)
        return image


def _time_in_turns(calls: dict[str, Callable[[], Any]], times: int) -> dict[str, float]:
    """Returns each call's least milliseconds of processor time on one thread; calls take turns."""
    import torch

    gsut.set_num_threads(1)
    torch.set_num_threads(1)
    found: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(times):
        for name, call in calls.items():
            begin = time.process_time()
            call()
            found[name].append(1e3 * (time.process_time() - begin))
    return {name: min(values) for name, values in found.items()}


def _measure_step(words: str, times: int) -> Row:
    """Compares the adapter with render and render_backward, as a share of a step of training."""
    import torch

    from gsut.torch import rasterization
    from lab.bench.torch_training import PhotometricLoss

    job = _Job(words, "fisheye")
    target = gsut.PhotometricTarget(job.call_engine().clip(0, 1))
    optimizer = torch.optim.Adam(list(job.leaves.values()), lr=1e-9)
    options = {
        "camera_model": "fisheye", "packed": False, "with_ut": True, "with_eval3d": True,
    }  # fmt: skip

    def call_adapter() -> Any:
        return job.call(rasterization, **options)

    def finish_step() -> None:
        image = torch.zeros(*job.slopes.shape, requires_grad=True)
        PhotometricLoss.apply(image, target).backward()
        optimizer.step()

    spent = _time_in_turns(
        {"engine": job.call_engine, "adapter": call_adapter, "rest": finish_step}, times
    )
    step = spent["adapter"] + spent["rest"]
    return {
        "ms": spent["adapter"], "engine_ms": spent["engine"], "step_ms": step,
        "overhead": 100 * (spent["adapter"] - spent["engine"]) / step,
    }  # fmt: skip


def _measure_reference(gsplat: ModuleType, words: str) -> Row:
    """Compares with gsplat's reference, whose 2D splats are near the truth for small ones."""
    from gsut.torch import rasterization
    from lab.bench.torch_reference import PairClock, make_reference

    reference = make_reference(gsplat)._rasterization
    job = _Job(words, "pinhole")
    ours = _time_in_turns({"ours": lambda: job.call(rasterization)}, 9)["ours"]
    image = job.call(rasterization)
    PairClock.seconds = 0.0
    begin = time.process_time()
    theirs = job.call(reference)
    spent = 1e3 * (time.process_time() - begin - PairClock.seconds)
    error = float((image - theirs).detach().square().mean().sqrt())
    return {"ms": ours, "reference_ms": spent, "ratio": spent / ours, "difference": error}


def _train(settings: Settings, data: Any) -> Row:
    scene = gsut.load_dataset(data)
    options = gsut.TrainOptions(
        steps=settings.train_steps, max_gaussians=settings.most, exposure="off"
    )
    begin = time.perf_counter()
    result = gsut.train(scene, options, out=settings.folder / "gsut-train", progress=False)
    psnr = gsut.evaluate(result.gaussians, scene, scene.test_indices)["psnr"]
    seconds = time.perf_counter() - begin
    return {"psnr": psnr, "gaussians": len(result.gaussians), "seconds": seconds}


BENCHMARK = Benchmark(
    help="gsut.torch beside its engine and gsplat's PyTorch reference; gsplat's strategies by it",
    columns=(
        Column("what"),
        Column("size"),
        Column("data"),
        Column("ms", "rasterization", "CPU-ms", ".1f"),
        Column("engine_ms", "without torch", "CPU-ms", ".1f"),
        Column("step_ms", "step", "CPU-ms", ".1f"),
        Column("overhead", "adapter", "% of a step", ".1f"),
        Column("reference_ms", "reference", "CPU-ms", ".0f"),
        Column("ratio", "reference / gsut", "", ".0f"),
        Column("difference", "rms difference", "", ".4f"),
        Column("psnr", "PSNR", "dB", ".2f"),
        Column("gaussians", form=",d"),
        Column("seconds", "training", "s", ".1f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("sizes", ("5000_128x128", "60000_640x480"), "of steps: Gaussians_WIDTHxHEIGHT"),
        Option("reference", "10000_300x200", "size of the comparison with the reference"),
        Option("steps", 40, "calls, of which the fastest counts"),
        Option("train_steps", 1600, "of each training"),
        Option("most", 5000, "Gaussians of each training"),
    ),
)
