"""Triangle meshes as arrays."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

__all__ = ["Mesh"]


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Mesh:
    """A triangle mesh in metres of the map frame. Vertices are shared between triangles; the arrays are yours to change."""

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

    def __len__(self) -> int:
        """Number of triangles."""
        return len(self.triangles)

    def __repr__(self) -> str:
        extras = [name for name in ("intensity", "colours") if getattr(self, name) is not None]
        return f"Mesh({len(self.vertices):,} vertices, {len(self):,} triangles{''.join(f', {name}' for name in extras)})"
