"""Triangle meshes: parts, cuts, holes, normals, colours."""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut import _core
from gsut._core import InputError


@dataclasses.dataclass(frozen=True)
class Mesh:
    """Triangles in the dataset's coordinates.

    Attributes:
        vertices: (V, 3) float64.
        faces: (F, 3) uint32, counterclockwise seen from outside; (0, 3): a cloud of points.
        colors: (V, 3) float32 in [0, 1], as displayed; None without.
    """

    vertices: np.ndarray
    faces: np.ndarray
    colors: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.faces)

    def __repr__(self) -> str:
        colored = "" if self.colors is None else ", colours"
        return f"Mesh({len(self.vertices):,} vertices, {len(self.faces):,} faces{colored})"

    def _gather_corners(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return a, b, c

    def compute_face_vectors(self) -> np.ndarray:
        """Returns the normals (F, 3) of the faces, as long as twice their areas."""
        a, b, c = self._gather_corners()
        return np.cross(b - a, c - a)

    def compute_normals(self) -> np.ndarray:
        """Averages unit normals (V, 3) of the vertices from faces by area; 0 without a face."""
        of_faces = self.compute_face_vectors()
        sums = np.stack(
            [
                sum(
                    np.bincount(self.faces[:, k], of_faces[:, axis], len(self.vertices))
                    for k in range(3)
                )
                for axis in range(3)
            ],
            axis=1,
        )
        return sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-300)

    def with_faces(self, keep: np.ndarray) -> Mesh:
        """Keeps some faces, and the vertices that they use.

        Args:
            keep: (F,) bool.
        """
        faces = self.faces[keep]
        used = np.zeros(len(self.vertices), bool)
        used[faces] = True
        renamed = np.cumsum(used) - 1
        colors = None if self.colors is None else self.colors[used]
        return Mesh(self.vertices[used], renamed[faces].astype(np.uint32), colors)

    def without_small_parts(self, share: float) -> Mesh:
        """Removes connected parts of less than this share of all faces."""
        if not len(self.faces):
            return self
        labels = _core.mesh_parts(len(self.vertices), self.faces)[self.faces[:, 0]]
        _, of_face, sizes = np.unique(labels, return_inverse=True, return_counts=True)
        return self.with_faces(sizes[of_face] >= share * len(self.faces))

    def crop(self, low: np.ndarray, high: np.ndarray) -> Mesh:
        """Keeps the faces whose middles lie within a box (two corners (3,))."""
        a, b, c = self._gather_corners()
        middle = (a + b + c) / 3
        return self.with_faces(np.all((middle >= low) & (middle <= high), axis=1))

    def list_edges(self) -> np.ndarray:
        """Lists (3 F, 2) the edges of all faces, in the direction in which each goes around."""
        pairs = [self.faces[:, pair] for pair in ((0, 1), (1, 2), (2, 0))]
        return np.concatenate(pairs).astype(np.int64)

    def close_holes(self, most: int) -> Mesh:
        """Closes the holes of up to `most` edges, each by faces about one vertex in its middle.

        Raises:
            InputError: the mesh has colours, which the new vertices would lack.
        """
        if self.colors is not None:
            raise InputError("holes are closed before a mesh gets colours")
        loops = [loop for loop in self._list_rims() if len(loop) <= most]
        middles = [self.vertices[loop].mean(axis=0) for loop in loops]
        fans = [
            np.stack([loop, np.roll(loop, -1), np.full_like(loop, len(self.vertices) + number)], 1)
            for number, loop in enumerate(loops)
        ]
        return Mesh(
            np.concatenate([self.vertices, np.reshape(middles, (-1, 3))]),
            np.concatenate([self.faces, *fans]).astype(np.uint32),
        )

    def _list_rims(self) -> list[np.ndarray]:
        """Lists the vertices around each hole, in the direction of faces that would close it.

        Where holes touch in a vertex, each is listed for itself.
        """
        edges = self.list_edges()
        count = len(self.vertices)
        there, back = edges @ [count, 1], edges @ [1, count]
        following: dict[int, list[int]] = {}
        for end, begin in edges[~np.isin(there, back)].tolist():
            following.setdefault(begin, []).append(end)
        rims: list[np.ndarray] = []
        path: list[int] = []
        place: dict[int, int] = {}
        while following:
            at = path[-1] if path else next(iter(following))
            if at not in following:  # an edge of three faces: no hole
                path, place = [], {}
                continue
            if not path:
                path, place = [at], {at: 0}
            ahead = following[at].pop()
            if not following[at]:
                del following[at]
            if ahead not in place:
                place[ahead] = len(path)
                path.append(ahead)
                continue
            begin = place[ahead]
            rims.append(np.array(path[begin:]))
            for vertex in path[begin + 1 :]:
                del place[vertex]
            path = path[: begin + 1] if begin else []
            if not path:
                place = {}
        return [rim for rim in rims if len(rim) > 2]
