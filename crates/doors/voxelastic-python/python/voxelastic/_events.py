"""What comes to a mapper: scans, edges and corrected poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple, NoReturn, Optional, TypeAlias, TypeVar, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _arrays, _native
from ._arrays import Points, Pose

__all__ = ["Edge", "Event", "PoseUpdate", "Scan"]

_CHANNELS = ("intensity", "colours", "ring", "times")

_Array = TypeVar("_Array", bound=Optional[NDArray[Any]])


def _read_only(array: _Array) -> _Array:
    """The array, which cannot be written to from now on."""
    if array is not None:
        array.setflags(write=False)
    return array


class Scan:
    """A scan: of a data set, or made of arrays, for `Mapper.handle`. It does not change: attributes cannot be set, and its arrays cannot be written to; `replace` gives a scan
    that differs, and `scan.points.copy()` points of your own.

    `Scan(points, pose)` is what `Mapper.integrate(points, pose)` takes, as a value. Arrays are copied.

    Args:
        points: N x 3 coordinates in the lidar frame, metres; or rows x columns x 3 for an organised cloud. Points that are zero or not finite are beams without return.
        pose: The lidar frame in the map frame. Without it, the mapper estimates it.
        node: Number of the scan's node; by default the mapper counts on from the scan before.
        time: Time stamp, seconds; by default 0.1 more than that of the scan before.
        intensity: N strengths of the returns in the sensor's own scale.
        colours: N x 3 colours, sRGB, 0 to 255; [0, 0, 0] where a point has none.
        ring: N numbers of the beams' rings, from 0.
        times: N times of the points in seconds after `time`.
        motion: Poses of the lidar during the sweep, in the lidar frame at `time`, each with its time in seconds after that.

    Raises:
        ValueError: An array has another shape, or the pose is not rigid.
    """

    __slots__ = ("__weakref__", "_inner", "_node", "_pose", "_time")
    _inner: _native.Scan
    _node: int | None
    _time: float | None
    _pose: NDArray[np.float64] | None

    def __init__(
        self,
        points: Points,
        pose: Pose | None = None,
        *,
        node: int | None = None,
        time: float | None = None,
        intensity: ArrayLike | None = None,
        colours: ArrayLike | None = None,
        ring: ArrayLike | None = None,
        times: ArrayLike | None = None,
        motion: Sequence[tuple[float, Pose]] | None = None,
    ) -> None:
        exact = None if pose is None else _arrays.pose(pose)
        channels = {"intensity": intensity, "colours": colours, "ring": ring, "times": times, "motion": motion}
        self._make(points, exact, node, time, channels, None)

    def _make(
        self, points: Points, exact: NDArray[np.float64] | None, node: int | None, time: float | None, channels: dict[str, Any], before: _native.Scan | None
    ) -> None:
        """Makes it of these, and of what `before` has beside them. Without an entry, the motion stays."""
        cloud, rows = _arrays.cloud(points)
        number, stamp = None if node is None else _arrays.node(node), None if time is None else _arrays.time(time)
        keeps_motion = "motion" not in channels
        given = _arrays.channels(cloud, **{"motion": None, **channels})
        self._set(_native.Scan.of(number or 0, stamp or 0.0, exact, cloud, rows, given, before, keeps_motion), number, stamp)

    def _set(self, inner: _native.Scan, node: int | None, time: float | None) -> None:
        pose = inner.stamp()[2]
        for name, value in (("_inner", inner), ("_node", node), ("_time", time), ("_pose", None if pose is None else _constant(pose))):
            object.__setattr__(self, name, value)

    @classmethod
    def _of(cls, native: _native.Scan) -> Scan:
        this = object.__new__(cls)
        node, time, _ = native.stamp()
        this._set(native, node, time)
        return this

    def __setattr__(self, name: str, _: object) -> NoReturn:
        raise AttributeError(f"{name}: a scan does not change; `scan.replace({name}=...)` gives one that differs")

    def __delattr__(self, name: str) -> NoReturn:
        raise AttributeError(f"{name}: a scan does not change")

    def replace(self, **changes: Any) -> Scan:
        """The same scan with some changes, given as the arguments of `Scan`: `scan.replace(pose=corrected)`; None takes something away. All else stays, to the last bit.

        Raises:
            ValueError: There are more points or fewer, and what the scan has for each point was not given anew; or a value is not one that `Scan` takes.
        """
        known = ("points", "pose", "node", "time", *_CHANNELS, "motion")
        if unknown := sorted(changes.keys() - set(known)):
            raise TypeError(f"replace: there is no {', '.join(unknown)}; expected some of {', '.join(known)}")
        points, node, time = (changes.get(name, getattr(self, name)) for name in ("points", "node", "time"))
        channels = {name: changes.get(name, getattr(self, name)) for name in _CHANNELS}
        count = len(_arrays.cloud(points)[0])
        if lacking := [name for name in _CHANNELS if name not in changes and channels[name] is not None and count != len(self)]:
            raise ValueError(f"points: expected {len(self):,}, as before, not {count:,}; or with them {', '.join(lacking)}, or None for these")
        if "motion" in changes:
            channels["motion"] = changes["motion"]
        pose = changes.get("pose", ...)
        exact = self._inner.exact_pose() if pose is ... else None if pose is None else _arrays.pose(pose)
        this = object.__new__(type(self))
        this._make(points, exact, node, time, channels, self._inner)
        return this

    @property
    def node(self) -> int | None:
        """Its node in the pose graph; none if it was made without: the mapper counts on."""
        return self._node

    @property
    def time(self) -> float | None:
        """Time stamp, seconds; none if it was made without."""
        return self._time

    @property
    def pose(self) -> NDArray[np.float64] | None:
        """The lidar frame in the map frame when the scan was taken, 4 x 4, as the data have it; none if they do not. It cannot be written to."""
        return self._pose

    @property
    def shape(self) -> tuple[int, int]:
        """Rows (rings) and columns of the cloud; (1, N) if it is not organised."""
        return self._inner.shape()

    @property
    def points(self) -> NDArray[np.float32]:
        """Coordinates in the lidar frame, metres: rows x columns x 3 of an organised cloud, else N x 3. NaN or zero: a beam without return."""
        points, (rows, columns) = self._inner.points(), self.shape
        return _read_only(points.reshape(rows, columns, 3) if rows > 1 else points)

    @property
    def intensity(self) -> NDArray[np.float32] | None:
        """N strengths of the returns in the sensor's own scale; none if the data have none. N counts row by row."""
        return _read_only(self._inner.channels()[0])

    @property
    def colours(self) -> NDArray[np.uint8] | None:
        """N x 3 colours, sRGB; none if the data have none."""
        return _read_only(self._inner.channels()[1])

    @property
    def ring(self) -> NDArray[np.uint16] | None:
        """N numbers of the beams' rings; none if the data have none."""
        return _read_only(self._inner.channels()[2])

    @property
    def times(self) -> NDArray[np.float32] | None:
        """N times of the points in seconds after `time`; none if the data have none."""
        return _read_only(self._inner.channels()[3])

    def undistorted(self) -> Scan | None:
        """The same scan, corrected for the motion of the lidar during the sweep; none if that or the times of the points are unknown.

        A mapper does this itself.
        """
        native = self._inner.undistorted()
        return None if native is None else Scan._of(native)

    def __len__(self) -> int:
        """Number of points, with or without return."""
        rows, columns = self.shape
        return rows * columns

    def __repr__(self) -> str:
        rows, columns = self.shape
        place = "" if self.pose is None else ", at {:.2f}, {:.2f}, {:.2f} m".format(*self.pose[:3, 3])
        node = "" if self.node is None else f"node {self.node}, "
        return f"Scan({node}{f'{rows} x {columns}' if rows > 1 else f'{columns:,}'} points{place})"


