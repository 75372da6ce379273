"""The scene's parameters as numpy arrays."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, cast

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.bounds import check_vector
from gsut.gaussians.cone import compute_reach, find_seen
from gsut.gaussians.surfels import are_pressed, press_shortest, press_surfels

NO_ORIGIN = np.zeros(3)
NO_ORIGIN.setflags(write=False)
# First coefficient of the harmonics' basis: a colour is 0.5 + SH_C0 x sh + ...
SH_C0 = 0.28209479177387814
_MAXIMUM = "maximum"  # everyone's response
_DISTANCE = "distance"  # the order of models that do not say theirs
_GAUSSIAN = "gaussian"  # everyone's primitive
# Primitive -> its width at half its response over a Gaussian's, and whether it is flat.
_PRIMITIVES = _core.list_primitives()
_Arrays = TypeVar("_Arrays", bound="ParameterArrays")


class ParameterArrays:
    """Methods of dataclasses of arrays, a row a Gaussian, `means` and `sh` (N, K, 3) among them."""

    means: np.ndarray
    sh: np.ndarray
    origin: np.ndarray

    def list_arrays(self) -> list[str]:
        """Lists the names of the arrays."""
        return [field.name for field in dataclasses.fields(cast(Any, self))]

    def read_arrays(self, origin: np.ndarray, widths: dict[str, tuple[int, ...]]) -> None:
        """Reads the arrays, C-contiguous and of one dtype, and checks their shapes (N, *width).

        Raises:
            InputError: shapes disagree.
        """
        self.origin = np.array(origin, np.float64)
        arrays = {name: _core.read_array(getattr(self, name), name) for name in self.list_arrays()}
        dtype = np.float64 if arrays["means"].dtype == np.float64 else np.float32
        for name, array in arrays.items():
            setattr(self, name, np.ascontiguousarray(array, dtype=dtype))
        n = len(self.means)
        k = self.sh.shape[1] if self.sh.ndim == 3 else 0
        if k not in (1, 4, 9, 16):
            raise InputError(
                f"sh must have shape (N, K, 3) with K 1, 4, 9 or 16, found {self.sh.shape}"
            )
        expected = {name: (n, *width) for name, width in widths.items()}
        for name, shape in {**expected, "sh": (n, k, 3), "origin": (3,)}.items():
            found = getattr(self, name).shape
            if found != shape:
                raise InputError(f"{name} must have shape {shape}, found {found}")

    def __len__(self) -> int:
        return len(self.means)

    def __repr__(self) -> str:
        size = sum(getattr(self, name).nbytes for name in self.list_arrays()) / 1e6
        kind = f"{type(self).__name__}({len(self)}, sh_degree={self.sh_degree}"
        return f"{kind}, {self.dtype}, {size:.1f} MB)"

    @property
    def dtype(self) -> np.dtype:
        """float32 or float64, the same for all arrays."""
        return self.means.dtype

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return {1: 0, 4: 1, 9: 2, 16: 3}[self.sh.shape[1]]

    def to_dtype(self: _Arrays, dtype: np.typing.DTypeLike) -> _Arrays:
        """Converts to float32 or float64; returns itself if that is its dtype."""
        if np.dtype(dtype) == self.dtype:
            return self
        return self._with({name: getattr(self, name).astype(dtype) for name in self.list_arrays()})

    def with_origin(self: _Arrays, origin: np.typing.ArrayLike) -> _Arrays:
        """Returns the same Gaussians with their means relative to `origin` (3,), world coordinates.

        `with_origin((0, 0, 0)).means` are world coordinates, rounded to the arrays' dtype.
        """
        origin = np.asarray(origin, np.float64)
        if np.array_equal(origin, self.origin):
            return self
        means = (self.means + (self.origin - origin)).astype(self.dtype)
        return dataclasses.replace(cast(Any, self), means=means, origin=origin)

    def __getitem__(self: _Arrays, rows: slice | np.ndarray) -> _Arrays:
        """Selects rows by a slice (views, no copy) or by an index or boolean array."""
        return self._with({name: getattr(self, name)[rows] for name in self.list_arrays()})

    def order_by_centers(self: _Arrays) -> _Arrays:
        """Returns them in an order of means: those along the ray by the distance.

        Depths of surfaces, scores, features and derivatives for poses have no order along the ray.
        """
        if getattr(self, "order", _DISTANCE) != "ray":
            return self
        return dataclasses.replace(cast(Any, self), order=_DISTANCE)

    def make_zeros(self: _Arrays) -> _Arrays:
        """Makes arrays of the same shapes with all values 0, for gradients."""
        # np.zeros instead of np.zeros_like, which writes its zeros: unwritten pages take no memory.
        arrays = {name: getattr(self, name) for name in self.list_arrays()}
        return self._with({name: np.zeros(a.shape, a.dtype) for name, a in arrays.items()})

    def copy(self: _Arrays) -> _Arrays:
        """Returns a deep copy."""
        return self._with({name: getattr(self, name).copy() for name in self.list_arrays()})

    def _with(self: _Arrays, arrays: dict[str, Any]) -> _Arrays:
        return dataclasses.replace(cast(Any, self), **arrays)


@dataclasses.dataclass(repr=False)
class Gaussians(ParameterArrays):
    """N anisotropic 3D Gaussians as a structure of arrays.

    Args:
        means: (N, 3) centres: world coordinates = origin + means.
        quats: (N, 4) rotations w, x, y, z of any norm > 0; normalised where used.
        log_scales: (N, 3) natural logarithm of the standard deviations along the rotated axes.
        opacity_logits: (N,) opacity = 1 / (1 + exp(-logit)).
        sh: (N, K, 3) spherical harmonics of degree 0 to 3 (K = 1, 4, 9, 16);
            colour = 0.5 + sum of basis times sh, clamped at 0 from below.
        origin: (3,) float64, world coordinates of the means' zero, for scenes too far from the
            world's zero for float32; nothing else depends on it.
        response: the rule that the Gaussians are drawn by, with G = exp(-D^2 / 2), D the smallest
            Mahalanobis distance along a ray. "maximum": alpha = opacity x G, as 3DGS and its
            viewers do. "extinction": alpha = 1 - (1 - opacity)^G, as matter that absorbs light.
            "density": the optical depth also follows the Gaussian's length along the ray, relative
            to the harmonic mean of its scales; drawn in float64 only.
        order: in which they are blended unless a render says another, see `gsut.render`:
            "distance", "z" or "ray".
        primitive: how the response falls with D in place of G, see docs/primitives.md. "gaussian";
            "triangle": flat, 1 - g / r with the gauge g of a triangle; its third scale is not read.

    Arrays are stored C-contiguous, as float64 if `means` is float64 and as float32 otherwise.

    Raises:
        InputError: shapes disagree, or the response, the order or the primitive is unknown.
    """

    PRIMITIVES: ClassVar[tuple[str, ...]] = tuple(
        sorted(_PRIMITIVES, key=lambda name: (name != _GAUSSIAN, name))
    )
    RESPONSES: ClassVar[tuple[str, ...]] = (_MAXIMUM, "extinction", "density")
    ORDERS: ClassVar[tuple[str, ...]] = (_DISTANCE, "z", "ray")
    means: np.ndarray
    quats: np.ndarray
    log_scales: np.ndarray
    opacity_logits: np.ndarray
    sh: np.ndarray
    if TYPE_CHECKING:
        origin: np.ndarray = NO_ORIGIN
        response: str = dataclasses.field(default=_MAXIMUM, kw_only=True)
        order: str = dataclasses.field(default=_DISTANCE, kw_only=True)
        primitive: str = dataclasses.field(default=_GAUSSIAN, kw_only=True)
    else:  # not of the fields, which are arrays of N rows; `dataclasses.replace` keeps them
        origin: dataclasses.InitVar[np.ndarray] = NO_ORIGIN
        response: dataclasses.InitVar[str] = dataclasses.field(default=_MAXIMUM, kw_only=True)
        order: dataclasses.InitVar[str] = dataclasses.field(default=_DISTANCE, kw_only=True)
        primitive: dataclasses.InitVar[str] = dataclasses.field(default=_GAUSSIAN, kw_only=True)

    def __post_init__(
        self,
        origin: np.ndarray = NO_ORIGIN,  # noqa: RUF033
        response: str = _MAXIMUM,  # noqa: RUF033
        order: str = _DISTANCE,  # noqa: RUF033
        primitive: str = _GAUSSIAN,  # noqa: RUF033
    ) -> None:
        for kind, name, known in (
            ("response", response, self.RESPONSES),
            ("order", order, self.ORDERS),
            ("primitive", primitive, self.PRIMITIVES),
        ):
            if name not in known:
                raise InputError(f'{kind} "{name}" is unknown; known: {", ".join(known)}')
        self.response, self.order, self.primitive = response, order, primitive
        widths = {"means": (3,), "quats": (4,), "log_scales": (3,), "opacity_logits": ()}
        self.read_arrays(origin, widths)

    @property
    def rule(self) -> dict[str, Any]:
        """Returns response, order and primitive, as keywords of `Gaussians`."""
        return {name: getattr(self, name) for name in ("response", "order", "primitive")}

    @property
    def are_surfels(self) -> bool:
        """Whether every third scale is that of a thin disc."""
        return are_pressed(self.log_scales)

    def to_surfels(self) -> Gaussians:
        """Flattens them: the shortest axis becomes the normal, and its scale is dropped.

        Arrays that do not change are not copied.
        """
        quats, log_scales = press_shortest(self.quats, self.log_scales)
        return dataclasses.replace(self, quats=quats, log_scales=log_scales)

    def to_primitive(self, primitive: str) -> Gaussians:
        """Draws them as another primitive, as wide where responses are a half; others are equal.

        What becomes flat loses its shortest axis, and what was flat becomes surfels.
        """
        if primitive == self.primitive:
            return self
        width, was_flat = _PRIMITIVES[self.primitive]
        new_width, is_flat = _PRIMITIVES[primitive]
        drawn = self.to_surfels() if is_flat and not was_flat else self
        drawn = dataclasses.replace(drawn, primitive=primitive)
        drawn.log_scales = drawn.log_scales + self.dtype.type(np.log(width / new_width))
        if was_flat:
            press_surfels(drawn.log_scales)
        return drawn

    def translate(self, by: np.typing.ArrayLike) -> Gaussians:
        """Moves the Gaussians by a vector (3,) in world units: exact, only the origin changes."""
        return dataclasses.replace(self, origin=self.origin + check_vector(by, "by"))

    def select_seen(
        self, apex: np.ndarray, rays: np.ndarray, margin: float, around: float = 0.0
    ) -> Gaussians:
        """Selects the Gaussians that rays may see: all of those, and some that they do not.

        Args:
            apex: (3,) where the rays begin, about `origin`.
            rays: (n, 3) unit vectors in the world's axes.
            margin: angle about the cone around the rays that counts as seen, radians.
            around: radius about the apex in which the rays begin.
        """
        reach = compute_reach(self) + around
        return self[find_seen(self.means - apex, reach, rays, margin)]


@dataclasses.dataclass(repr=False)
class LinearGaussians(ParameterArrays):
    """Gaussians whose scales and opacities are as they are, for programs that keep them so.

    They are rendered as `Gaussians` are, gradients are to these arrays; an opacity of exactly 0 or
    1 has one, too. Training, files and compaction take `Gaussians`.

    Args:
        means: (N, 3) centres: world coordinates = origin + means.
        quats: (N, 4) rotations w, x, y, z of any norm > 0; normalised where used.
        scales: (N, 3) standard deviations along the rotated axes, 0 or more; 0: not drawn.
        opacities: (N,) from 0 to 1.
        sh: (N, K, 3) spherical harmonics of the colour, see `Gaussians`; None: grey, for renders
            of `features` only.
        origin: (3,) float64, world coordinates of the means' zero.

    Arrays are stored as `Gaussians` stores them.

    Raises:
        InputError: shapes disagree, or a scale or an opacity is out of range.
    """

    means: np.ndarray
    quats: np.ndarray
    scales: np.ndarray
    opacities: np.ndarray
    sh: np.ndarray = None  # type: ignore[assignment]  # an array once it is made
    if TYPE_CHECKING:
        origin: np.ndarray = NO_ORIGIN
    else:
        origin: dataclasses.InitVar[np.ndarray] = NO_ORIGIN

    def __post_init__(self, origin: np.ndarray = NO_ORIGIN) -> None:  # noqa: RUF033
        if self.sh is None:
            self.sh = np.zeros((len(self.means), 1, 3), np.float32)
        widths = {"means": (3,), "quats": (4,), "scales": (3,), "opacities": ()}
        self.read_arrays(origin, widths)
        for name in ("scales", "opacities"):
            values = getattr(self, name)
            low, high = values.min(initial=0.0), values.max(initial=0.0)
            most = 1.0 if name == "opacities" else np.finfo(self.dtype).max
            if not (low >= 0.0 and high <= most):
                raise InputError(
                    f"{name} must lie from 0 to {most:.3g}, found {low:.6g} to {high:.6g}; "
                    "logarithms and logits belong into gsut.Gaussians"
                )
