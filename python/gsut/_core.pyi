"""Types of the C++ module gsut._core; tests/python/test_stubs.py compares them with the module."""

from collections.abc import Sequence
from typing import Any, Protocol, TypeAlias, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import Unpack

__version__: str

def describe_build() -> dict[str, str]: ...

class InputError(ValueError): ...
class CalibrationError(InputError): ...
class SolveError(RuntimeError): ...

# What a binding reads as Gaussians: any object with these five arrays (gsut.Gaussians is one), or
# with scales and opacities in place of logarithms and logits (gsut.LinearGaussians).
class _LogGaussians(Protocol):
    means: NDArray[Any]  # (N, 3)
    quats: NDArray[Any]  # (N, 4) w, x, y, z
    log_scales: NDArray[Any]  # (N, 3)
    opacity_logits: NDArray[Any]  # (N,)
    sh: NDArray[Any]  # (N, K, 3)

class _LinearGaussians(Protocol):
    means: NDArray[Any]
    quats: NDArray[Any]
    scales: NDArray[Any]  # (N, 3)
    opacities: NDArray[Any]  # (N,)
    sh: NDArray[Any]

_Gaussians: TypeAlias = _LogGaussians | _LinearGaussians

# means, quats, log_scales, opacity_logits, sh of new Gaussians.
_Arrays: TypeAlias = tuple[
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.float32],
]

# A 4x4 matrix or an object whose attribute `matrix` is one.
_PoseLike: TypeAlias = Any
# The same, or a CameraMotion.
_MotionLike: TypeAlias = Any

# --- arrays ---------------------------------------------------------------------------------------

def read_array(object: ArrayLike, name: str) -> NDArray[Any]: ...

# --- base -----------------------------------------------------------------------------------------

def set_num_threads(num_threads: int) -> None: ...
def num_threads() -> int: ...
def active_isa() -> str: ...
def available_isas() -> list[str]: ...
def set_isa(name: str) -> None: ...

# --- cameras --------------------------------------------------------------------------------------