class Edge(NamedTuple):
    """A measured pose between two nodes."""

    first: int
    """A node."""
    second: int
    """Another node."""
    pose: NDArray[np.float64]
    """The lidar frame of `second` in that of `first`, 4 x 4; cannot be written to."""
    closes_loop: bool
    """Whether the same place was observed at both; otherwise they are consecutive."""
    information: Optional[NDArray[np.float64]] = None
    """6 x 6 information of the pose: translation (1 / m^2) before rotation (1 / rad^2); none if the data have none."""


class PoseUpdate(NamedTuple):
    """Corrected poses."""

    poses: Mapping[int, NDArray[np.float64]]
    """The lidar frame in the map frame, 4 x 4, of each node; cannot be written to."""


class _EdgeOfData(Edge):
    """An edge as the data have it, to the last bit."""

    exact: Optional[NDArray[np.float64]] = None
    """x, y, z, qx, qy, qz, qw of the pose, unless it was replaced."""

    def __reduce__(self) -> Any:
        return Edge, tuple(self)


class _PoseUpdateOfData(PoseUpdate):
    """Corrected poses as the data have them, to the last bit."""

    exact: Optional[list[NDArray[np.float64]]] = None
    """x, y, z, qx, qy, qz, qw of each pose, unless they were replaced."""

    def __reduce__(self) -> Any:
        return PoseUpdate, (dict(self.poses),)


# For users there is one type of each.
_EdgeOfData.__name__ = _EdgeOfData.__qualname__ = "Edge"
_PoseUpdateOfData.__name__ = _PoseUpdateOfData.__qualname__ = "PoseUpdate"


Event: TypeAlias = Union[Scan, Edge, PoseUpdate]
"""What a SLAM system reports, in the order in which it happens."""


def _constant(pose: Any) -> NDArray[np.float64]:
    """A matrix that cannot be written to."""
    matrix = np.array(pose)
    matrix.setflags(write=False)
    return matrix


def _event(kind: str, value: Any) -> Event:
    """An event of the native part."""
    match kind:
        case "scan":
            return Scan._of(value)
        case "poses":
            update = _PoseUpdateOfData(MappingProxyType({node: _constant(pose) for node, pose, _ in value}))
            update.exact = [np.array(numbers) for _, _, numbers in value]
            return update
    first, second, pose, numbers, triangle = value
    information = None
    if triangle is not None:
        upper = np.zeros((6, 6))
        upper[np.triu_indices(6)] = triangle
        information = upper + np.triu(upper, 1).T
    edge = _EdgeOfData(first, second, _constant(pose), kind == "loop", information)
    edge.exact = np.array(numbers)
    return edge
