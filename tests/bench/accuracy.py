"""Errors of a float renderer against the double reference, on a random sample of whole tiles.

The reference evaluates every Gaussian at every pixel; a sample of tiles and, for them, only the
Gaussians that can reach their rays, make it affordable for any scene with the very same result.

Two tiers: where the blend rule jumps (an alpha within rounding of the cut-off, a transmittance
within rounding of the stop) any float renderer may fall on either side, which is no error of its
arithmetic. Such pixels are found with the reference alone, by moving the cut-offs a little. They
are counted and their error is told apart; the gradients are those of a loss without them.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut import _core
from gsut.gaussians import Gaussians
from tests.bench.scenes import BenchScene

PARAMETERS = ("means", "quats", "log_scales", "opacity_logits", "sh")
_TILE = 16
# Slack of the cone test, radians and relative: far above the rounding of double arithmetic.
_SLACK = 1e-9
# Relative move of the cut-offs that finds the pixels where the rule jumps. In float, alpha errs by
# eps times distance over size of the Gaussian: up to 1.2e-4 in the cross-product form, 0.8e-4 in
# the tiled kernels' (measured on these scenes in a study).
_JUMP = 1e-4


@dataclasses.dataclass
class Truth:
    """What the double reference gives on the sampled pixels.

    Attributes:
        pixels: (H, W) uint8, 1 where sampled.
        image: (P, 3) colours of the sampled pixels, row by row.
        alpha: (P,) of these pixels.
        smooth: (P,) bool, False where the blend rule jumps.
        dimage: (H, W, 3) float32, the random gradient of the loss; 0 where not sampled or not
            smooth.
        rows: (M,) indices of the Gaussians that can reach the sample.
        gradients: of these M Gaussians; those of all others are 0. None if not asked for.
        pairs_per_pixel: Gaussians blended a sampled pixel.
        sample: what was sampled, in words.
    """

    pixels: np.ndarray
    image: np.ndarray
    alpha: np.ndarray
    smooth: np.ndarray
    dimage: np.ndarray
    rows: np.ndarray
    gradients: Gaussians | None
    pairs_per_pixel: float
    sample: str


@dataclasses.dataclass
class Errors:
    """Errors of one renderer against `Truth`.

    Attributes:
        image_rms: root mean square over the smooth sampled pixels and channels, colours in [0, 1].
        image_rms_all: over all sampled pixels, those where the rule jumps too.
        image_max: the largest, over all sampled pixels.
        gradients: relative L2 error of each parameter's gradient, over all Gaussians.
    """

    image_rms: float
    image_rms_all: float
    image_max: float
    gradients: dict[str, float]

    @property
    def gradient_relative(self) -> float | None:
        """The worst parameter's; None where no gradients were compared."""
        return max(self.gradients.values(), default=None)


