"""Simulated scans of exactly known worlds."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _arrays, _native
from ._arrays import Points
from ._dataset import Dataset
from ._events import Event, Scan, _event

__all__ = ["Simulation"]


class Simulation:
    """A LiDAR on a route through an exactly known world, with drifting odometry and loop closures. The map frame is the world's frame.

    `for scan in simulation` gives the scans with their true poses, `simulation[k]` one of them; they are computed when they are asked for. `events()` gives what
    a SLAM system would report. The same arguments give the same scans: a copy, or one that was pickled, is made
    from them.

    Args:
        world: One of `Simulation.worlds()`: `campus` (135 x 225 m), `mine`, `street`, `district` (a square kilometre), and for tests `room`, `plane` and `sphere`.
        scans: Number of scans; by default enough to cover the world and to revisit places.
        spacing: Distance between two scans, metres.
        rate: Scans per second, instead of a distance between them.
        sensor: Name of a preset, as for the setting `sensor`.
        columns: Number of columns of a revolution; by default that of the preset.
        max_range: Largest range, metres.
        noise: Factor on the noise of the sensor (1 cm near, 3 cm at 100 m, lost returns, mixed pixels at edges); 0 for exact ranges.
        moving: The sensor moves during a sweep: each column has its own time and pose.
        drift: Drift of the odometry, metres per 100 m of path.
        loop_radius: Largest distance to an earlier pose that closes a loop, metres; 0 for no loops.
        seed: A whole number that furniture, noise and drift follow from.

    Raises:
        ValueError: There is no such world or sensor, or a number is out of range.
    """

    __slots__ = ("__weakref__", "_arguments", "_inner", "_world")

    def __init__(
        self,
        world: str = "campus",
        *,
        scans: int | None = None,
        spacing: float = 2.0,
        rate: float | None = None,
        sensor: str = "os1-64",
        columns: int | None = None,
        max_range: float = 120.0,
        noise: float = 1.0,
        moving: bool = False,
        drift: float = 1.0,
        loop_radius: float = 5.0,
        seed: int = 1,
    ) -> None:
        self._arguments = {name: value for name, value in locals().items() if name != "self"}
        self._world = world
        self._inner = _native.Simulation(
            world, scans, float(spacing), rate, sensor, columns, float(max_range), float(noise), bool(moving), float(drift), float(loop_radius), int(seed)
        )

    @staticmethod
    def worlds() -> list[str]:
        """The names of the worlds."""
        return _native.world_names()

    @property
    def times(self) -> NDArray[np.float64]:
        """N time stamps, seconds."""
        return np.array(self._inner.poses()[2])

    @property
    def true_poses(self) -> NDArray[np.float64]:
        """N x 4 x 4: the lidar frame in the map frame at the time of each scan."""
        return np.array(self._inner.poses()[0])

    @property
    def odometry_poses(self) -> NDArray[np.float64]:
        """N x 4 x 4: the same by the drifting odometry; the first is the true one."""
        return np.array(self._inner.poses()[1])

    def events(self) -> Iterator[Event]:
        """What a SLAM system would report, in order: scans with drifting poses, odometry and loop edges, corrected poses. `Mapper.handle` takes them."""
        for k in range(len(self)):
            yield from (_event(*item) for item in self._inner.events(k))

    def distance(self, points: Points) -> NDArray[np.float64]:
        """N exact signed distances from N x 3 points to the nearest surface of the world, metres, negative in solids (to a depth of 1 m)."""
        return self._inner.distance(_arrays.doubles(points, "points"))

    def surface(self, spacing: float = 0.05, *, max_range: float = 60.0) -> NDArray[np.float32]:
        """The surface that the sensor can see within `max_range` metres of its route: M x 3 points, one in each cube of `spacing` metres."""
        if not (0.001 <= spacing <= 100 and 0 < max_range):
            raise ValueError(f"spacing, max_range: expected metres, 0.001 or more and more than 0, not {spacing!r} and {max_range!r}")
        return self._inner.surface(float(spacing), float(max_range))

    def write(self, path: str | os.PathLike[str]) -> Dataset:
        """Writes scans, poses, edges and corrections as a folder, and opens it.

        Args:
            path: The folder; it must be empty or not be there yet.

        Raises:
            FileError: There is something, or it cannot be written.
        """
        self._inner.write(pathlib.Path(path))
        return Dataset.open(path)

    def __len__(self) -> int:
        return self._inner.len()

    def __getitem__(self, index: int) -> Scan:
        k = int(index) + (len(self) if index < 0 else 0)
        if not 0 <= k < len(self):
            raise IndexError(f"there are {len(self)} scans, and none with number {index}")
        return Scan._of(self._inner.scan(k))

    def __iter__(self) -> Iterator[Scan]:
        return (self[k] for k in range(len(self)))

    def __reduce__(self) -> tuple[Any, ...]:
        return _made, (self._arguments,)

    def __repr__(self) -> str:
        return f"Simulation({self._world!r}, {len(self):,} scans)"


def _made(arguments: dict[str, Any]) -> Simulation:
    """The simulation of these arguments."""
    return Simulation(**arguments)
