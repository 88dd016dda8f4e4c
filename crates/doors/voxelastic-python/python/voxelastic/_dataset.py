"""Folders and recordings of scans, with poses or without."""

from __future__ import annotations

import operator
import os
import threading
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast, overload

import numpy as np
from numpy.typing import NDArray

from . import _arrays, _native
from ._arrays import Pose
from ._errors import RunWarning
from ._events import Event, Scan, _event

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["Dataset"]


class Dataset:
    """Scans of a folder or a recording with their poses, in any layout that the command reads. Clouds are read one by one, a little ahead.

    Where the data have no poses, `pose` of the scans is none, and a mapper estimates them.

    `for scan in dataset` gives the scans, as often as you like, and `dataset[k]` one of them; `events()` gives the edges of the pose graph and the corrections of poses, too.
    `with Dataset.open(path) as dataset` closes its files at the end of the block. A copy, or one that was pickled, opens the same data anew.
    """

    __slots__ = ("__weakref__", "_cursor", "_inner", "_lock", "_options", "_path", "_strict")
    _inner: _native.Dataset | None
    _cursor: tuple[int, _native.Events] | None
    _lock: threading.Lock
    _options: dict[str, Any]
    _path: Path
    _strict: bool

    def __init__(self) -> None:
        raise TypeError("a Dataset is opened with Dataset.open(path)")

    @classmethod
    def open(
        cls,
        path: str | os.PathLike[str],
        *,
        poses: str | os.PathLike[str] | None = None,
        odometry: bool = False,
        graph: str | os.PathLike[str] | None = None,
        t_base_lidar: Pose | Sequence[Pose] | None = None,
        every: str | int | None = None,
        cloud_topic: str | Sequence[str] | None = None,
        also: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
        pose_topic: str | None = None,
        metadata: str | os.PathLike[str] | None = None,
        point_times: str = "",
        time_tolerance: float = 0.01,
        strict: bool = False,
        slam: bool | None = None,
        pose_change: str = "",
        poses_check: str = "warn",
    ) -> Dataset:
        """Opens a folder of scans and poses, or a recording (.bag, .mcap, .db3, .pcap); the layout is recognised.

        Args:
            path: The folder or file.
            poses: The pose file, if there are several: a path, or a part of a file name in the folder.
            odometry: Take poses from before the optimisation, where a folder has both.
            graph: The g2o file with the edges, or a folder of corrected trajectories.
            t_base_lidar: The lidar frame in the vehicle frame, where the poses in the files are those of the vehicle; for several sensors a list with that of each.
            every: Interval of the scans: a number (every Nth), "2m" or "0.5s"; by default all, and of recordings one every 2 m. Where there are no poses, all
                scans are iterated, and a mapper leaves the others out once it has estimated where they were taken.
            cloud_topic: The topic of the clouds in a recording, if there are several; of a list of topics the sensors are mapped together, and poses that do not
                say whose they are are those of the first.
            also: A folder, or several, with the scans and poses of further sensors, which are mapped together with `path`.
            pose_topic: The topic of the poses in a recording, if there are several.
            metadata: The sensor metadata of an Ouster capture, or the angles of the beams of a Hesai's, if they are not found by name.
            point_times: What the times of points mean: "given", what they say; "over-interval", the part of a sweep, which takes until the next cloud comes, of ten a second where clouds have no times;
                "undistorted", nothing, because clouds are undistorted already. By default what they say, and where they contradict
                the time between clouds, the reading under which surfaces are sharpest.
            time_tolerance: Largest time between a scan and its pose, seconds.
            strict: A scan that cannot be read is an error; otherwise it is skipped with a warning.
            slam: Whether to do without the poses in the data; by default if there are none.
            pose_change: What to read otherwise of the poses, parts with commas: "inverse", "w-first", "scale=0.001", "rows=1" (scan k has the pose of scan k + 1),
                "seconds=0.35" (a scan has the pose of 0.35 s later).
            poses_check: Some of the poses are compared with the scans: "warn" names the reading under which they would agree, if they do not; "fix" takes that
                reading; "off" does not compare them.

        Warns:
            RunWarning: The poses do not fit the scans, or the times of points are doubtful.

        Raises:
            FileNotFoundError: There is nothing of this name.
            FileError: The data cannot be recognised or read; the message lists what was found.
            ValueError: `every`, `time_tolerance`, `t_base_lidar`, `point_times`, `pose_change` or `poses_check` cannot be meant so.
        """
        options = {name: value for name, value in locals().items() if name not in ("cls", "path")}
        path = Path(path)
        if not path.exists():
            raise FileNotFoundError(f"{path}: there is nothing of this name; expected a folder of scans or a recording")
        if not (time_tolerance >= 0 and np.isfinite(time_tolerance)):
            raise ValueError(f"time_tolerance: expected seconds, 0 or more, not {time_tolerance!r}")
        optional = (None if name is None else Path(name) for name in (poses, graph, metadata))
        pose_file, graph_file, metadata_file = optional
        topics = [] if cloud_topic is None else [cloud_topic] if isinstance(cloud_topic, str) else list(cloud_topic)
        folders = [Path(folder) for folder in ([also] if isinstance(also, str | os.PathLike) else also)]
        lidars = _lidars(t_base_lidar, len(topics), len(folders))
        interval = None if every is None else str(every)
        this = object.__new__(cls)
        this._path, this._strict, this._options = path, strict, options
        this._cursor, this._lock = None, threading.Lock()
        given = (pose_file, odometry, graph_file, lidars, interval, topics, folders, pose_topic, metadata_file, point_times, float(time_tolerance), strict, slam)
        this._inner, said = _native.Dataset.open(path, *given, pose_change, poses_check)
        for code, text in said:
            warnings.warn(RunWarning(text, code), stacklevel=2)
        return this

    def _native(self) -> _native.Dataset:
        if self._inner is None:
            raise ValueError(f"{self._path}: the data set is closed; open it again")
        return self._inner

    def close(self) -> None:
        """Closes the files. Iterators that are under way can go on; closing a second time does nothing."""
        self._inner = self._cursor = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __reduce__(self) -> tuple[Any, ...]:
        return _reopened, (self._path, self._options)

    @property
    def path(self) -> Path:
        """The folder or file."""
        return self._path

    def __len__(self) -> int:
        """Number of scans, where that is known before they are read: of folders. `len` of a recording is a `TypeError`."""
        scans = self.scan_count
        if scans is None:
            raise TypeError("a recording does not say how many scans it has before it is read: count them with sum(1 for _ in dataset)")
        return scans

    def __bool__(self) -> bool:
        return True

    @overload
    def __getitem__(self, index: int) -> Scan: ...
    @overload
    def __getitem__(self, index: slice) -> list[Scan]: ...
    def __getitem__(self, index: int | slice) -> Scan | list[Scan]:
        """The scan of a number, from 0, or those of a slice; negative numbers count from the end, where that is known. Data are read in their order: going on from the scan
        that was asked for last takes no longer than iterating, going back begins anew.

        Raises:
            IndexError: There is no such scan.
            FileError: It cannot be read.
        """
        if isinstance(index, slice):
            numbers = range(*index.indices(len(self)))
            found = {number: self[number] for number in sorted(numbers)}
            return [found[number] for number in numbers]
        number = operator.index(index)
        number += len(self) if number < 0 else 0
        if number < 0:
            raise IndexError(f"{self._path}: there are {len(self):,} scans, and none with number {index}")
        with self._lock:
            return self._read_up_to(number)

    def _read_up_to(self, number: int) -> Scan:
        """The scan of a number, from 0. One that cannot be read has a number, too."""
        data = self._native()
        at, events = self._cursor if self._cursor is not None and self._cursor[0] <= number else (0, data.events())
        while (item := events.next()) is not None:
            kind, value = item
            if kind not in ("scan", "problem"):
                continue
            at += 1
            self._cursor = at, events
            if at > number:
                if kind == "problem":
                    raise value
                return Scan._of(value)
        self._cursor = None
        raise IndexError(f"{self._path}: there are {at:,} scans, and none with number {number}")

    @property
    def has_poses(self) -> bool:
        """Whether the scans have poses."""
        return self._native().has_poses()

    @property
    def scan_count(self) -> int | None:
        """Number of scans; none where that is not known before they are read, as in recordings."""
        return self._native().scans()

    def events(self) -> Iterator[Event]:
        """Scans, edges and corrections in the order in which they happened; see `Mapper.handle`."""
        events = self._native().events()
        while (item := events.next()) is not None:
            kind, value = item
            if kind != "problem":
                yield _event(kind, value)
            elif self._strict:
                raise value
            else:
                self._warn(str(value))

    def _warn(self, problem: str) -> None:
        warnings.warn(f"scan skipped: {problem}", stacklevel=3)

    def __iter__(self) -> Iterator[Scan]:
        return (event for event in self.events() if isinstance(event, Scan))

    def __str__(self) -> str:
        """What was found, in a few lines."""
        return self._native().description()

    def __repr__(self) -> str:
        if self._inner is None:
            return f"Dataset({str(self._path)!r}, closed)"
        count = self.scan_count
        return f"Dataset({str(self._path)!r}{'' if count is None else f', {count:,} scans'})"


def _lidars(given: Pose | Sequence[Pose] | None, topics: int, more_folders: int) -> list[NDArray[np.float64]]:
    """The poses of lidars in the vehicle frame: none, one, or that of each of several sensors."""
    sensors, what = (more_folders + 1, "folder") if more_folders else (topics, "topic of clouds")
    if given is None:
        return []
    if sensors < 2:
        return [_arrays.pose(given, "t_base_lidar")]
    poses = list(cast("Sequence[Pose]", given))
    if len(poses) != sensors:
        raise ValueError(f"t_base_lidar: expected a list of {sensors} poses, one for each {what}, not {len(poses)}")
    return [_arrays.pose(pose, f"t_base_lidar[{k}]") for k, pose in enumerate(poses)]


def _reopened(path: Path, options: dict[str, Any]) -> Dataset:
    """The data set of these arguments."""
    return Dataset.open(path, **options)
