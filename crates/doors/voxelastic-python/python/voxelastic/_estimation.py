"""Poses of scans: from the scans before them, or in a map."""

from __future__ import annotations

import os
import pathlib
import warnings
from typing import Any, Literal, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _arrays, _native
from ._arrays import Points
from ._dataset import Dataset
from ._map import Map
from ._progress import Progress, reported

__all__ = ["Localiser", "Location", "Odometry", "OdometryReport", "Trajectory", "odometry"]


class OdometryReport(NamedTuple):
    """What became of a scan."""

    pose: NDArray[np.float64]
    """The lidar frame at the time of the scan in the frame of the piece's first scan, 4 x 4; of a scan that failed, what was expected."""
    status: Literal["first", "registered", "degenerate", "failed"]
    """`first`: it begins a piece; `degenerate`: its surfaces do not hold the pose along some direction, as in a tunnel; `failed`: see `problem`."""
    piece: int
    """Number of the trajectory's piece, from 0: no odometry leads from one to the next."""
    is_keyframe: bool
    """Whether the sensor moved far enough since the last keyframe that the scan is one."""
    overlap: float
    """Share of the scan's surfaces with a counterpart among those before, 0 to 1."""
    spread: float
    """Robust mean distance between the two, metres."""
    information: NDArray[np.float64]
    """6 x 6 information of the pose: translation (1 / m^2) before rotation (1 / rad^2), in the lidar frame. It says how well the scan lies on those before, not how far these have drifted."""
    covariance: NDArray[np.float64]
    """6 x 6 covariance of the error of the pose since the first scan of the piece, drift included: translation (m^2) before rotation (rad^2), in the lidar frame; zero if it was not registered."""
    problem: str | None
    """Why it failed, if it did."""


class Odometry:
    """Finds the poses of scans, one after the other, from the scans alone. Threads may share it: they take turns.

    Args:
        voxel_size: Edge of the finest voxels of the local map, metres; by default it follows the ranges of the first scan, 0.2 to 0.7.
        min_range: Nearest return that is used, metres.
        max_range: Farthest return that is used, metres.
        deskew: Compensate the motion of the sensor during a sweep, where points have times.

    Raises:
        ValueError: A size or a range is not more than 0.
    """

    __slots__ = ("__weakref__", "_inner")

    def __init__(self, *, voxel_size: float | None = None, min_range: float = 0.5, max_range: float = 100.0, deskew: bool = True) -> None:
        for value, name in ((voxel_size, "voxel_size"), (min_range, "min_range"), (max_range, "max_range")):
            if value is not None and not (value > 0 and np.isfinite(value)):
                raise ValueError(f"{name}: expected metres, more than 0, not {value!r}")
        self._inner = _native.Odometry(voxel_size, float(min_range), float(max_range), bool(deskew))

    def register(self, points: Points, *, time: float | None = None, times: ArrayLike | None = None) -> OdometryReport:
        """Registers a scan to those before it.

        Args:
            points: N x 3 coordinates in the lidar frame, metres; or rows x columns x 3. Points that are zero or not finite are beams without return.
            time: Time stamp of the scan, seconds; by default scans are equally far apart in time.
            times: N times of the points in seconds after `time`.

        Raises:
            ValueError: An array has another shape.
        """
        cloud, rows = _arrays.cloud(points)
        stamps = None if times is None else _arrays.channel(times, "times", len(cloud), np.float32)
        pose, status, piece, is_keyframe, overlap, spread, information, covariance, problem = self._inner.register(
            cloud, rows, None if time is None else float(time), stamps
        )
        return OdometryReport(
            np.array(pose), cast("Any", status), piece, is_keyframe, overlap, spread, np.array(information), np.array(covariance), problem
        )


