"""The mapper: scans in, a map out."""

from __future__ import annotations

import os
import pathlib
import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, NoReturn, Optional, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _arrays, _native
from ._answers import Submap, SubmapChanges, _changes, _submaps
from ._arrays import Points, Pose
from ._dataset import Dataset
from ._errors import RefusedError, RunWarning
from ._events import Edge, Event, PoseUpdate, Scan, _EdgeOfData, _PoseUpdateOfData
from ._map import Map
from ._memory import give_back
from ._progress import Progress, reported
from ._settings import SettingArguments, Settings

if TYPE_CHECKING:
    from typing_extensions import Self, Unpack

__all__ = ["Mapper", "ScanReport"]


class ScanReport(NamedTuple):
    """What became of a scan."""

    node: int
    """Its node."""
    submap: int
    """The submap into which it was integrated."""
    assignment: Literal["continue", "revisit", "overlap", "new"]
    """How that was chosen: the submap of the scan before; one that closed loops lead to; one that contains nearly all of the scan; a new one."""
    returns: int
    """Number of points that were used: those with a return, in range and seen by the sensor model."""
    pose: NDArray[np.float64]
    """The lidar frame in the map frame, 4 x 4, with which it was integrated. Later corrections change it: see `Map.submaps`."""


def _report(native: tuple[int, int, str, int, list[list[float]]]) -> ScanReport:
    node, submap, assignment, returns, pose = native
    return ScanReport(node, submap, cast("Any", assignment), returns, np.array(pose))


