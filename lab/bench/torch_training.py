"""A training in PyTorch by gsplat's strategies, through gsut's functions."""

from __future__ import annotations

import time
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import torch

import gsut
from gsut.torch.arrays import to_array, to_tensor
from gsut.training.first import choose_first_gaussians
from tests.bench.harness import Row

_MEAN_FROM = 0.9  # of the steps, from which the result is the mean, as of gsut train
_GROW_UNTIL = 0.5  # of the steps
_GROWTH = 1.05  # of MCMC, by which gsplat multiplies the number of Gaussians
_RATES = {  # gsplat's name of each parameter -> gsut's of its learning rate
    "means": "means", "quats": "quats", "scales": "log_scales", "opacities": "opacity_logits",
    "sh0": "sh0", "shN": "sh_rest",
}  # fmt: skip


class PhotometricLoss(torch.autograd.Function):
    """gsut's loss, 0.8 L1 + 0.2 (1 - SSIM), with its own gradient."""

    @staticmethod
    def forward(ctx: Any, image: torch.Tensor, target: Any) -> torch.Tensor:
        loss, dimage = gsut.photometric_loss(target, to_array(image, "image"))
        ctx.dimage = to_tensor(dimage)
        return torch.tensor(loss)

    @staticmethod
    def backward(ctx: Any, *outer: torch.Tensor) -> Any:
        return outer[0] * ctx.dimage, None


def train_with_gsplat(
    gsplat: ModuleType, data: Path, name: str, steps: int, most: int, noise: float = 0.0
) -> Row:
    """Trains with one of gsplat's strategies at gsut's rates.

    Args:
        gsplat: after `patch_gsplat`.
        data: the dataset, of one lens.
        name: "MCMC" or "Default".
        steps: one image each.
        most: Gaussians, which Default may exceed in its last densification.
        noise: MCMC's noise, relative to the rate of the centres; gsut's short runs have none.

    Returns:
        Held-out PSNR, the number of Gaussians and the seconds of training.
    """
    scene = gsut.load_dataset(data)
    options = gsut.TrainOptions(steps=steps, max_gaussians=most)
    torch.manual_seed(0)
    params = _make_params(scene, options)
    optimizers = {key: torch.optim.Adam([value], eps=1e-15) for key, value in params.items()}
    # 5 % more at a time: as many times as bring the most Gaussians by then.
    every = int(_GROW_UNTIL * steps * np.log(_GROWTH) / np.log(most / len(params["means"])))
    strategy: Any
    if name == "MCMC":
        until = int(_MEAN_FROM * steps)
        strategy = gsplat.MCMCStrategy(
            most, noise, refine_start_iter=0, refine_every=every, refine_stop_iter=until
        )
    else:
        every = options.recipe.densify_every
        until = int(_GROW_UNTIL * steps)
        strategy = gsplat.DefaultStrategy(
            refine_start_iter=every, refine_every=every, refine_stop_iter=until,
            reset_every=10 * steps,
        )  # fmt: skip
    strategy.check_sanity(params, optimizers)
    state = (
        strategy.initialize_state()
        if name == "MCMC"
        else strategy.initialize_state(scene_scale=scene.extent)
    )
    order, begin, views = np.random.default_rng(0), time.perf_counter(), _Views(scene)
    means: dict[str, torch.Tensor] = {}
    for step in range(1, steps + 1):
        rates = gsut.loop.compute_learning_rates(options.recipe, step / steps, scene.extent)
        for key, rate in _RATES.items():
            optimizers[key].param_groups[0]["lr"] = getattr(rates, rate)
        index = int(order.choice(scene.train_indices))
        degree = min(options.sh_degree, step // options.recipe.sh_every)
        image, info = views.render(gsplat, params, index, degree, torch.rand(1, 3))
        loss = PhotometricLoss.apply(image, views.targets[index])
        if name == "MCMC":
            loss = loss + options.recipe.regularizer * torch.sigmoid(params["opacities"]).mean()
            loss = loss + options.recipe.regularizer * torch.exp(params["scales"]).mean()
        strategy.step_pre_backward(params, optimizers, state, step, info)
        loss.backward()
        for optimizer in optimizers.values():
            optimizer.step()
            optimizer.zero_grad(set_to_none=True)
        more = {"lr": rates.means} if name == "MCMC" else {}
        strategy.step_post_backward(params, optimizers, state, step, info, **more)
        if name == "Default" and len(params["means"]) >= 0.6 * most:
            strategy.refine_stop_iter = step
        if step > _MEAN_FROM * steps:
            for key, value in params.items():
                means[key] = means.get(key, 0.0) + value.detach() / (
                    steps - int(_MEAN_FROM * steps)
                )
    seconds = time.perf_counter() - begin
    arrays = {key: to_array(value, key) for key, value in means.items()}
    sh = np.concatenate([arrays["sh0"], arrays["shN"]], 1)
    gaussians = gsut.Gaussians(
        arrays["means"], arrays["quats"], arrays["scales"], arrays["opacities"], sh
    )
    psnr = gsut.evaluate(gaussians, scene, scene.test_indices)["psnr"]
    return {"psnr": psnr, "gaussians": len(gaussians), "seconds": seconds}


def _make_params(scene: gsut.Scene, options: Any) -> torch.nn.ParameterDict:
    """Seeds Gaussians as gsut train does, under gsplat's names."""
    first, _ = choose_first_gaussians(scene, options)
    arrays = {
        "means": first.origin + first.means, "quats": first.quats, "scales": first.log_scales,
        "opacities": first.opacity_logits, "sh0": first.sh[:, :1], "shN": first.sh[:, 1:],
    }  # fmt: skip
    return torch.nn.ParameterDict({
        key: torch.nn.Parameter(to_tensor(np.ascontiguousarray(array, np.float32)))
        for key, array in arrays.items()
    })  # fmt: skip


class _Views:
    """Cameras of a scene as gsplat's arguments, and their photographs as targets."""

    def __init__(self, scene: gsut.Scene) -> None:
        self._scene = scene
        self.targets = {
            i: gsut.PhotometricTarget(scene.image(i), scene.mask(i)) for i in scene.train_indices
        }

    def render(
        self,
        gsplat: ModuleType,
        params: torch.nn.ParameterDict,
        index: int,
        degree: int,
        background: torch.Tensor,
    ) -> tuple[torch.Tensor, Any]:
        camera, view = self._scene.camera(index), self._scene.views[index]
        image, _, info = gsplat.rasterization(
            params["means"], params["quats"], torch.exp(params["scales"]),
            torch.sigmoid(params["opacities"]), torch.cat([params["sh0"], params["shN"]], 1),
            to_tensor(np.array(view.camera_from_world, np.float32))[None], None,
            camera.width, camera.height, sh_degree=degree, packed=False, with_ut=True,
            with_eval3d=True, camera=camera, backgrounds=background, near_plane=-np.inf,
            global_z_order=False,
        )  # fmt: skip
        return image[0], info
