"""A map: opened, saved, meshed and queried."""

from __future__ import annotations

import os
import warnings
from enum import IntEnum
from pathlib import Path
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _arrays, _native
from ._mesh import Mesh
from ._settings import Settings

__all__ = ["Map", "Query", "State", "Submap", "Surface"]

Surface: TypeAlias = Literal["measured", "occupied", "free", "frontier"]
"""Kinds of surfaces: `measured` is that of the signed distances (of occupied space in maps without them); `occupied` bounds occupied space, `free`
bounds free space, and `frontier` is the part of that which adjoins unknown space."""


class State(IntEnum):
    """What is known about a point of a map with occupancy."""

    UNKNOWN = 0
    """Never observed, or the observations cancel out."""
    FREE = 1
    """Observed to be empty."""
    OCCUPIED = 2
    """Observed to be occupied."""


class Query(NamedTuple):
    """What a map knows about N points."""

    distance: NDArray[np.float32]
    """N signed distances to the nearest surface, metres, positive in front of it. They are known in the truncation band around surfaces; NaN elsewhere."""
    gradient: NDArray[np.float32]
    """N x 3 gradients of the distance, map frame, towards free space; zero where the distance is known on one side of the point only, or not at all."""
    state: NDArray[np.uint8]
    """N values of `State`; `State.UNKNOWN` everywhere in maps without occupancy."""

    @property
    def observed(self) -> NDArray[np.bool_]:
        """N truth values: whether the map knows anything about the point, a distance or whether it is free."""
        return np.asarray(~np.isnan(self.distance) | (self.state != State.UNKNOWN), dtype=np.bool_)


class Submap(NamedTuple):
    """A rigid part of a map."""

    id: int
    """Its number."""
    pose: NDArray[np.float64]
    """The submap frame in the map frame, 4 x 4. A correction changes this."""
    nodes: list[int]
    """The nodes whose scans it was made from, in that order."""


class Map:
    """A map, in memory. It does not change: threads may share it.

    Coordinates are metres in the map frame. Long calls let other threads run, and Ctrl-C ends them.
    """

    __slots__ = ("__weakref__", "_inner")
    _inner: _native.Map

    def __init__(self) -> None:
        raise TypeError("a Map is opened with Map.open(path), or comes from a Mapper")

    @classmethod
    def _of(cls, native: _native.Map) -> Map:
        this = object.__new__(cls)
        this._inner = native
        return this

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> Map:
        """Opens a map that was saved, a directory such as `hall.vox`, and loads all of it.

        Args:
            path: The directory.

        Raises:
            FileNotFoundError: There is nothing of this name.
            FileError: It is no map, or it is damaged, or it was written by a newer version.
        """
        path = Path(path)
        if not path.exists():
            raise FileNotFoundError(f"{path}: there is nothing of this name; expected the directory of a map")
        native, refused = _native.Map.open(path)
        for problem in refused:
            warnings.warn(f"{path}: the map has a setting that this version does not know: {problem}", stacklevel=2)
        return cls._of(native)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Saves the map as a directory. A map that is there already is replaced, at once and completely; its unchanged parts are not written again.

        Args:
            path: The directory; its name usually ends with `.vox`.

        Raises:
            FileError: Something else is there, or another process writes to it, or the disk is full.
        """
        self._inner.save(Path(path))

    @property
    def settings(self) -> Settings:
        """The settings that the map was made with."""
        return Settings.from_text(dict(self._inner.settings()))

    @property
    def voxel_size(self) -> float:
        """Edge of the finest voxel, metres."""
        return self.settings.voxel_size

    @property
    def sensor(self) -> str | None:
        """Description of the sensor, if known."""
        return self._inner.sensor()

    @property
    def submaps(self) -> list[Submap]:
        """The rigid parts of the map, by number."""
        return [Submap(number, np.array(pose), nodes) for number, pose, nodes in self._inner.submaps()]

    @property
    def bounds(self) -> NDArray[np.float32] | None:
        """Smallest and largest coordinates of all that was observed, 2 x 3, metres; none for an empty map."""
        bounds = self._inner.bounds()
        return None if bounds is None else np.array(bounds, dtype=np.float32)

    @property
    def has_distances(self) -> bool:
        """Whether the map has signed distances: it was made with `field` `tsdf` or `both`."""
        return self._inner.fields()[0]

    @property
    def has_occupancy(self) -> bool:
        """Whether the map has free, occupied and unknown space: it was made with `field` `occupancy` or `both`."""
        return self._inner.fields()[1]

    @property
    def nbytes(self) -> int:
        """Memory of the voxels, bytes."""
        return self._inner.nbytes()

    def mesh(self, *, lod: int = 0, min_weight: float = 1.0, surface: Surface = "measured", shells: bool = False, close_gaps: bool = True) -> Mesh:
        """The surface of the whole map. Overlapping submaps are fused, so that a place has one surface.

        Args:
            lod: Level of detail: 0 is full resolution, 3 has vertices eight voxels apart.
            min_weight: Smallest number of observations of a voxel that contributes to a measured surface.
            surface: Which surface.
            shells: Do not fuse: the measured surfaces of all submaps on top of each other. Surfaces of occupancy are always those of the submaps.
            close_gaps: Close gaps of one voxel.

        Returns:
            The mesh; without triangles if the map has no such surface.
        """
        if lod not in (0, 1, 2, 3):
            raise ValueError(f"lod: expected 0, 1, 2 or 3, not {lod!r}")
        if not 0 <= min_weight <= 1000:
            raise ValueError(f"min_weight: expected a number from 0 to 1000, not {min_weight!r}")
        if surface not in ("measured", "occupied", "free", "frontier"):
            raise ValueError(f'surface: expected "measured", "occupied", "free" or "frontier", not {surface!r}')
        return Mesh(*self._inner.mesh(surface, int(lod), float(min_weight), bool(close_gaps), bool(shells)))

    def query(self, points: ArrayLike) -> Query:
        """Distances to surfaces with their gradients, and whether space is free.

        Where submaps overlap, the distance is the one nearest to zero, and a point is occupied if it is so in any submap.

        Args:
            points: N x 3 coordinates in the map frame, metres. About points that are not finite, nothing is known.

        Raises:
            ValueError: The array has another shape.
        """
        return Query(*self._inner.query(_arrays.points(points)))

    def __repr__(self) -> str:
        fields = [name for name, has in (("distances", self.has_distances), ("occupancy", self.has_occupancy)) if has]
        submaps = self._inner.submaps()
        scans = sum(len(nodes) for _, _, nodes in submaps)
        parts = [f"{scans:,} scans", f"{len(submaps):,} submaps", f"voxels of {self.voxel_size:g} m", " and ".join(fields) or "empty", f"{self.nbytes / 1e6:.1f} MB"]
        return f"Map({', '.join(parts)})"