class Trajectory(NamedTuple):
    """Poses over time."""

    times: NDArray[np.float64]
    """N time stamps, seconds."""
    poses: NDArray[np.float64]
    """N x 4 x 4 poses of the lidar frame."""
    pieces: NDArray[np.int64]
    """N numbers of the pieces that the poses belong to, from 0. Each piece has a frame of its own."""

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a text file: `.tum` (time x y z qx qy qz qw), or else rows of 3 x 4 matrices as KITTI has them."""
        path = pathlib.Path(path)
        if path.suffix == ".tum":
            rows = [[time, *_arrays.pose(pose)] for time, pose in zip(self.times, self.poses, strict=True)]
            np.savetxt(path, np.array(rows).reshape(-1, 8), fmt="%.9f")
        else:
            np.savetxt(path, self.poses[:, :3].reshape(-1, 12), fmt="%.9e")


def odometry(data: Dataset | str | os.PathLike[str], *, progress: Progress = None, **settings: Any) -> Trajectory:
    """The trajectory of a recording or a folder from its scans alone. Poses in it are not used, nor is an inertial measurement unit: a mapper and the command
    `voxelastic odometry` use that.

    Args:
        data: The data, or its path.
        progress: How far it is: see `Progress`.
        settings: Those of `Odometry`.

    Returns:
        The poses of the scans that could be registered; of others a warning says why.

    Raises:
        FileError: The data cannot be read.
    """
    scans = data if isinstance(data, Dataset) else Dataset.open(data, slam=True)
    tracker = Odometry(**settings)
    times, poses, pieces = [], [], []
    with reported(progress, scans.scan_count, "scan") as done:
        for scan in scans:
            report = tracker.register(scan.points, time=scan.time, times=scan.times)
            if report.problem is None:
                times.append(scan.time)
                poses.append(report.pose)
                pieces.append(report.piece)
            else:
                warnings.warn(f"scan {scan.node} has no pose: {report.problem}", stacklevel=2)
            done(1)
    return Trajectory(np.array(times), np.array(poses).reshape(-1, 4, 4), np.array(pieces, dtype=np.int64))


class Location(NamedTuple):
    """Where in a map a scan was taken."""

    pose: NDArray[np.float64]
    """The lidar frame in the map frame, 4 x 4."""
    is_certain: bool
    """Whether enough of the scan's surfaces are in the map, and nearly none of them where it is free, or the other way round, and no other place fits as well. A scan that sees less of the circle must fit better."""
    overlap: float
    """Share of the scan's surfaces with a counterpart in the map, 0 to 1."""
    contradiction: float
    """Share of surfaces in space that was observed to be free, 0 to 1: of the map's in the scan's, or of the scan's in the map's, whichever is larger."""
    spread: float
    """Robust mean distance of the scan's surfaces to those of the map, metres."""
    information: NDArray[np.float64] | None
    """6 x 6 information of the pose: translation (1 / m^2) before rotation (1 / rad^2), in the lidar frame; none where the pose was not refined, as those of alternatives."""
    alternatives: list[Location]
    """Other places that the scan was compared with more closely, best first: where one is nearly as good, the place is ambiguous."""

    @property
    def covariance(self) -> NDArray[np.float64] | None:
        """6 x 6 covariance of the pose: translation (m^2) before rotation (rad^2), in the lidar frame; infinite where the surfaces do not hold it. None without `information`."""
        if self.information is None:
            return None
        values, vectors = np.linalg.eigh(self.information)
        if values[0] <= 1e-12 * values[-1]:
            return np.full((6, 6), np.inf)
        covariance: NDArray[np.float64] = (vectors / values) @ vectors.T
        return covariance


class Localiser:
    """Finds scans in a map that has surfaces, from an unknown start: places that look like the scan from above, then registration to the best of them.

    Args:
        map: The map. Its search is prepared by the first scan.

    Raises:
        ValueError: The map has no surfaces.
    """

    __slots__ = ("__weakref__", "_inner")

    def __init__(self, map: Map) -> None:
        inner = _native.Localiser.of_map(map._inner)
        if inner is None:
            raise ValueError('map: it has no surfaces; make it with field="tsdf" or field="both"')
        self._inner = inner

    def locate(
        self, points: Points, *, times: ArrayLike | None = None, guess: ArrayLike | None = None, within: float = 10.0
    ) -> Location | None:
        """Where a scan was taken; none if it has no returns or fits nowhere.

        Args:
            points: N x 3 coordinates in the lidar frame, metres; or rows x columns x 3.
            times: N times of the points, seconds.
            guess: About where, x, y, z in the map frame; by default anywhere.
            within: Largest distance from the guess, metres.

        Raises:
            ValueError: An array has another shape.
        """
        cloud, rows = _arrays.cloud(points)
        stamps = None if times is None else _arrays.channel(times, "times", len(cloud), np.float32)
        near = None
        if guess is not None:
            if not (within > 0 and np.isfinite(within)):
                raise ValueError(f"within: expected metres, more than 0, not {within!r}")
            near = (_arrays.doubles([guess], "guess")[0].tolist(), float(within))
        found = [_location(*native) for native in self._inner.locate(cloud, rows, stamps, near)]
        return found[0]._replace(alternatives=found[1:]) if found else None


def _location(pose: list[list[float]], is_certain: bool, overlap: float, contradiction: float, spread: float, information: list[list[float]] | None) -> Location:
    return Location(np.array(pose), is_certain, overlap, contradiction, spread, None if information is None else np.array(information), [])
