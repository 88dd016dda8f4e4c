"""Maps in the Rerun viewer, whole or while they grow and bend.

    import rerun as rr
    import voxelastic as vx
    from voxelastic import rerun as vxr

    rr.init("hall", spawn=True)
    mapper = vx.Mapper(voxel_size=0.1)
    logger = vxr.Logger(mapper)
    for scan in vx.Dataset.open("hall.mcap"):
        mapper.handle(scan)
        logger.update(scan.time)            # only what has changed is sent
    vxr.log(mapper.finish())                # the fused surface, in the place of the submaps

Needs `pip install 'voxelastic[rerun]'`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ._answers import Submap, SubmapChanges
from ._map import Map
from ._mapper import Mapper
from ._mesh import Mesh
from ._needs import missing

try:
    import rerun as rr
except ModuleNotFoundError as error:
    raise missing(error, "rerun") from None

__all__ = ["Logger", "log"]


def log(map: Map, path: str = "map", *, lod: int = 0, min_weight: float = 1.0, recording: rr.RecordingStream | None = None) -> None:
    """Logs the fused surface of a map and the path of the sensor, in the map frame: `PATH/surface` and `PATH/path`. The submaps of a `Logger` with the same path are cleared.

    Coordinates are metres, counted from `map.origin` as those of meshes, since the viewer has single precision.

    Args:
        map: The map.
        path: The entity below which it is logged.
        lod: Level of detail: 0 is full resolution, 3 has vertices eight voxels apart.
        min_weight: Smallest number of observations of a voxel that contributes.
        recording: The recording, by default the current one.

    Raises:
        ValueError: There is no surface in it, or a number is out of range.
    """
    mesh = map.mesh(lod=lod, min_weight=min_weight)
    if len(mesh) == 0:
        raise ValueError("map: there is no surface in it")
    _upright(path, recording)
    rr.log(f"{path}/submaps", rr.Clear(recursive=True), recording=recording)
    rr.log(f"{path}/surface", _mesh(mesh, np.eye(4)), recording=recording)
    poses = map.poses
    _log_path([poses[node][:3, 3] - map.origin for node in sorted(poses)], path, recording)


class Logger:
    """Logs the submaps of a mapper while it maps: each is an entity `PATH/submaps/NUMBER` with a mesh in its own frame and the pose of that. A correction sends poses only;
    meshes are sent again where voxels have changed. `PATH/path` is the path of the sensor, placed by the submaps as they are at that moment.

    Args:
        mapper: The mapper; it goes on mapping.
        path: The entity below which everything is logged.
        lod: Level of detail: 0 is full resolution, 3 has vertices eight voxels apart.
        min_weight: Smallest number of observations of a voxel that contributes.
        timeline: Name of the timeline that `update` sets, in seconds.
        recording: The recording, by default the current one.
    """

    def __init__(
        self, mapper: Mapper, path: str = "map", *, lod: int = 0, min_weight: float = 1.0, timeline: str = "map_time", recording: rr.RecordingStream | None = None
    ) -> None:
        self._mapper, self._path, self._lod, self._min_weight = mapper, path, lod, min_weight
        self._timeline, self._recording = timeline, recording
        self._before: list[Submap] = []
        # Where scans were taken, in the frames of the submaps that they went into.
        self._places: dict[int, dict[int, NDArray[np.float64]]] = {}
        _upright(path, recording)

    def update(self, time: float | None = None) -> SubmapChanges:
        """Logs what has changed since the last call, and returns which submaps that were.

        Args:
            time: Where on the timeline it is, seconds; by default the timeline stays where it is.
        """
        if time is not None:
            rr.set_time(self._timeline, duration=time, recording=self._recording)
        now = self._mapper.submaps
        changes = self._mapper.changed_since(self._before)
        poses = {submap.id: submap.pose for submap in now}
        for number in changes.gone:
            rr.log(f"{self._path}/submaps/{number}", rr.Clear(recursive=True), recording=self._recording)
            self._places.pop(number, None)
        if changes.changed:
            self._log_changed([submap for submap in now if submap.id in changes.changed])
        for number in [*changes.changed, *changes.moved]:
            pose = poses[number]
            rr.log(f"{self._path}/submaps/{number}", rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]), recording=self._recording)
        if changes != SubmapChanges([], [], []):
            placed = {node: poses[number][:3, :3] @ at + poses[number][:3, 3] for number, places in self._places.items() for node, at in places.items()}
            _log_path([placed[node] for node in sorted(placed)], self._path, self._recording)
        self._before = now
        return changes

    def _log_changed(self, submaps: list[Submap]) -> None:
        """Logs the meshes of submaps, and notes where their scans were taken."""
        with self._mapper.snapshot(submaps=[submap.id for submap in submaps]) as snapshot:
            scans = snapshot.poses
            for submap in submaps:
                mesh = snapshot.mesh(submap=submap.id, lod=self._lod, min_weight=self._min_weight)
                rr.log(f"{self._path}/submaps/{submap.id}", _mesh(mesh, submap.pose), recording=self._recording)
                turn, at = submap.pose[:3, :3], submap.pose[:3, 3]
                self._places[submap.id] = {node: (scans[node][:3, 3] - snapshot.origin - at) @ turn for node in submap.nodes if node in scans}


def _upright(path: str, recording: rr.RecordingStream | None) -> None:
    """Maps have z upwards."""
    rr.log(path, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True, recording=recording)


def _mesh(mesh: Mesh, pose: NDArray[np.float64]) -> rr.Mesh3D:
    """The mesh in the frame that has this pose in the map frame."""
    turn = pose[:3, :3].astype(np.float32)
    vertices = (mesh.vertices - pose[:3, 3].astype(np.float32)) @ turn
    return rr.Mesh3D(vertex_positions=vertices, triangle_indices=mesh.triangles, vertex_normals=mesh.normals @ turn, vertex_colors=mesh.vertex_colours())


def _log_path(line: list[NDArray[np.float64]], path: str, recording: rr.RecordingStream | None) -> None:
    rr.log(f"{path}/path", rr.LineStrips3D([line] if len(line) > 1 else []), recording=recording)
