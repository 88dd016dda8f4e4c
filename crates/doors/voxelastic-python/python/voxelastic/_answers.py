"""What maps answer."""

from __future__ import annotations

from collections.abc import Iterable
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Blocks", "Merged", "Path", "Query", "RayHits", "Slice", "State", "Submap", "SubmapChanges"]


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
    """N x 3 gradients of the distance, metres per metre, map frame, towards free space; zero where the distance is known on one side of the point only, or not at all."""
    state: NDArray[np.uint8]
    """N values of `State`; `State.UNKNOWN` everywhere in maps without occupancy."""

    @property
    def observed(self) -> NDArray[np.bool_]:
        """N truth values: whether the map knows anything about the point, a distance or whether it is free."""
        return np.asarray(~np.isnan(self.distance) | (self.state != State.UNKNOWN), dtype=np.bool_)


class RayHits(NamedTuple):
    """Where N rays end."""

    distance: NDArray[np.float64]
    """N distances from the origin, metres; NaN where a ray meets nothing."""
    normal: NDArray[np.float64]
    """N x 3 normals of the voxel faces that the rays enter by, map frame; zero where a ray starts in what blocks it, or meets nothing."""
    state: NDArray[np.uint8]
    """N values of `State`: `State.OCCUPIED`, or `State.UNKNOWN` where unknown space blocks, or where a ray meets nothing."""


class Slice(NamedTuple):
    """A cross-section of a map: `plt.imshow(slice.values, origin="lower", extent=slice.extent)`."""

    values: NDArray[Any]
    """Rows x columns, the row with the smallest coordinate first: values of `State`, or distances in metres with NaN where none is known."""
    extent: tuple[float, float, float, float]
    """Left, right, bottom and top edge of the picture, metres."""


class Path(NamedTuple):
    """A path for a robot."""

    points: NDArray[np.float64]
    """N x 3 waypoints of the robot's centre, map frame, metres, joined by straight lines that are free."""
    length: float
    """Its length, metres."""
    clearance: NDArray[np.float64]
    """N distances of the waypoints to the nearest obstacle, metres; at most 2 m beyond the radius."""
    least_clearance: float
    """The least such distance anywhere along the path, metres."""


class Blocks(NamedTuple):
    """Blocks of voxels of one size, in a submap."""

    coordinates: NDArray[np.int32]
    """N x 3: of the first voxel of each block, in finest voxels of the submap frame. Blocks are cubes of eight finest voxels along each axis."""
    distance: NDArray[np.float32]
    """N x E x E x E signed distances at the centres of the voxels, metres, indexed by z, y, x; NaN where nothing was observed. E is 8, 4, 2 or 1."""
    weight: NDArray[np.float32]
    """N x E x E x E sums of the observations' weights; 0 where nothing was observed."""
    voxel_size: float
    """Edge of the voxels, metres."""


class Submap(NamedTuple):
    """A rigid part of a map."""

    id: int
    """Its number."""
    pose: NDArray[np.float64]
    """The submap frame in the map frame, 4 x 4. A correction changes this."""
    nodes: list[int]
    """The nodes whose scans it was made from, in that order."""
    revision: int
    """Number of changes of its voxels in this process: what was made of them, such as a mesh, is up to date while it is the same."""


class SubmapChanges(NamedTuple):
    """What has become of the submaps of a map since an earlier moment: their numbers."""

    changed: list[int]
    """Those that are new, or whose voxels have changed: their meshes are out of date."""
    moved: list[int]
    """Those of the others whose pose has changed: their meshes are to be moved."""
    gone: list[int]
    """Those that are no more: they were fused into others."""


class Merged(NamedTuple):
    """Where a map lies in the one that it was added to."""

    sessions: list[int]
    """Numbers of its sessions there."""
    by: str
    """What told it: `frame`, `pose`, or `places`, by which it was recognised."""
    pose: NDArray[np.float64]
    """The frame of its poses in that of the other map, 4 x 4."""
    loop_edges: int
    """Number of loop edges to the sessions before."""
    bent: float
    """By how much it was bent to fit, at most, metres: the drift that it came with."""


def _submaps(native: list[tuple[int, list[list[float]], list[int], int]]) -> list[Submap]:
    return [Submap(number, np.array(pose), nodes, revision) for number, pose, nodes, revision in native]


def _changes(before: Iterable[Submap], now: Iterable[Submap]) -> SubmapChanges:
    """What has become of submaps."""
    was, are = {submap.id: submap for submap in before}, {submap.id: submap for submap in now}
    changed = [number for number, submap in are.items() if number not in was or was[number].revision != submap.revision]
    moved = [number for number, submap in are.items() if number not in changed and not np.array_equal(was[number].pose, submap.pose)]
    return SubmapChanges(changed, moved, [number for number in was if number not in are])
