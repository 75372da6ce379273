"""Gaussians that each store harmonics of their own degree, 0 to 3."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

from gsut._core import InputError
from gsut.gaussians.arrays import NO_ORIGIN, Gaussians

# Degrees change at multiples of this number of rows, so that each vector of the core has one.
_ROWS_TOGETHER = 16
# Highest degree of harmonics that a scene may have.
_MAX_DEGREE = 3
# Share of the harmonics that packing must save to be done.
_WORTH = 0.1


@dataclasses.dataclass
class MixedGaussians:
    """N Gaussians in falling order of their harmonics' degree.

    Renders and trains like `to_gaussians()`, to the same bits, in less memory and time.

    Args:
        means, quats, log_scales, opacity_logits: as in `Gaussians`, float32.
        sh: (S,) float32: the (degree + 1)^2 coefficients of three channels of each Gaussian, one
            Gaussian after the other.
        degree_ends: entry d: the number of Gaussians of degree d or more; entry 0 is N.
        origin, response, order, primitive: as in `Gaussians`; of primitives without shapes.

    Raises:
        InputError: shapes disagree.
    """

    means: np.ndarray
    quats: np.ndarray
    log_scales: np.ndarray
    opacity_logits: np.ndarray
    sh: np.ndarray
    degree_ends: tuple[int, ...]
    if TYPE_CHECKING:
        origin: np.ndarray = NO_ORIGIN
        response: str = dataclasses.field(default=Gaussians.RESPONSES[0], kw_only=True)
        order: str = dataclasses.field(default=Gaussians.ORDERS[0], kw_only=True)
        primitive: str = dataclasses.field(default=Gaussians.PRIMITIVES[0], kw_only=True)
    else:
        origin: dataclasses.InitVar[np.ndarray] = NO_ORIGIN
        response: dataclasses.InitVar[str] = dataclasses.field(
            default=Gaussians.RESPONSES[0], kw_only=True
        )
        order: dataclasses.InitVar[str] = dataclasses.field(
            default=Gaussians.ORDERS[0], kw_only=True
        )
        primitive: dataclasses.InitVar[str] = dataclasses.field(
            default=Gaussians.PRIMITIVES[0], kw_only=True
        )

    def __post_init__(
        self,
        origin: np.ndarray = NO_ORIGIN,  # noqa: RUF033
        response: str = Gaussians.RESPONSES[0],  # noqa: RUF033
        order: str = Gaussians.ORDERS[0],  # noqa: RUF033
        primitive: str = Gaussians.PRIMITIVES[0],  # noqa: RUF033
    ) -> None:
        self.response, self.order, self.primitive = response, order, primitive
        self.origin = np.array(origin, np.float64)
        ends = self.degree_ends
        if (
            len(ends) != _MAX_DEGREE + 1
            or ends[0] != len(self.means)
            or sorted(ends)[::-1] != [*ends]
        ):
            raise InputError(f"degree_ends must be 4 falling numbers from N, found {ends}")
        floats = sum(3 * (2 * degree + 1) * end for degree, end in enumerate(ends))
        if self.sh.shape != (floats,):
            raise InputError(f"sh must have shape ({floats},), found {self.sh.shape}")

    def list_arrays(self) -> list[str]:
        """Returns the names of the arrays."""
        return [*_GEOMETRY, "sh"]

    def __len__(self) -> int:
        return len(self.means)

    @property
    def dtype(self) -> np.dtype:
        """float32."""
        return self.means.dtype

    @property
    def sh_degree(self) -> int:
        """The highest degree."""
        return max(degree for degree, end in enumerate(self.degree_ends) if end or degree == 0)

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return sum(getattr(self, name).nbytes for name in self.list_arrays())

    def to_dtype(self, dtype: np.typing.DTypeLike) -> Any:
        """Returns itself for float32, and `Gaussians` for float64, which the reference takes."""
        if np.dtype(dtype) == np.float32:
            return self
        return self.to_gaussians().to_dtype(dtype)

    def order_by_centers(self) -> MixedGaussians:
        """Returns them in an order of means, as `Gaussians.order_by_centers`."""
        return dataclasses.replace(self, order="distance") if self.order == "ray" else self

    def copy(self) -> MixedGaussians:
        """Returns a deep copy."""
        return dataclasses.replace(
            self, **{name: getattr(self, name).copy() for name in self.list_arrays()}
        )

    def make_zeros(self) -> MixedGaussians:
        """Makes arrays of the same shapes with all values 0, for gradients and moments."""
        return dataclasses.replace(
            self, **{name: np.zeros_like(getattr(self, name)) for name in self.list_arrays()}
        )

    def split_bands(self) -> list[tuple[slice, np.ndarray]]:
        """Splits by degree, from the highest: the rows, and (n, K, 3) a view of their sh."""
        found, begin, offset = [], 0, 0
        for degree in range(_MAX_DEGREE, -1, -1):
            end = self.degree_ends[degree]
            if end > begin:
                k = (degree + 1) ** 2
                stop = offset + 3 * k * (end - begin)
                sh = self.sh[offset:stop].reshape(end - begin, k, 3)
                found.append((slice(begin, end), sh))
                begin, offset = end, stop
        return found

    def to_gaussians(self) -> Gaussians:
        """Returns them with zeros for harmonics that are not stored; rows keep their order."""
        sh = np.zeros((len(self), (self.sh_degree + 1) ** 2, 3), np.float32)
        for rows, band in self.split_bands():
            sh[rows, : band.shape[1]] = band
        arrays = (self.means, self.quats, self.log_scales, self.opacity_logits, sh)
        rule = {name: getattr(self, name) for name in _RULE}
        return Gaussians(*arrays, self.origin, **rule)


_RULE = ("response", "order", "primitive")
_GEOMETRY = ("means", "quats", "log_scales", "opacity_logits")


def find_used_degrees(gaussians: Gaussians) -> np.ndarray:
    """Finds (N,) uint8 the highest degree of each Gaussian with a coefficient that is not 0."""
    degrees = np.zeros(len(gaussians), np.uint8)
    for degree in range(1, gaussians.sh_degree + 1):
        band = gaussians.sh[:, degree * degree : (degree + 1) ** 2]
        degrees[np.any(band != 0, axis=(1, 2))] = degree
    return degrees


def to_mixed(gaussians: Gaussians, degrees: np.ndarray | None = None) -> MixedGaussians:
    """Drops the harmonics above each Gaussian's degree.

    Args:
        gaussians: N Gaussians.
        degrees: (N,) of each; None: `find_used_degrees`. At each change of degree up to 15
            Gaussians keep the higher one.

    Returns:
        The Gaussians in falling order of degree, otherwise in the same order.
    """
    g = gaussians.to_dtype(np.float32)
    degrees = find_used_degrees(g) if degrees is None else np.minimum(degrees, g.sh_degree)
    order = np.argsort(-degrees.astype(np.int64), kind="stable")
    ends = [len(g)]
    for degree in range(1, _MAX_DEGREE + 1):
        count = int(np.count_nonzero(degrees >= degree))
        ends.append(min(len(g), -(-count // _ROWS_TOGETHER) * _ROWS_TOGETHER))
    pieces, begin = [], 0
    for degree in range(_MAX_DEGREE, -1, -1):
        rows = order[begin : ends[degree]]
        pieces.append(g.sh[rows, : (degree + 1) ** 2].reshape(-1))
        begin = max(begin, ends[degree])
    return MixedGaussians(
        g.means[order], g.quats[order], g.log_scales[order], g.opacity_logits[order],
        np.concatenate(pieces), tuple(ends), g.origin, **{name: getattr(g, name) for name in _RULE},
    )  # fmt: skip


def pack_harmonics(gaussians: Any) -> Any:
    """Packs Gaussians as `MixedGaussians` if that saves a tenth of the harmonics or more."""
    if not isinstance(gaussians, Gaussians) or gaussians.sh_degree == 0 or len(gaussians) == 0:
        return gaussians
    if gaussians.dtype != np.float32 or gaussians.shapes is not None:
        return gaussians
    degrees = find_used_degrees(gaussians).astype(np.int64)
    if np.sum((degrees + 1) ** 2) > (1 - _WORTH) * len(degrees) * gaussians.sh.shape[1]:
        return gaussians
    return to_mixed(gaussians, degrees)
