"""Triangle meshes as arrays."""

from __future__ import annotations

import dataclasses
import importlib
import os
import pathlib
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _arrays, _native
from ._arrays import Points

__all__ = ["Mesh"]


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Mesh:
    """A triangle mesh in metres of the map frame, counted from `origin`. Vertices are shared between triangles; the arrays are yours to change."""

    vertices: NDArray[np.float32]
    """V x 3 positions, metres."""
    triangles: NDArray[np.int32]
    """T x 3 indices of vertices, counter-clockwise seen from free space."""
    normals: NDArray[np.float32]
    """V x 3 unit normals, towards free space."""
    scales: NDArray[np.uint8]
    """V integration scales: the voxels there have edges of 2^scale finest voxels. For surfaces of occupancy all 0."""
    intensity: NDArray[np.uint8] | None
    """V intensities; none if the scans had none."""
    colours: NDArray[np.uint8] | None
    """V x 3 colours, sRGB; none if the scans had none."""
    origin: NDArray[np.float64] = dataclasses.field(default_factory=lambda: np.zeros(3))
    """What vertices are counted from, a point (x, y, z) in the frame of the poses, metres: `vertices + origin` in double precision is where they are there. Zero unless
    the map was made far from zero, as with UTM coordinates: see `Map.origin`."""

    def __len__(self) -> int:
        """Number of triangles."""
        return len(self.triangles)

    def __repr__(self) -> str:
        extras = [name for name in ("intensity", "colours") if getattr(self, name) is not None]
        return f"Mesh({len(self.vertices):,} vertices, {len(self):,} triangles{''.join(f', {name}' for name in extras)})"

    def distance(self, points: Points, *, up_to: float = np.inf) -> NDArray[np.float32]:
        """Distances from points to the nearest triangle, for example of scans that were not mapped.

        Args:
            points: N x 3 coordinates in the map frame, metres.
            up_to: The largest distance of interest, metres: less is faster.

        Returns:
            N distances, metres; infinity beyond `up_to`, NaN for points that are not finite.

        Raises:
            ValueError: The mesh has no triangles, or the array has another shape.
        """
        places = np.ascontiguousarray(_arrays.points(points), dtype=np.float32)
        vertices, triangles = np.ascontiguousarray(self.vertices), np.ascontiguousarray(self.triangles)
        return _native.mesh_distances(vertices, triangles, places, float(up_to))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the mesh to a file, with normals, colours and intensity where there are any, in the frame of the poses: `origin` is added.

        Args:
            path: The file; its ending says the format: `.ply` (binary, in double precision if there is an origin) or `.glb`.

        Raises:
            FileError: The ending is another, or the file cannot be written.
        """
        vertices, triangles = np.ascontiguousarray(self.vertices, dtype=np.float32), np.ascontiguousarray(self.triangles, dtype=np.uint32)
        colours = None if self.colours is None else np.ascontiguousarray(self.colours, dtype=np.uint8)
        intensity = None if self.intensity is None else self.intensity.astype(np.float32)
        normals = np.ascontiguousarray(self.normals, dtype=np.float32)
        _native.write_mesh(pathlib.Path(path), vertices, triangles, normals, colours, intensity, [float(c) for c in self.origin])

    def vertex_colours(self) -> NDArray[np.uint8]:
        """V x 3 colours to draw the mesh with: those of the scans, or grey by intensity, or by height."""
        if self.colours is not None:
            return self.colours
        if self.intensity is not None:
            return np.repeat(self.intensity[:, None], 3, axis=1)
        heights = self.vertices[:, 2]
        low, high = np.quantile(heights, [0.01, 0.99]) if len(heights) else (0.0, 1.0)
        share = np.clip((heights - low) / max(float(high - low), 0.01), 0, 1)[:, None]
        ramp = np.array([[0.15, 0.25, 0.45], [0.3, 0.6, 0.45], [0.85, 0.8, 0.5], [0.95, 0.95, 0.95]])
        place = share * (len(ramp) - 1)
        below = np.minimum(place.astype(np.int64), len(ramp) - 2)[:, 0]
        mixed = ramp[below] + (ramp[below + 1] - ramp[below]) * (place - below[:, None])
        return np.asarray(np.round(255 * mixed), dtype=np.uint8)

    def to_open3d(self) -> Any:
        """The mesh as `open3d.geometry.TriangleMesh`, with normals and colours. Needs the package open3d.

        Raises:
            ImportError: open3d is not installed.
        """
        open3d: Any = importlib.import_module("open3d")

        mesh = open3d.geometry.TriangleMesh(
            open3d.utility.Vector3dVector(self.vertices.astype(np.float64)), open3d.utility.Vector3iVector(self.triangles)
        )
        mesh.vertex_normals = open3d.utility.Vector3dVector(self.normals.astype(np.float64))
        mesh.vertex_colors = open3d.utility.Vector3dVector(self.vertex_colours() / 255.0)
        return mesh

    def to_trimesh(self) -> Any:
        """The mesh as `trimesh.Trimesh`, with normals and colours; vertices and triangles keep their order. Needs the package trimesh.

        Raises:
            ImportError: trimesh is not installed.
        """
        trimesh: Any = importlib.import_module("trimesh")

        return trimesh.Trimesh(self.vertices, self.triangles, vertex_normals=self.normals, vertex_colors=self.vertex_colours(), process=False)
