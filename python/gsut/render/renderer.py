"""Images of Gaussians through any lens, and their exact gradients."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import BlendRule, InputError
from gsut.bounds import check_number, name_wrong_kinds
from gsut.gaussians import Gaussians, LinearGaussians, StoredGaussians
from gsut.render.arguments import (
    read_background,
    read_features,
    read_rule,
    set_response,
)
from gsut.render.confidence import Confidence
from gsut.render.motion import convert_about_camera, place_about, read_motion
from gsut.render.projection import DEFAULT_UNSCENTED
from gsut.render.soundness import sum_bits, warn_of_undrawn
from gsut.render.stored import StoredImage
from gsut.render.surroundings import compute_surroundings
from gsut.run import check_fits

# Lower bounds on the bytes of a pixel (ray, colour, alpha, depth, distortion) and of a Gaussian in
# the lists of the frame.
_PIXEL_BYTES = 40
_LISTED_BYTES = 60


@dataclasses.dataclass
class Render:
    """One rendered image and what `render_backward` needs.

    Attributes:
        image: (H, W, 3) colour, background blended in; 0 where the pixel has no ray. Not clipped.
        alpha: (H, W) 1 - remaining transmittance.
        depth: (H, W) sum of weight times distance along the ray; divide by alpha for the expected
            distance. In world units.
        distortion: (H, W) sum of weight times the squared distance from the weighted mean: how far
            apart the Gaussians of a pixel lie; 0 where less than 0.001 is covered.
        gaussians, camera, camera_from_world, rule, background, sh_degree: what was rendered.
        behind: (H, W, 3) what shows where the image is not covered, if not `background`.
        features: (H, W, D) sum of weight times feature, their background blended in; None without
            features.
        color_sigma, depth_sigma: (H, W) bounds that 68 % of pixels keep, on the mean absolute
            difference of their colours to a photograph, and of their depth / alpha; NaN: never seen
        seen_views: (H, W) effective number of training views that show the same; 0: never seen.
            These three are None without confidence.
    """

    image: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    distortion: np.ndarray
    gaussians: Any
    camera: _core.Camera
    camera_from_world: Any  # (4, 4), or a _core.CameraMotion
    rule: BlendRule
    background: tuple[float, float, float]
    sh_degree: int
    renderer: Any  # _core.Renderer, or None for the double reference
    behind: np.ndarray | None = None
    features: np.ndarray | None = None
    color_sigma: np.ndarray | None = None
    depth_sigma: np.ndarray | None = None
    seen_views: np.ndarray | None = None
    seen: Any = None  # what was read of Gaussians in a file, which the renderer goes on with
    _bits: int | None = None  # of the Gaussians as they were drawn
    _channels: dict[str, Any] = dataclasses.field(default_factory=dict, repr=False)
    # Backward passes of one image share its renderer's buffers: one at a time.
    _turn: threading.Lock = dataclasses.field(
        default_factory=threading.Lock, repr=False, compare=False
    )

    def __repr__(self) -> str:
        height, width = self.alpha.shape
        return f"Render({width} x {height}, {self.camera.model}, of {self.gaussians})"

    def add_map(self, values: np.ndarray, sums: np.ndarray) -> None:
        """Adds the sums over pixels of blend weight x value to each Gaussian's.

        Args:
            values: (H, W, D) of the pixels, finite.
            sums: (N, D) float32, C order; grows.

        Raises:
            InputError: a render of the double reference or of Gaussians in a file; a wrong shape.
        """
        if self.renderer is None or self.seen is not None:
            raise InputError("maps are lifted by renders in float32 of Gaussians in memory")
        with self._turn:
            self.renderer.add_features(np.ascontiguousarray(values, np.float32), sums)

    def get_statistics(self) -> dict[str, int]:
        """Returns counts of the tiled path: num_visible, num_pairs, num_contributing_pairs ..."""
        if self.renderer is None:
            return {}
        with self._turn:
            return self.renderer.statistics()


@dataclasses.dataclass
class Gradients:
    """Gradients of a scalar loss.

    Attributes:
        gaussians: shaped like the Gaussians; to means, quats, log_scales, opacity_logits, sh, or of
            `LinearGaussians` to scales and opacities.
        pose: (6,) to (v, w) in camera_from_world <- exp(v, w) camera_from_world; with a rolling
            shutter (2, 6), of the start and of the end pose.
        touched: (N,) bool, some pixel saw the Gaussian; None for the double reference.
        lens: (K,) to the camera's parameters, in their order; None unless requested.
        rays: (H, W, 3) to the pixels' unit rays, across them, in the axes of the camera in the
            middle of the exposure; None unless requested.
        features: (N, D) to the features; None without `dfeatures`.
    """

    gaussians: Any  # Gaussians or LinearGaussians
    pose: np.ndarray
    touched: np.ndarray | None
    lens: np.ndarray | None = None
    rays: np.ndarray | None = None
    features: np.ndarray | None = None

    def __repr__(self) -> str:
        touched = "" if self.touched is None else f", {np.count_nonzero(self.touched)} touched"
        return f"Gradients(to {self.gaussians}{touched}{', lens' if self.lens is not None else ''})"


@name_wrong_kinds
def render(
    gaussians: Gaussians | LinearGaussians | StoredGaussians,
    camera: _core.Camera,
    camera_from_world: Any,
    *,
    features: np.ndarray | None = None,
    features_background: Sequence[float] | np.ndarray | None = None,
    confidence: Confidence | None = None,
    shutter: _core.Shutter | str | None = None,
    background: Sequence[float] | np.ndarray | None = (0.0, 0.0, 0.0),
    parity: str | None = None,
    blend: BlendRule | None = None,
    order: str | None = None,
    response: str | None = None,
    sh_degree: int = 3,
    unscented: Sequence[float] = DEFAULT_UNSCENTED,
    dtype: str = "float32",
    watch: bool = True,
) -> Render:
    """Renders Gaussians: each pixel's ray is evaluated against the Gaussians in 3D.

    Args:
        gaussians: the scene; of one that stays in its file what the image shows is read.
        camera: lens and image size.
        camera_from_world: (4, 4) rigid transform, or an object with such a `matrix`; of the
            Gaussians' world, which is the dataset's. With a rolling shutter the pair of them at
            the start and at the end of the exposure.
        features: (N, D) values that the Gaussians carry beside their colour, any number of them:
            blended by the same weights, without harmonics and without a clamp. Colours of your own,
            labels, descriptors, depths along any axis.
        features_background: (D,) what shows behind the features; None stands for zeros.
        confidence: from `gsut.rendering.measure_confidence`, for sigmas; in place of features.
        shutter: the `Shutter` of a pair of poses, or its direction: "top_to_bottom",
            "bottom_to_top", "left_to_right" or "right_to_left". Each line of the image is then
            seen from its own pose; Gaussians are ordered and shaded from the middle one.
        background: colour behind everything, or an image (H, W, 3) of them in [0, 1]; None: where
            no Gaussian is, the soft colour of what is around in the image (to be recognized by
            `alpha`).
        parity: blending rules of "gsplat" or "3dgrut"; None: gsut's own.
        blend: a `BlendRule` of your own in place of parity.
        order: "distance" or "z": Gaussians are blended by their means' distance from the camera or
            camera z; "ray": as each pixel's own ray passes them (in float32 without features);
            "integral": they overlap as densities, and the light along the ray is integrated to
            1e-12 (float64 only, without a gradient). None: as parity or blend say, without them as
            the Gaussians do.
        response: in place of the Gaussians' own, which None leaves.
        sh_degree: harmonics above this degree are ignored.
        unscented: alpha, beta, kappa of the transform that bounds each Gaussian's tiles.
        dtype: "float32": tiled and vectorised. "float64": the scalar reference, every Gaussian at
            every pixel; slow.
        watch: False: `render_backward` does not notice whether the Gaussians have changed since,
            which saves a look at all of them in either call.

    Returns:
        Image, alpha and depth, with what `render_backward` needs. float32 is within 1e-5 rms of the
        reference for scales of 1e-12 to 1e12, coordinates up to 1e12, lengths up to 1e5 times the
        width and norms of quaternions of 1e-35 to 3e37. Gaussians in float64 are rounded about
        the camera's centre, so they may lie far from the world's zero.

    Warns:
        RuntimeWarning: in float32, Gaussians in memory are not finite or outside these bounds; with
            their number.

    Raises:
        InputError: an argument is wrong, some do not go together, or memory does not suffice.
    """
    check_fits(
        f"an image of {camera.width} x {camera.height} of {len(gaussians):,} Gaussians",
        _PIXEL_BYTES * camera.width * camera.height
        + (0 if isinstance(gaussians, StoredGaussians) else _LISTED_BYTES * len(gaussians)),
        "render a smaller one (--size), or fewer Gaussians (gsut compact)",
    )
    rule, gaussians = read_rule(parity, blend, order), set_response(gaussians, response)
    color, behind = read_background(background, camera)
    if confidence is not None:
        features = confidence.list_channels(gaussians, features)
    pose = read_motion(camera_from_world, shutter)
    gaussians = convert_about_camera(gaussians, pose, dtype)
    place = place_about(pose, gaussians.origin)
    degree = min(check_number(sh_degree, "sh_degree", 0, whole=True), gaussians.sh_degree)
    look: dict[str, Any] = {
        "rule": rule, "background": color, "sh_degree": degree, "unscented": tuple(unscented)
    }  # fmt: skip
    channels = read_features(features, features_background, gaussians, dtype)
    pixels: np.ndarray | None = None
    shown = (camera, pose, rule, color, degree)
    drawn: Any = gaussians
    renderer: Any = None
    seen = None
    if dtype == "float64":
        if isinstance(gaussians, StoredGaussians):
            raise InputError("the double reference takes Gaussians in memory, not in a file")
        drawn = gaussians.to_dtype(np.float64)
        job = _core.RenderJob(camera, place, **look, **channels)
        image, alpha, depth, _, distortion, *of_features = _core.render_reference(drawn, job)
        pixels = of_features[0] if channels else None
    elif dtype != "float32":
        raise InputError(f'dtype "{dtype}" is unknown; known: float32, float64')
    elif isinstance(gaussians, StoredGaussians):
        stored = StoredImage(gaussians, camera, place, look)
        image, alpha, depth, distortion = stored.draw()
        renderer, seen = stored.renderer, stored.seen
    else:
        if isinstance(drawn, Gaussians):
            warn_of_undrawn(drawn)
        renderer = _core.Renderer()
        found, pixels = _draw_tiled(renderer, drawn, camera, place, look, channels)
        image, alpha, depth, distortion = found
    watch &= isinstance(drawn, Gaussians | LinearGaussians)
    bits = sum_bits(drawn, channels.get("features")) if watch else None
    out = Render(
        image, alpha, depth, distortion, drawn, *shown, renderer, features=pixels, seen=seen,
        _bits=bits, _channels=channels,
    )  # fmt: skip
    if confidence is not None:
        out = confidence.add_sigmas(out)
    if background is None:
        behind = compute_surroundings(out.image, out.alpha, camera)
    return out if behind is None else _put_behind(out, behind)


def _put_behind(out: Render, behind: np.ndarray) -> Render:
    """Blends an image (H, W, 3) in where the Gaussians do not cover a render."""
    behind = behind.astype(out.image.dtype)
    image = out.image + (1.0 - out.alpha)[..., None] * behind
    return dataclasses.replace(out, image=image, behind=behind)


def _draw_tiled(
    renderer: Any, drawn: Any, camera: _core.Camera, place: Any, look: dict[str, Any],
    channels: dict[str, Any],
) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray | None]:  # fmt: skip
    image = np.zeros((camera.height, camera.width, 3), np.float32)
    alpha, depth, distortion = (np.zeros(image.shape[:2], np.float32) for _ in range(3))
    pixels = None
    if channels:
        width = channels["features"].shape[1]
        pixels = np.zeros((camera.height, camera.width, width), np.float32)
    job = _core.RenderJob(camera, place, **look, **channels)
    renderer.render(drawn, job, image, alpha, depth, distortion, pixels)
    return (image, alpha, depth, distortion), pixels


def _read_gradient(values: np.ndarray, name: str, dtype: np.dtype) -> np.ndarray:
    return np.ascontiguousarray(_core.read_array(values, name), dtype=dtype)


@name_wrong_kinds
def render_backward(
    result: Render,
    dimage: np.ndarray,
    dalpha: np.ndarray | None = None,
    ddepth: np.ndarray | None = None,
    *,
    ddistortion: np.ndarray | None = None,
    dfeatures: np.ndarray | None = None,
    with_lens: bool = False,
) -> Gradients:
    """Computes gradients of L = sum(dimage * image) + sum(dalpha * alpha) + ...

    Args:
        result: what `render` returned.
        dimage: (H, W, 3) dL_dimage.
        dalpha: (H, W) dL_dalpha; None stands for zeros.
        ddepth: (H, W) dL_ddepth; None stands for zeros.
        ddistortion: (H, W) dL_ddistortion; None stands for zeros.
        dfeatures: (H, W, D) dL_dfeatures; None stands for zeros.
        with_lens: also the gradients to the lens and to each pixel's ray, which takes longer.

    Returns:
        Gradients to all parameters and to the pose. Exact but for the cut-offs of the blend rule,
        which are not differentiated; a clamped alpha or colour has gradient 0. The lens' are
        through the rays: pixels stay, their rays move (implicit function theorem on `project`);
        which pixels have a ray at all is not differentiated, nor, for depths through a moving
        pupil, where along itself a ray starts, nor `behind`, which counts as a constant. float32
        is within 1e-4 (relative L2 norm of each parameter's gradient) of the double reference.

    Raises:
        InputError: shapes differ from the image's, or the Gaussians have changed since the render.
    """
    g = result.gaussians
    if isinstance(g, StoredGaussians):
        raise InputError("gradients are of Gaussians in memory, not of those in a file")
    channels = result._channels
    if result._bits is not None and sum_bits(g, channels.get("features")) != result._bits:
        raise InputError(
            "the Gaussians have changed since they were rendered; render them again, or change "
            "them after render_backward"
        )
    dimage = _read_gradient(dimage, "dimage", g.dtype)
    dalpha = None if dalpha is None else _read_gradient(dalpha, "dalpha", g.dtype)
    ddepth = None if ddepth is None else _read_gradient(ddepth, "ddepth", g.dtype)
    if ddistortion is not None:
        ddistortion = _read_gradient(ddistortion, "ddistortion", g.dtype)
    if result.behind is not None:
        through = np.sum(dimage * result.behind, axis=2)
        dalpha = -through if dalpha is None else dalpha - through
    out = g.make_zeros()
    given = {"dalpha": dalpha, "ddepth": ddepth, "ddistortion": ddistortion}
    to_features: np.ndarray | None = None
    if dfeatures is not None:
        if not channels:
            raise InputError("dfeatures needs a render with features")
        to_features = np.zeros_like(channels["features"])
        dfeatures = _read_gradient(dfeatures, "dfeatures", g.dtype)
        given = {**given, "dfeatures": dfeatures, "to_features": to_features}
    if result.renderer is None:
        job = _core.RenderJob(
            result.camera, place_about(result.camera_from_world, g.origin), rule=result.rule,
            background=result.background, sh_degree=result.sh_degree, **channels,
        )  # fmt: skip
        pose, lens = _core.render_reference_backward(
            g, job, dimage, out, **given, with_lens=with_lens
        )
        of_lens, of_rays = lens or (None, None)
        return Gradients(out, pose, None, of_lens, of_rays, to_features)
    touched = np.zeros(len(g), np.uint8)
    with result._turn:
        pose = result.renderer.backward(dimage, out, touched, **given, with_lens=with_lens)
        lens = result.renderer.lens_gradients()
    of_lens, of_rays = lens or (None, None)
    return Gradients(out, pose, touched.astype(bool), of_lens, of_rays, to_features)