class Camera:
    def __init__(
        self,
        model: str,
        params: Sequence[float] | NDArray[Any],
        width: int,
        height: int,
        valid_field_angle: float = ...,
    ) -> None: ...
    @property
    def model(self) -> str: ...
    @property
    def params(self) -> NDArray[np.float64]: ...
    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def max_angle(self) -> float: ...
    @property
    def valid_field_angle(self) -> float: ...
    def project(
        self, points_in_camera: NDArray[Any]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]: ...
    def unproject(self, pixels: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]: ...
    def project_jacobian(
        self,
        points_in_camera: NDArray[Any],
        with_params: bool | Sequence[int] | NDArray[Any] = True,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
    @property
    def is_central(self) -> bool: ...
    @property
    def is_parallel(self) -> bool: ...
    @property
    def is_cone(self) -> bool: ...
    @property
    def is_panorama(self) -> bool: ...
    @property
    def period(self) -> list[float]: ...  # (2,) pixels after which the image repeats; 0: never
    def rays(self) -> tuple[NDArray[np.float64], NDArray[np.bool_]]: ...
    def origins(self) -> NDArray[np.float64]: ...
    def ray_origins(
        self, pixels: NDArray[Any]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]: ...
    def resize(self, width: int, height: int) -> Camera: ...
    def with_valid_field_angle(self, valid_field_angle: float) -> Camera: ...
    def __eq__(self, other: object) -> bool: ...

def camera_models() -> list[str]: ...
def camera_param_names(model: str) -> str: ...
def camera_examples(model: str) -> list[tuple[str, list[float], int, int]]: ...
def camera_traits(model: str) -> LensTraits: ...
def camera_accepts_params(model: str, num_params: int) -> bool: ...
def camera_fit_starts(
    model: str, focal: Sequence[float], center: Sequence[float], max_angle: float
) -> list[list[float]]: ...

class LensTraits:
    @property
    def choices(self) -> list[int]: ...
    @property
    def fit_held(self) -> list[int]: ...
    @property
    def fit_near(self) -> list[int]: ...
    @property
    def has_table(self) -> bool: ...
    @property
    def is_central(self) -> bool: ...
    @property
    def is_parallel(self) -> bool: ...

def parse_camera_model(
    text: str, source: str
) -> tuple[Camera, list[float], list[list[float]] | None]: ...
def format_camera_model(
    camera: Camera,
    extrinsics: Sequence[float] | NDArray[np.float64],
    valid_region: Sequence[Sequence[float]] | NDArray[np.float64] | None,
) -> str: ...

# --- geometry -------------------------------------------------------------------------------------

class Shutter:
    def __init__(self, direction: str = "global", parity: str | None = None) -> None: ...
    @property
    def direction(self) -> str: ...
    @property
    def parity(self) -> str | None: ...
    @property
    def is_global(self) -> bool: ...
    def line_times(self, width: int, height: int) -> NDArray[np.float64]: ...

class CameraMotion:
    def __init__(self, start: _PoseLike, end: _PoseLike, shutter: Shutter) -> None: ...
    @property
    def start(self) -> NDArray[np.float64]: ...
    @property
    def end(self) -> NDArray[np.float64]: ...
    @property
    def shutter(self) -> Shutter: ...
    def at(self, t: float) -> NDArray[np.float64]: ...

def exp_pose(xi: ArrayLike) -> NDArray[np.float64]: ...
def interpolate_pose(start: _PoseLike, end: _PoseLike, t: float) -> NDArray[np.float64]: ...
def checked_pose(matrix: _PoseLike) -> NDArray[np.float64]: ...
def velocity_between(start: _PoseLike, end: _PoseLike) -> NDArray[np.float64]: ...
def moved_pose(middle: _PoseLike, velocity: ArrayLike, time: float) -> NDArray[np.float64]: ...

# --- sfm ------------------------------------------------------------------------------------------

class ImageBearings:
    def __init__(self, camera: Camera, pixels: ArrayLike) -> None: ...
    @property
    def valid(self) -> NDArray[np.bool_]: ...

def match_pairs(
    descriptors: Sequence[NDArray[np.uint8]],
    pairs: ArrayLike,
    max_ratio: float,
    max_distance: float,
) -> list[NDArray[np.int32]]: ...
def verify_pairs(
    images: Sequence[ImageBearings],
    pairs: ArrayLike,
    matches: Sequence[NDArray[np.int32]],
    max_error: float,
    seed: int,
) -> list[tuple[NDArray[np.bool_], NDArray[np.float64], int, float, bool]]: ...
def shared_information(
    body: ArrayLike,
    point: ArrayLike,
    by_body: ArrayLike,
    by_shared: ArrayLike,
    by_point: ArrayLike,
    prior: ArrayLike,
    held: Sequence[int],
) -> tuple[NDArray[np.float64], int]: ...
def absolute_pose(
    image: ImageBearings, features: ArrayLike, points: ArrayLike, max_error: float, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]: ...
def estimate_poses(
    cameras: Sequence[Camera],
    camera_of_image: Sequence[int],
    pixels: Sequence[NDArray[np.float64]],
    verified: Sequence[tuple[Any, ...]],
    settings: dict[str, Any],
    on_progress: Any,
) -> dict[str, Any]: ...
def refine_structure(
    cameras: Sequence[Camera],
    camera_of_image: Sequence[int],
    pixels: Sequence[NDArray[np.float64]],
    verified: Sequence[tuple[Any, ...]],
    camera_from_world: Sequence[NDArray[np.float64]],
    settings: dict[str, Any],
    on_progress: Any,
    registered: Sequence[int] = ...,
    rig: dict[str, Any] | None = None,
) -> dict[str, Any]: ...

# --- gaussians ------------------------------------------------------------------------------------

SURFEL_LOG_THICKNESS: float

def harmonics_basis(degree: int, directions: ArrayLike) -> NDArray[np.float64]: ...
def eval_harmonics(directions: ArrayLike, sh: ArrayLike) -> NDArray[np.float64]: ...
def list_primitives() -> dict[str, tuple[float, bool]]: ...
def facing_axes(gaussians: _Gaussians, center: Sequence[float], sh: NDArray[Any]) -> None: ...
def facing_axes_backward(
    gaussians: _Gaussians,
    center: Sequence[float],
    dsh: NDArray[Any],
    gradients: _Gaussians,
    flatten: float = 0.0,
) -> None: ...
def seed_from_points(
    points: ArrayLike,
    colors: ArrayLike,
    gaussians: _Gaussians,
    scale_factor: float,
    opacity: float,
) -> None: ...

# --- projection -----------------------------------------------------------------------------------

class _Projection(TypedDict):
    centers: NDArray[np.float32]  # (N, 2)
    covariances: NDArray[np.float32]  # (N, 2, 2)
    extents: NDArray[np.float32]  # (N, 2)
    depths: NDArray[np.float32]  # (N,)
    status: NDArray[np.uint8]  # (N,)

class _ReferenceProjection(TypedDict):
    centers: NDArray[np.float64]  # (N, 2)
    covariances: NDArray[np.float64]  # (N, 2, 2)
    valid: NDArray[np.uint8]  # (N,)

def project(
    gaussians: _Gaussians,
    camera: Camera,
    camera_from_world: _PoseLike,
    alpha: float,
    beta: float,
    kappa: float,
    alpha_min: float,
) -> _Projection: ...
def compute_cutoffs(
    primitive: str,
    response: str,
    opacity_logits: NDArray[np.float64],
    alpha_min: float,
) -> NDArray[np.float64]: ...
def project_reference(
    gaussians: _Gaussians,
    camera: Camera,
    camera_from_world: _PoseLike,
    alpha: float,
    beta: float,
    kappa: float,
) -> _ReferenceProjection: ...
def project_ewa_reference(
    gaussians: _Gaussians, camera: Camera, camera_from_world: _PoseLike
) -> _ReferenceProjection: ...

class _MovingProjection(_ReferenceProjection):
    converged: NDArray[np.uint8]  # (N,)

def project_moving(
    gaussians: _Gaussians,
    camera: Camera,
    motion: CameraMotion,
    alpha: float,
    beta: float,
    kappa: float,
) -> _MovingProjection: ...

# --- raster ---------------------------------------------------------------------------------------

class BlendRule:
    alpha_min: float
    alpha_max: float
    response_min: float
    transmittance_min: float
    stop_before: bool
    near_z: float
    far_z: float
    order: str
    def __init__(self, parity: str = "") -> None: ...

class DistanceField:
    def __init__(
        self,
        blocks: NDArray[np.int32],
        values: NDArray[np.float32],
        center: Sequence[float],
        voxel: float,
        inner: float = ...,
    ) -> None: ...
    @property
    def blocks(self) -> NDArray[np.int32]: ...
    @property
    def values(self) -> NDArray[np.float32]: ...
    def __len__(self) -> int: ...
    def mesh(self) -> tuple[NDArray[np.float64], NDArray[np.uint32]]: ...

class TriangleTree:
    def __init__(self, vertices: NDArray[np.float64], faces: NDArray[np.uint32]) -> None: ...
    # distance and face of each query or ray
    def nearest(
        self, queries: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]: ...
    def cast(
        self, origins: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]: ...

def mesh_parts(num_vertices: int, faces: NDArray[np.uint32]) -> NDArray[np.uint32]: ...
def compare_shown(
    points: NDArray[Any],
    views: list[tuple[Camera, NDArray[Any], NDArray[np.float32], NDArray[np.float32]]],
    tolerance: float,
    most: int,
    fewest: int,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]]: ...