def make_truth(
    scene: BenchScene,
    rule: _core.BlendRule,
    *,
    tiles: int,
    seed: int = 0,
    with_gradients: bool = True,
    jump: float = _JUMP,
) -> Truth:
    """Renders a sample of the scene in double.

    Args:
        scene: the scene.
        rule: of blending.
        tiles: number of 16 x 16 tiles, drawn at random; all pixels if there are no more.
        seed: of the sample and of the loss' gradient.
        with_gradients: False leaves them out.
        jump: relative move of the cut-offs that finds the pixels where the rule jumps.
    """
    camera, pose = scene.camera, scene.camera_from_world
    rng = np.random.default_rng(seed)
    pixels, chosen = _sampled_pixels(camera, tiles, rng)
    rows = _reaching_rows(scene, rule.alpha_min * (1.0 - jump), chosen)
    g = scene.gaussians[rows].to_dtype(np.float64)
    background, degree = (0.0, 0.0, 0.0), scene.gaussians.sh_degree
    inside = pixels != 0

    def render(factor: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        moved = _moved(rule, factor)
        job = _core.RenderJob(camera, pose, rule=moved, background=background, sh_degree=degree)
        image, alpha, _, blended, _ = _core.render_reference(g, job, pixels)
        return image[inside], alpha[inside], blended[inside]

    image, alpha, blended = render(1.0)
    smooth = (render(1.0 - jump)[2] == blended) & (render(1.0 + jump)[2] == blended)
    dimage = np.zeros((*pixels.shape, 3), np.float32)
    dimage[inside] = rng.normal(size=image.shape) * smooth[:, None]
    gradients = None
    if with_gradients:
        gradients = empty_gradients(g)
        job = _core.RenderJob(camera, pose, rule=rule, background=background, sh_degree=degree)
        _core.render_reference_backward(g, job, dimage.astype(np.float64), gradients, pixels=pixels)
    return Truth(
        pixels, image, alpha, smooth, dimage, rows, gradients, float(blended.mean()),
        f"{len(chosen)} tiles, {len(image)} of {pixels.size} pixels, "
        f"at a jump of the rule {np.count_nonzero(~smooth)}",
    )  # fmt: skip


def errors_of(truth: Truth, image: np.ndarray, gradients: Gaussians | None) -> Errors:
    """Compares an image and, if given, gradients for `truth.dimage`.

    Args:
        truth: of the same scene and rule.
        image: (H, W, 3).
        gradients: of all N Gaussians.
    """
    difference = image[truth.pixels != 0] - truth.image
    relative = {}
    if gradients is not None and truth.gradients is not None:
        others = np.ones(len(gradients), bool)
        others[truth.rows] = False
        for name in PARAMETERS:
            found = getattr(gradients, name)
            exact = getattr(truth.gradients, name)
            wrong = np.linalg.norm(found[truth.rows].astype(np.float64) - exact)
            # All others must be 0.
            wrong = np.hypot(wrong, np.linalg.norm(found[others].astype(np.float64)))
            relative[name] = float(wrong / np.linalg.norm(exact))
    return Errors(
        float(np.sqrt(np.mean(difference[truth.smooth] ** 2))),
        float(np.sqrt(np.mean(difference**2))),
        float(np.abs(difference).max()),
        relative,
    )


def empty_gradients(g: Gaussians) -> Gaussians:
    """Zeros in the shapes of the Gaussians."""
    return Gaussians(*(np.zeros_like(getattr(g, name)) for name in PARAMETERS))


def _moved(rule: _core.BlendRule, factor: float) -> _core.BlendRule:
    """The rule with its cut-offs multiplied by a factor."""
    moved = _core.BlendRule()
    for name in (
        "alpha_min", "alpha_max", "response_min", "transmittance_min", "stop_before", "near_z",
        "far_z", "order",
    ):  # fmt: skip
        setattr(moved, name, getattr(rule, name))
    moved.alpha_min *= factor
    moved.transmittance_min *= factor
    moved.response_min *= factor
    return moved


def _sampled_pixels(
    camera: _core.Camera, tiles: int, rng: np.random.Generator
) -> tuple[np.ndarray, list[np.ndarray]]:
    """(H, W) uint8 mask of whole tiles, and each tile's (P, 3) valid rays in the camera frame."""
    rays, valid = camera.rays()
    valid = np.asarray(valid, bool)
    corners = [
        (y, x) for y in range(0, camera.height, _TILE) for x in range(0, camera.width, _TILE)
    ]
    pixels = np.zeros(valid.shape, np.uint8)
    chosen: list[np.ndarray] = []
    for place in rng.permutation(len(corners)):
        if len(chosen) == tiles:
            break
        y, x = corners[place]
        window = (slice(y, y + _TILE), slice(x, x + _TILE))
        if valid[window].any():
            pixels[window] = valid[window]
            chosen.append(rays[window][valid[window]])
    return pixels, chosen


def _reaching_rows(scene: BenchScene, alpha_min: float, tiles: list[np.ndarray]) -> np.ndarray:
    """Gaussians whose cut-off ellipsoid's sphere meets the cone of a tile's rays."""
    g = scene.gaussians
    pose, shift, turn = _middle(scene.camera_from_world)
    means = g.means.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
    opacity = 1.0 / (1.0 + np.exp(-g.opacity_logits.astype(np.float64)))
    cutoff = 2.0 * np.log(np.maximum(opacity / alpha_min, 1.0))
    radius = np.sqrt(cutoff) * np.exp(g.log_scales.max(axis=1).astype(np.float64)) + shift
    distance = np.linalg.norm(means, axis=1)
    reach = np.where(
        radius < distance, np.arcsin(np.minimum(radius / np.maximum(distance, 1e-300), 1.0)), np.pi
    )
    direction = means / np.maximum(distance, 1e-300)[:, None]
    meets = np.zeros(len(g), bool)
    for rays in tiles:
        axis = rays.sum(axis=0)
        axis /= np.linalg.norm(axis)
        half_angle = np.arccos(np.clip(rays @ axis, -1.0, 1.0)).max()
        between = np.arccos(np.clip(direction @ axis, -1.0, 1.0))
        # arccos is coarse next to 0 and pi: 1e-8.
        meets |= between <= reach + half_angle + turn + _SLACK + 2e-8
    return np.flatnonzero(meets & (opacity >= alpha_min * (1.0 - _SLACK)))


def _middle(place: np.ndarray | _core.CameraMotion) -> tuple[np.ndarray, float, float]:
    """The pose in the middle of the exposure, and how far (units, radians) others are from it."""
    if not isinstance(place, _core.CameraMotion):
        return place, 0.0, 0.0
    start, end = place.start, place.end
    shift = start[:3, :3].T @ start[:3, 3] - end[:3, :3].T @ end[:3, 3]
    cosine = (np.trace(start[:3, :3] @ end[:3, :3].T) - 1.0) / 2.0
    turn = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return place.at(0.5), 0.5 * float(np.linalg.norm(shift)), 0.5 * turn