class Mapper:
    """Turns scans into a map that follows later corrections of their poses. Scans come with poses, or the mapper estimates them.

    Each scan belongs to a node of a pose graph. The map consists of rigid submaps; corrected poses move submaps, and loop edges join them.
    Threads may share a mapper: they take turns, and other threads of Python run meanwhile. Processes that are forked cannot use it. `with Mapper() as mapper` frees
    what was not handed over by `finish` at the end of the block.

    With a `path`, the map is kept on disk while it grows: when the process is killed, a mapper of the same path and settings goes on where it was, and makes the same
    map. `resumed` says how many scans it has then; the next scan that you give it follows those. `replay` leaves out by itself what was taken.

    Args:
        settings: The settings; by default those of `Settings()`.
        loops: Whether to find loop closures from the scans, and to correct the poses after them; by default if scans come without poses.
        optimise: Whether to correct the poses after the loop edges that are given, too; otherwise that is up to you, by `update_poses`.
        path: The directory of a map, such as `hall.vox`, that `finish` saves, and in which checkpoints are kept meanwhile.
        checkpoints: When: `"auto"` (so that it takes at most a fiftieth of the time), `"off"`, a number of scans, or seconds as `"30s"`.
        restart: Map from the beginning, and give up what an earlier process has kept at `path`.
        changes: Settings as keyword arguments: `Mapper(voxel_size=0.1, max_range=40)`. They win over `settings`.

    Raises:
        SettingError: A setting is unknown or out of range, or settings contradict each other.
        FileError: There is no place for the map, or what was kept is of another run.
    """

    __slots__ = ("__weakref__", "_inner", "_next_node", "_next_time", "_settings")

    def __init__(
        self,
        settings: Settings | None = None,
        *,
        loops: bool | None = None,
        optimise: bool = False,
        path: str | os.PathLike[str] | None = None,
        checkpoints: str | int = "auto",
        restart: bool = False,
        **changes: Unpack[SettingArguments],
    ) -> None:
        if settings is not None and not isinstance(settings, Settings):
            raise TypeError(f"settings: expected Settings, not {settings!r} of type {type(settings).__name__}; settings are keyword arguments: Mapper(voxel_size=0.1)")
        self._settings = (settings or Settings()).replace(**changes)
        place = None if path is None else pathlib.Path(path)
        self._inner = _native.Mapper(self._settings.as_text(), loops, bool(optimise), place, str(checkpoints), bool(restart))
        self._next_node, self._next_time = 0, 0.0
        self._warn(2)
        if (last := self._inner.resumed()[2]) is not None:
            self._next_node = last + 1

    @property
    def resumed(self) -> int:
        """Scans that an earlier process had integrated at `path`, with whose run this mapper has gone on: give it those that follow."""
        return self._inner.resumed()[0]

    @property
    def origin(self) -> NDArray[np.float64]:
        """What coordinates of the map are counted from, a point (x, y, z), metres: see `Map.origin`. The first scan decides."""
        return np.array(self._inner.origin())

    def _warn(self, level: int) -> None:
        """Raises as warnings what was said, but for what is an exception."""
        for code, text in self._inner.take_warnings():
            if code != "scan-skipped":
                warnings.warn(RunWarning(text, code), stacklevel=level + 1)

    @property
    def settings(self) -> Settings:
        """The settings."""
        return self._settings

    def integrate(
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
    ) -> ScanReport:
        """Integrates a scan.

        All points of the sensor belong to the scan: from points that were thinned out, the beams of the sensor cannot be recognised well.

        Args:
            points: N x 3 coordinates in the lidar frame, metres; or rows x columns x 3 for an organised cloud, rows being the rings of the sensor.
                Points that are zero or not finite are beams without return. float32 is used as it is. Of a cloud of Open3D, its coordinates are taken.
            pose: The lidar frame in the map frame: a 4 x 4 matrix, or a translation and a quaternion (x, y, z, w). Without it, the scan is registered to those
                before, and the map has the frame of the first scan; then all scans must come without, close enough to overlap: as the sensor delivers them.
            node: Number of the scan's node; by default one more than that of the scan before, from 0 on.
            time: Time stamp of the scan, seconds, for scans without poses; by default 0.1 more than that of the scan before.
            intensity: N strengths of the returns in the sensor's own scale, finite where there is a return.
            colours: N x 3 colours, sRGB, 0 to 255; [0, 0, 0] where a point has none.
            ring: N numbers of the beams' rings, from 0.
            times: N times of the points in seconds, relative to that of the pose.
            motion: Poses of the lidar during the sweep, in the lidar frame at the time of `pose`, each with its time in seconds relative to that. With it and
                `times` the scan is undistorted; leave it out if that has been done.

        Raises:
            ValueError: An array has another shape, a number that must be finite is not, or the pose is not rigid.
            TypeError: An array is not one of numbers, or it is masked.
            RefusedError: The scan cannot be used: the node has a scan already, no point is a return in range, the sensor cannot be recognised, or a scan without pose
                fits nowhere.
        """
        cloud, rows = _arrays.cloud(points)
        channels = _arrays.channels(cloud, intensity=intensity, colours=colours, ring=ring, times=times, motion=motion)
        exact = None if pose is None else _arrays.pose(pose)
        number, stamp = self._stamp(node, time)
        report = self._inner.integrate(number, exact, stamp, cloud, rows, channels)
        self._next_node = number + 1
        self._warn(2)
        return _report(report)

    def _stamp(self, node: int | None, time: float | None) -> tuple[int, float]:
        """Node and time of a scan that comes; time passes also if it is refused."""
        number = self._next_node if node is None else _arrays.node(node)
        stamp = self._next_time if time is None else _arrays.time(time)
        self._next_time = stamp + 0.1
        return number, stamp

    def add_odometry_edge(self, first: int, second: int, pose: Pose, *, information: Optional[ArrayLike] = None) -> None:
        """Adds the measured pose between two consecutive nodes. Without such edges, the poses of the scans are taken for it.

        Args:
            first: Number of a node.
            second: Number of the node after it.
            pose: The lidar frame of `second` in that of `first`.
            information: 6 x 6, translation (1 / m^2) before rotation (1 / rad^2), in the lidar frame of `second`; used where the mapper optimises. None: as usual.

        An edge of a node whose scan has not come waits for it; `finish` warns of those that wait still.

        Raises:
            RefusedError: Both are the same node.
        """
        self._edge(False, first, second, _arrays.pose(pose), information)

    def add_loop_edge(self, first: int, second: int, pose: Pose, *, information: Optional[ArrayLike] = None) -> None:
        """Adds a loop closure: two nodes at which the same place was observed. When poses agree with it, the submaps there are joined.

        Args:
            first: Number of a node.
            second: Number of another node.
            pose: The lidar frame of `second` in that of `first`.
            information: 6 x 6, translation (1 / m^2) before rotation (1 / rad^2), in the lidar frame of `second`; used where the mapper optimises. None: as usual.

        An edge of a node whose scan has not come waits for it; `finish` warns of those that wait still.

        Raises:
            RefusedError: Both are the same node.
        """
        self._edge(True, first, second, _arrays.pose(pose), information)

    def _edge(self, closes_loop: bool, first: int, second: int, pose: NDArray[np.float64], information: Optional[ArrayLike]) -> None:
        nodes = _arrays.node(first, "first"), _arrays.node(second, "second")
        self._inner.add_edge(closes_loop, *nodes, pose, _arrays.information(information))

    def update_poses(self, poses: Mapping[int, Pose]) -> None:
        """Corrects poses, for example after a loop closure. The map follows at once: submaps move, no scan is integrated again.

        Args:
            poses: The corrected pose, lidar frame in map frame, of each node. Nodes without a scan are ignored; `finish` says how many.

        Raises:
            ValueError: A pose is not rigid; the map is unchanged.
        """
        if not isinstance(poses, Mapping):
            raise TypeError(f"poses: expected a dictionary of poses by node, not {type(poses).__name__}")
        nodes = [_arrays.node(number, "a node of poses") for number in poses]
        self._inner.update_poses(nodes, [_arrays.pose(pose, f"poses[{number}]") for number, pose in poses.items()])

    def handle(self, event: Event) -> ScanReport | None:
        """Takes an event of a data set or a simulation as it is, or one that you made: a scan, an edge or corrected poses. A scan gives a report, unless it has no pose
        and is one that `every` of the data set leaves out.

        Raises:
            RefusedError: The event cannot be used; the map is unchanged.
        """
        match event:
            case Scan():
                integrated = self._inner.integrate_scan(event._inner, *self._stamp(event.node, event.time))
                self._warn(2)
                if integrated is None:
                    return None
                report = _report(integrated)
                self._next_node = report.node + 1
                return report
            case Edge():
                exact = event.exact if isinstance(event, _EdgeOfData) else None
                pose = _arrays.pose(event.pose) if exact is None else exact
                self._edge(event.closes_loop, event.first, event.second, pose, event.information)
            case _PoseUpdateOfData(exact=exact) if exact is not None:
                self._inner.update_poses(list(event.poses), exact)
            case PoseUpdate():
                self.update_poses(event.poses)
            case _:
                raise TypeError(f"event: expected a Scan, an Edge or a PoseUpdate, not {type(event).__name__}")
        return None

    def replay(self, dataset: Dataset, *, strict: bool = False, progress: Progress = None) -> int:
        """Handles all events of a data set in their order, as the command does: the next scans are decoded meanwhile. Returns the number of scans integrated.

        Args:
            dataset: The data.
            strict: A scan that cannot be used is an error; otherwise it is skipped with a `RunWarning`.
            progress: How far it is: see `Progress`.

        Raises:
            RefusedError: With `strict`, a scan cannot be used. What came before it is in the map.
        """
        data = dataset._native()
        events, total, is_over = data.events(), 0, False
        with reported(progress, data.scans(), "scan") as report:
            while not is_over:
                scans, problems, is_over = self._inner.replay(data, events, 1 if strict else 4)
                total += scans
                for problem in problems:
                    if strict:
                        raise RefusedError(problem)
                    warnings.warn(RunWarning(f"scan skipped: {problem}", "scan-skipped"), stacklevel=2)
                self._warn(2)
                if scans:
                    report(scans)
        return total

    def moving_points(self) -> NDArray[np.float32]:
        """Points of the last scan that were set aside because they are on something that moves: N x 3, map frame, metres, counted from `origin`, with the pose that the scan came with.
        None with `dynamic="keep"`, where nothing is set aside."""
        return self._inner.moving_points()

    @property
    def submaps(self) -> list[Submap]:
        """The rigid parts of the map as it is now, by number."""
        return _submaps(self._inner.submaps())

    def changed_since(self, before: Sequence[Submap]) -> SubmapChanges:
        """What has become of the submaps since they were `before`: which are to be meshed again, which were only moved by a correction, and which are no more.

        A viewer keeps a mesh of each submap up to date by `mapper.snapshot(submaps=changes.changed).mesh(submap=number)`.

        Args:
            before: What `submaps` was at an earlier moment; an empty list for the beginning.
        """
        return _changes(before, self.submaps)

    def snapshot(self, *, submaps: Sequence[int] | None = None) -> Map:
        """A copy of the map as it is now. Mapping can go on.

        Args:
            submaps: Numbers of the submaps that are wanted, by default all: copies of few take less time and memory.

        Raises:
            ValueError: There is no such submap.
        """
        wanted = None if submaps is None else [_arrays.node(number, "submaps") for number in submaps]
        if wanted is not None and (unknown := set(wanted) - {submap.id for submap in self.submaps}):
            raise ValueError(f"submaps: there is none with number {min(unknown)}; there are {[submap.id for submap in self.submaps]}")
        return Map._of(self._inner.snapshot(wanted))

    def finish(self) -> Map:
        """Completes the map, resolves conflicts between its submaps, saves it if the mapper has a `path`, and hands it over without a copy. The mapper takes nothing
        after that.

        On Ctrl-C the mapper keeps the map, and `finish` can be called again.
        """
        native, said = self._inner.finish()
        for code, text in said:
            warnings.warn(RunWarning(text, code), stacklevel=2)
        return Map._of(native)

    def close(self) -> None:
        """Frees the map and gives its memory back to the system, unless `finish` handed it over. The mapper takes nothing after that; closing a second time does nothing."""
        if self._inner.close():
            give_back()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __reduce__(self) -> NoReturn:
        raise TypeError("a Mapper is not pickled or copied: it has threads; `snapshot()` gives a copy of its map")

    def __repr__(self) -> str:
        try:
            scans, submaps, fusions, moves, sensor = self._inner.counts()
        except RuntimeError:
            return "Mapper(finished)"
        parts = [f"{scans:,} scans", f"{submaps:,} submaps", f"{fusions:,} fusions", f"{moves:,} moves of submaps", f"voxels of {self._settings.voxel_size:g} m"]
        return f"Mapper({', '.join(parts + ([f'sensor: {sensor}'] if sensor else []))})"