class Sweep:
    def __init__(self, grey: NDArray[np.float32], depths: int, cell: int) -> None: ...
    def add(
        self,
        grey: NDArray[np.float32],
        places: NDArray[np.float32],
        nearness: NDArray[np.float32] | None = None,
        shown: NDArray[np.float32] | None = None,
        trust: NDArray[np.float32] | None = None,
    ) -> None: ...
    def solve(
        self,
        counts: NDArray[np.bool_],
        contrast: float,
        step: float,
        agreement: float,
        near_step: float,
        far_step: float,
        edge: float,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...

class DepthViews:
    def __init__(self, center: Sequence[float]) -> None: ...
    def add(
        self,
        camera: Camera,
        camera_from_world: Any,
        depth: NDArray[np.float32],
        weight: NDArray[np.float32] | None,
        image: NDArray[np.uint8] | None,
    ) -> None: ...
    def support(self, which: int, others: Sequence[int], tolerance: float) -> NDArray[np.uint8]: ...
    def refine(
        self,
        which: int,
        others: Sequence[int],
        greys: list[NDArray[np.float32]],
        normals: NDArray[np.float32],
        depth: NDArray[np.float32],
    ) -> tuple[NDArray[np.float32], NDArray[np.uint8]]: ...
    def fuse(
        self, voxel: float, inner: float, truncation: float, free_weight: float, max_blocks: int
    ) -> DistanceField: ...
    def colors(self, points: NDArray[np.float64], tolerance: float) -> NDArray[np.float32]: ...
    def __len__(self) -> int: ...

class _JobKeywords(TypedDict, total=False):
    rule: BlendRule
    background: Sequence[float]  # (0.0, 0.0, 0.0)
    sh_degree: int  # 3
    unscented: Sequence[float]  # (1.0, 2.0, 0.0)
    tiles: NDArray[np.uint8] | None  # 16 x 16 pixels each; 0: left out
    keep: bool  # True: what a backward pass needs
    features: NDArray[Any] | None
    features_background: NDArray[Any] | None

class RenderJob:
    def __init__(
        self,
        camera: Camera,
        camera_from_world: _MotionLike,
        **keywords: Unpack[_JobKeywords],
    ) -> None: ...

class _BackwardKeywords(TypedDict, total=False):
    dalpha: NDArray[np.float32] | None
    ddepth: NDArray[np.float32] | None
    ddistortion: NDArray[np.float32] | None
    errors: NDArray[np.float32] | None
    error_sums: NDArray[np.float32] | None
    dfeatures: NDArray[np.float32] | None
    to_features: NDArray[np.float32] | None
    write_untouched: bool  # True
    with_poses: bool  # True
    with_lens: bool  # False
    harmonics_step: HarmonicsStep | None

class Renderer:
    def __init__(self) -> None: ...
    def render(
        self,
        gaussians: _Gaussians,
        job: RenderJob,
        image: NDArray[np.float32],
        alpha: NDArray[np.float32] | None = None,
        depth: NDArray[np.float32] | None = None,
        distortion: NDArray[np.float32] | None = None,
        features: NDArray[np.float32] | None = None,
    ) -> None: ...
    # NDArray[np.float64], or None without with_poses
    def backward(
        self,
        dimage: NDArray[np.float32],
        gradients: _Gaussians,
        touched: NDArray[np.uint8],
        **keywords: Unpack[_BackwardKeywords],
    ) -> Any: ...
    def add_significance(
        self, chosen: NDArray[np.uint8] | None, significance: NDArray[np.float64]
    ) -> tuple[NDArray[np.int32], NDArray[np.float32]]: ...  # winner, point
    def add_fisher(self, chosen: NDArray[np.uint8] | None, fisher: NDArray[np.float64]) -> None: ...
    def add_features(self, features: NDArray[np.float32], sums: NDArray[np.float32]) -> None: ...
    def add_support(
        self,
        photograph: NDArray[np.float32],
        chosen: NDArray[np.uint8] | None,
        support: NDArray[np.float64],
    ) -> None: ...
    # median, strongest (H, W), normals (H, W, 3), spread (H, W)
    def surface(self) -> tuple[NDArray[np.float32], ...]: ...
    def surface_backward(self, dnormals: NDArray[np.float32], gradients: Any) -> None: ...
    # directions and origins (H, W, 3), world axes, about the camera's centre
    def rays(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...
    # (K,) and (H, W, 3) of the last backward; None if that was without the lens.
    def lens_gradients(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None: ...
    def distances(self) -> NDArray[np.float32]: ...
    def timings(self) -> dict[str, tuple[float, float]]: ...  # wall and processor seconds
    def statistics(self) -> dict[str, int]: ...

def render_reference(
    gaussians: _Gaussians, job: RenderJob, pixels: NDArray[np.uint8] | None = None
) -> tuple[
    NDArray[Any], ...
]: ...  # image, alpha, depth, samples, distortion, and features where the job has some

class _ReferenceKeywords(TypedDict, total=False):
    dalpha: NDArray[np.float64] | None
    ddepth: NDArray[np.float64] | None
    ddistortion: NDArray[np.float64] | None
    dfeatures: NDArray[np.float64] | None
    to_features: NDArray[np.float64] | None
    pixels: NDArray[np.uint8] | None
    with_lens: bool  # False

def render_reference_backward(
    gaussians: _Gaussians,
    job: RenderJob,
    dimage: NDArray[np.float64],
    gradients: _Gaussians,
    **keywords: Unpack[_ReferenceKeywords],
) -> tuple[NDArray[np.float64], tuple[NDArray[np.float64], NDArray[np.float64]] | None]: ...

# views: (camera's index, camera_from_world, pixels (n,), colours (n, 3)).
def refine_photometric(
    gaussians: _Gaussians,
    cameras: Sequence[Camera],
    views: list[tuple[int, Any, NDArray[Any], NDArray[Any]]],
    rule: BlendRule,
    background: Sequence[float],
    sh_degree: int,
    unscented: Sequence[float],
    settings: dict[str, Any],
) -> dict[str, Any]: ...
def compute_surroundings(
    image: NDArray[Any], alpha: NDArray[Any], valid: NDArray[Any]
) -> NDArray[np.float32] | None: ...

# --- loss -----------------------------------------------------------------------------------------

class FalloffPlane:
    def __init__(self, values: NDArray[Any]) -> None: ...

class PhotometricTarget:
    def __init__(
        self,
        image: ArrayLike,
        mask: ArrayLike | None = None,
        window_rule: str = "partial",
        keep_statistics: bool = False,
    ) -> None: ...
    @property
    def height(self) -> int: ...
    @property
    def width(self) -> int: ...
    @property
    def pixels(self) -> int: ...
    @property
    def window_rule(self) -> str: ...
    @property
    def nbytes(self) -> int: ...
    def set_light(
        self, inverse_gain: Sequence[float], inverse_falloff: FalloffPlane | None = None
    ) -> None: ...
    def light_sums(
        self, image: NDArray[np.float32], bins: NDArray[np.uint8] | None = None, num_bins: int = 1
    ) -> NDArray[np.float64]: ...
    def value(
        self, image: NDArray[np.float32], ssim_weight: float = 0.2
    ) -> tuple[float, float, float]: ...

def photometric_loss(
    target: PhotometricTarget,
    image: NDArray[np.float32],
    grad_out: NDArray[np.float32] | None = None,
    ssim_weight: float = 0.2,
) -> tuple[float, NDArray[np.float32]]: ...
def surface_loss(
    maps: dict[str, Any],
    weights: Sequence[float],
    dalpha: NDArray[Any],
    ddepth: NDArray[Any],
    ddistortion: NDArray[Any],
    dnormals: NDArray[Any],
) -> list[float]: ...
def trim_gradient(
    target: PhotometricTarget, image: NDArray[np.float32], gradient: NDArray[np.float32]
) -> int: ...
def pixel_errors(
    target: PhotometricTarget,
    image: NDArray[np.float32],
    gradient: NDArray[np.float32],
    errors: NDArray[np.float32],
) -> None: ...
def photometric_loss_reference(
    target: ArrayLike,
    image: ArrayLike,
    mask: ArrayLike | None = None,
    ssim_weight: float = 0.2,
    window_rule: str = "partial",
) -> tuple[float, NDArray[np.float64]]: ...
def psnr(
    a: ArrayLike, b: ArrayLike, mask: ArrayLike | None, weights: ArrayLike | None
) -> float: ...
def ssim(a: ArrayLike, b: ArrayLike, mask: ArrayLike | None, window_rule: str) -> float: ...

# --- optimize -------------------------------------------------------------------------------------

def adam_step(
    params: list[NDArray[np.float32]],
    grads: list[NDArray[np.float32]],
    moment1: list[NDArray[np.float32]],
    moment2: list[NDArray[np.float32]],
    learning_rates: Sequence[Sequence[float]],
    step: int,
    rows: int,
    visible: NDArray[np.uint8] | None = None,
    active_columns: Sequence[int] = ...,
    beta1: float = 0.9,
    beta2: float = 0.999,
    epsilon: float = 1e-15,
) -> None: ...

class HarmonicsStep:
    def __init__(
        self,
        params: NDArray[np.float32],
        moment1: NDArray[np.float32],
        moment2: NDArray[np.float32],
        learning_rates: Sequence[float],
        step: int,
        beta1: float = 0.9,
        beta2: float = 0.999,
        epsilon: float = 1e-15,
    ) -> None: ...

def mcmc_densify(
    params: _Gaussians,
    moment1: _Gaussians,
    moment2: _Gaussians,
    size: int,
    target_size: int,
    weights: NDArray[np.float32],
    dead_opacity: float,
    seed: int,
    step: int,
) -> tuple[int, int, int]: ...
def mcmc_noise(
    params: _Gaussians,
    size: int,
    learning_rate: float,
    noise_scale: float,
    seed: int,
    step: int,
) -> None: ...
def mcmc_regularize(
    params: _Gaussians,
    size: int,
    grad_logits: NDArray[np.float32],
    grad_log_scales: NDArray[np.float32],
    opacity_weight: float,
    scale_weight: float,
) -> None: ...

class AdaptivePlan:
    def __init__(self, actions: NDArray[np.uint8]) -> None: ...
    @property
    def pruned(self) -> int: ...
    @property
    def cloned(self) -> int: ...
    @property
    def split(self) -> int: ...
    @property
    def size_after(self) -> int: ...
    @property
    def actions(self) -> NDArray[np.uint8]: ...

def plan_adaptive(
    params: _Gaussians,
    size: int,
    sums: NDArray[np.float32],
    counts: NDArray[np.int32],
    gradient_threshold: float,
    clone_scale: float,
    prune_opacity: float,
    max_scale: float,
    max_gaussians: int,
) -> AdaptivePlan: ...
def apply_adaptive(
    params: _Gaussians,
    moment1: _Gaussians,
    moment2: _Gaussians,
    size: int,
    plan: AdaptivePlan,
    seed: int,
    step: int,
) -> int: ...
def reset_opacities(
    params: _Gaussians, moment1: _Gaussians, moment2: _Gaussians, size: int, max_opacity: float
) -> None: ...
def accumulate_density(
    dl_dmeans: NDArray[np.float32],
    distances: NDArray[np.float32],
    visible: NDArray[np.uint8] | None,
    max: NDArray[np.float32],
    sum: NDArray[np.float32],
    count: NDArray[np.int32],
) -> None: ...
def herd_paper(gaussians: _Gaussians, keep: float, seed: int = 0) -> _Arrays: ...
def merge_pairs(
    gaussians: _Gaussians, target: int, weights: NDArray[np.float32] | None = None
) -> _Arrays: ...

# --- formats --------------------------------------------------------------------------------------

def read_ply(
    path: bytes,
) -> tuple[
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.float32],
    int,
    tuple[float, float, float],
]: ...
def read_ply_header(
    path: bytes,
) -> tuple[str, list[tuple[str, int, list[tuple[str, str, str]]]], list[str], int]: ...
def write_ply(
    descriptor: int,
    gaussians: _Gaussians,
    comments: Sequence[str],
    surfels: bool,
    announced: int,
) -> None: ...
def make_palette(
    rows: NDArray[np.float32], entries: int, rounds: int = ...
) -> tuple[NDArray[np.float32], NDArray[np.uint32]]: ...
def read_ply_columns(path: bytes, names: Sequence[str]) -> NDArray[np.float64]: ...
