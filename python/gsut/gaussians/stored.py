"""Gaussians that stay in their file: an image reads only those that it may show."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from gsut._core import InputError
from gsut.bounds import check_vector
from gsut.gaussians.arrays import Gaussians
from gsut.gaussians.cone import LEAST_ALPHA, compute_reach, find_seen
from gsut.gaussians.morton import order_by_morton_code

# Rows of a piece, which is read whole or not at all: some 60 KB, worth a read of its own.
_ROWS = 256
# Pieces read at once, at most.
_READ_PIECES = 64
# Borders between classes of reach, in medians of it. Each class has pieces of its own, since a few
# large Gaussians would make the ball of every piece as large.
_SIZES = (4.0, 16.0, 64.0)
# Bytes that changing its size takes beside these.
_CHANGE_BYTES = 250


@dataclasses.dataclass(frozen=True, eq=False)
class StoredGaussians:
    """N Gaussians in a file, with a bounding ball of each piece of 256 rows.

    `gsut.render` draws them to the same bits as if all were in memory.

    Attributes:
        rows: reads the Gaussians of rows [begin, end), about `origin`.
        count: N.
        origin: (3,) float64, see `Gaussians`.
        sh_degree: of all.
        limit: bytes that the Gaussians of one image may take.
        balls: (pieces, 4) centre and radius, about `origin`.
        change: applied to Gaussians after reading them, or None.
    """

    rows: Callable[[int, int], Gaussians]
    count: int
    origin: np.ndarray
    sh_degree: int
    limit: int
    balls: np.ndarray
    change: Callable[[Gaussians], Any] | None = None
    _last: dict[bytes, Any] = dataclasses.field(default_factory=dict, repr=False)

    LEAST_ALPHA: ClassVar[float] = LEAST_ALPHA
    # Bytes that drawing takes for a Gaussian beside its own numbers.
    DRAWN_BYTES: ClassVar[int] = 300

    def order_by_centers(self) -> StoredGaussians:
        """Returns themselves: files of another order are read into memory."""
        return self

    @staticmethod
    def order_rows(gaussians: Gaussians) -> np.ndarray:
        """Returns (N,) rows in an order that keeps neighbours of similar size together."""
        reach = compute_reach(gaussians)
        sizes = np.searchsorted(np.array(_SIZES) * np.median(reach), reach) if len(reach) else reach
        groups = [np.flatnonzero(sizes == size) for size in range(len(_SIZES) + 1)]
        ordered = [
            rows[order_by_morton_code(gaussians.means[rows])] for rows in groups if len(rows)
        ]
        return np.concatenate([np.zeros(0, np.int64), *ordered])

    @classmethod
    def from_rows(
        cls, rows: Callable[[int, int], Gaussians], count: int, limit: int
    ) -> StoredGaussians | None:
        """Reads all pieces once to bound them; returns None if some cannot be drawn.

        Args:
            rows, count, limit: see the attributes.
        """
        first, balls = rows(0, min(count, 1)), []
        for begin in range(0, count, _ROWS * _READ_PIECES):
            some = rows(begin, min(count, begin + _ROWS * _READ_PIECES))
            reach, means = compute_reach(some), some.means.astype(np.float64)
            if not all(np.isfinite(a).all() for a in (means, reach, some.quats, some.sh)):
                return None
            if not some.quats.any(axis=1).all():
                return None
            for at in range(0, len(some), _ROWS):
                piece = means[at : at + _ROWS]
                center = 0.5 * (piece.min(axis=0) + piece.max(axis=0))
                away = np.linalg.norm(piece - center, axis=1) + reach[at : at + _ROWS]
                balls.append((*center, away.max()))
        bound = np.array(balls).reshape(-1, 4)
        return cls(rows, count, first.origin, first.sh_degree, limit, bound)

    def __len__(self) -> int:
        return self.count

    def __repr__(self) -> str:
        return f"StoredGaussians({self.count}, sh_degree={self.sh_degree}, in a file)"

    def with_change(self, change: Callable[[Gaussians], Any]) -> StoredGaussians:
        """Returns the same Gaussians with `change` applied to all that is read."""
        return dataclasses.replace(self, change=change, _last={})

    def translate(self, by: np.typing.ArrayLike) -> StoredGaussians:
        """Moves the Gaussians by a vector (3,) in world units."""
        return dataclasses.replace(self, origin=self.origin + check_vector(by, "by"), _last={})

    def to_gaussians(self) -> Gaussians:
        """Raises InputError: the Gaussians do not fit in memory."""
        raise InputError(
            f"this needs all {self.count:,} Gaussians in memory: free some, or take a smaller "
            "scene (gsut compact)"
        )

    def estimate_bytes(self, pieces: np.ndarray) -> int:
        """Estimates the memory that drawing these pieces takes."""
        extra = self.DRAWN_BYTES + (0 if self.change is None else _CHANGE_BYTES)
        return len(pieces) * _ROWS * (count_bytes_per_gaussian(self.sh_degree) + extra)

    def find_seen_pieces(
        self, apex: np.ndarray, around: float, rays: np.ndarray, margin: float
    ) -> np.ndarray:
        """Finds the pieces that rays may see, in rising order.

        Args:
            apex: (3,) about `origin`.
            around: radius about the apex in which the rays begin.
            rays: (n, 3) unit vectors. margin: angle about them that counts as seen, radians.
        """
        offset, reach = self.balls[:, :3] - apex, self.balls[:, 3] + around
        return np.flatnonzero(find_seen(offset, reach, rays, margin))

    def read(self, pieces: np.ndarray) -> Any:
        """Reads the Gaussians of pieces, in the file's order; caches those of the last call."""
        key = pieces.tobytes()
        if key not in self._last:
            self._last.clear()
            out = self._read(pieces)
            self._last[key] = out if self.change is None else self.change(out)
        return self._last[key]

    def _read(self, pieces: np.ndarray) -> Gaussians:
        ends = np.minimum((pieces + 1) * _ROWS, self.count)
        total = int((ends - pieces * _ROWS).sum())
        k = (self.sh_degree + 1) ** 2
        shapes = {"means": (3,), "quats": (4,), "log_scales": (3,), "opacity_logits": (),
                  "sh": (k, 3)}  # fmt: skip
        arrays: dict[str, Any] = {
            name: np.empty((total, *shape), np.float32) for name, shape in shapes.items()
        }
        place, at = 0, 0
        while at < len(pieces):
            last = at + 1  # a run of pieces that stand together is one read
            while (
                last < min(len(pieces), at + _READ_PIECES) and pieces[last] == pieces[last - 1] + 1
            ):
                last += 1
            some = self.rows(int(pieces[at]) * _ROWS, int(ends[last - 1]))
            for name, array in arrays.items():
                array[place : place + len(some)] = getattr(some, name)
            place, at = place + len(some), last
        return Gaussians(**arrays, origin=self.origin)


def count_bytes_per_gaussian(sh_degree: int) -> int:
    """Counts the bytes of one Gaussian's numbers, each a float32."""
    mean, quaternion, log_scales, opacity_logit = 3, 4, 3, 1
    harmonics = 3 * (sh_degree + 1) ** 2
    return 4 * (mean + quaternion + log_scales + opacity_logit + harmonics)
