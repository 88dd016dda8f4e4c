"""The native part: what the package is built on. Arrays are C-contiguous and of the types below; nothing else is accepted."""

import os
from collections.abc import Mapping, Sequence
from typing import Any, Optional, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Dataset",
    "Events",
    "Localiser",
    "Map",
    "Mapper",
    "Odometry",
    "Scan",
    "Simulation",
    "Splitter",
    "alike_places",
    "beam_directions",
    "cells_of_box",
    "clearance",
    "compare_surfaces",
    "complete_settings",
    "finish_tiles",
    "free_in_every_thread",
    "join_manifests",
    "esdf",
    "export",
    "limit_memory",
    "merge_into",
    "mesh_distances",
    "optimise_graph",
    "plan",
    "ray_cast",
    "run_command",
    "settings_table",
    "slice",
    "trajectory_errors",
    "unpack_scans",
    "use_threads",
    "verify_places",
    "world_names",
    "write_mesh",
    "write_tiles",
]

def run_command(arguments: Sequence[str]) -> int:
    """Runs the command and returns its exit code."""

def use_threads(threads: int) -> None:
    """Limits the threads of this process, for one of several on a machine; 0 for one per core."""

def free_in_every_thread() -> None:
    """Allocates and frees in every thread, so that the C library looks at the memory that it keeps for each of them."""

def limit_memory(size: str, folder: str | os.PathLike[str] | None) -> None:
    """Limits the memory of this process to a size as text; `none` removes the limit."""

def settings_table() -> list[tuple[str, str, str, str, bool, str]]:
    """All settings: key, kind, default, range with unit, whether it is a basic one, help. The kind is `float`, `int`, `str`, or the allowed words separated by `|`."""

def complete_settings(given: Mapping[str, str]) -> list[tuple[str, str]]:
    """All settings as text: those given, the others with their defaults."""

def ray_cast(
    map: Map, origins: NDArray[np.float64], directions: NDArray[np.float64], length: float, unknown_blocks: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint8]]:
    """Distances to where rays end, NaN where they do not; the normals there; the states of what they end in."""

def beam_directions(sensor: str, columns: int | None) -> tuple[NDArray[np.float64], int]:
    """Directions of a sensor's beams, in the lidar frame, row by row, and the number of rows."""

def esdf(
    map: Map, points: NDArray[np.float64], max_distance: float, unknown_blocks: bool
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Distances by the Euclidean distance field of the map, metres, and their gradients."""

def clearance(map: Map, points: NDArray[np.float64], up_to: float, unknown_blocks: bool) -> NDArray[np.float64]:
    """Distances to the nearest obstacles, metres, `up_to` where there are none nearer."""

def slice(map: Map, axis: int, at: float, thickness: float, pixel: float, bounds: Sequence[Sequence[float]], of_distances: bool) -> NDArray[Any]:
    """States, or distances, of a cross-section, rows from the smallest coordinate on."""

def plan(
    map: Map,
    start: Sequence[float],
    goal: Sequence[float],
    radius: float,
    wheels: bool,
    step: float | None,
    unknown_blocks: bool,
    time: float,
    samples: int | None,
    seed: int,
) -> dict[str, Any]:
    """A path: its waypoints and what is known about it, by the names of `voxelastic.Path`."""

# Intensities, colours, rings and times of points, and the times and poses of a motion, each if there is one.
_Channels: TypeAlias = tuple[
    NDArray[np.float32] | None,
    NDArray[np.uint8] | None,
    NDArray[np.uint16] | None,
    NDArray[np.float32] | None,
    tuple[Sequence[float], Sequence[NDArray[np.float64]]] | None,
]

@final
class Dataset:
    """A folder or a recording."""

    @staticmethod
    def open(
        path: str | os.PathLike[str],
        poses: str | os.PathLike[str] | None,
        odometry: bool,
        graph: str | os.PathLike[str] | None,
        t_base_lidar: Sequence[NDArray[np.float64]],
        every: str | None,
        cloud_topics: Sequence[str],
        more_folders: Sequence[str | os.PathLike[str]],
        pose_topic: str | None,
        metadata: str | os.PathLike[str] | None,
        point_times: str,
        time_tolerance: float,
        strict: bool,
        slam: bool | None,
        pose_change: str,
        poses_check: str,
    ) -> tuple[Dataset, list[tuple[str, str]]]:
        """Opens a folder or a recording; also returns what there is to say about its poses. Clouds are read when their turn comes. No topic, one, or one for each sensor; or folders of further sensors; and poses of as many lidars or of none."""

    def description(self) -> str:
        """What was found, in a few lines."""

    def scans(self) -> int | None:
        """Number of scans, if it is known before they are read."""

    def has_poses(self) -> bool:
        """Whether the scans have poses."""

    def events(self) -> Events:
        """The events from the beginning."""

@final
class Events:
    """An iterator over the events of a data set."""

    def next(self) -> tuple[str, Any] | None:
        """The next event; none at the end."""

@final
class Scan:
    """A scan of a data set or a simulation, or one made of arrays."""

    @staticmethod
    def of(
        node: int,
        time: float,
        pose: NDArray[np.float64] | None,
        points: NDArray[np.float32],
        rows: int,
        channels: _Channels,
        before: Scan | None,
        keeps_motion: bool,
    ) -> Scan:
        """A scan of arrays. Of `before`, if it is that with changes, stays what arrays do not tell, and, if wanted, its motion."""

    def exact_pose(self) -> NDArray[np.float64] | None:
        """x, y, z, qx, qy, qz, qw of its pose, if it has one, to the last bit."""

    def stamp(self) -> tuple[int, float, list[list[float]] | None]:
        """Its node, time stamp in seconds, and pose as a 4 x 4 matrix, if it has one."""

    def shape(self) -> tuple[int, int]:
        """Number of rows and columns of the cloud; one row if it is not organised."""

    def points(self) -> NDArray[np.float32]:
        """The points, N x 3, in the lidar frame."""

    def channels(self) -> tuple[NDArray[np.float32] | None, NDArray[np.uint8] | None, NDArray[np.uint16] | None, NDArray[np.float32] | None]:
        """Intensities, colours, rings and times of the points, where there are any."""

    def undistorted(self) -> Scan | None:
        """The same scan, corrected for the motion during the sweep; none if the motion or the times of the points are unknown."""

@final
class Mapper:
    """Turns events into a map. Threads may share it; they take turns."""

    def __new__(
        cls, given: Mapping[str, str], loops: bool | None, optimise: bool, path: str | os.PathLike[str] | None, checkpoints: str, restart: bool
    ) -> Mapper: ...
    def resumed(self) -> tuple[int, int, int | None]:
        """Scans that an earlier process had integrated, inputs that it had taken, and the node that came last."""

    def origin(self) -> list[float]:
        """Where coordinates of the map are counted from."""

    def take_warnings(self) -> list[tuple[str, str]]:
        """What was said since this was asked last: codes and texts."""

    def integrate(
        self,
        node: int,
        pose: NDArray[np.float64] | None,
        time: float,
        points: NDArray[np.float32],
        rows: int,
        channels: _Channels,
    ) -> tuple[int, int, str, int, list[list[float]]]:
        """Integrates a scan of points in the lidar frame. Returns the node, its submap, how that was chosen, the number of usable returns, and the pose."""

    def integrate_scan(self, scan: Scan, node: int, time: float) -> tuple[int, int, str, int, list[list[float]]] | None:
        """Integrates a scan as that of `node` at `time`. None: it has no pose, was registered, and is not to be mapped."""

    def replay(self, dataset: Dataset, events: Events, most: int) -> tuple[int, list[str], bool]:
        """Handles up to `most` events. Returns the number of scans integrated, what is wrong with others, and whether that was all."""

    def add_edge(
        self, closes_loop: bool, from_node: int, to_node: int, t_from_to: NDArray[np.float64], information: Optional[NDArray[np.float64]]
    ) -> None:
        """Adds an edge between consecutive nodes, or one that closes a loop."""

    def update_poses(self, nodes: Sequence[int], poses: Sequence[NDArray[np.float64]]) -> None:
        """Corrects the poses of nodes."""

    def counts(self) -> tuple[int, int, int, int, str | None]:
        """Number of scans, submaps, fusions and corrections of root poses, and the description of the sensor."""

    def moving_points(self) -> NDArray[np.float32]:
        """Points of the last scan that were set aside because they are on something that moves, N x 3, in the map frame."""

    def settings(self) -> list[tuple[str, str]]:
        """The settings as text."""

    def submaps(self) -> list[tuple[int, list[list[float]], list[int], int]]:
        """The submaps of the present map, as `Map.submaps`."""

    def snapshot(self, only: Sequence[int] | None) -> Map:
        """A copy of the present map, or of some of its submaps."""

    def close(self) -> bool:
        """Frees the map. False if it was handed over."""

    def finish(self) -> tuple[Map, list[tuple[str, str]]]:
        """Completes the map, saves it if it is kept on disk, and hands it over, with what was said meanwhile: codes and texts."""

@final
class Map:
    """A map. It does not change, so threads share it."""

    @staticmethod
    def open(path: str | os.PathLike[str], keep_vanished: bool) -> tuple[Map, list[str]]:
        """Opens a stored map, with or without what later sessions saw to be gone; also returns what is wrong with its settings."""

    def close(self) -> bool:
        """Closes the map: its memory is free when no call uses it any more. Whether that is now."""

    def copy(self) -> Map:
        """Another map of the same memory: each is closed by itself."""

    def is_closed(self) -> bool:
        """Whether it was closed."""

    def save(self, path: str | os.PathLike[str]) -> None:
        """Saves the map to a directory."""

    def renumbered(self, first: int, origin: Sequence[float]) -> Map:
        """The same map with submaps numbered from `first` on, in their order, whose coordinates count from `origin`."""

    def origin(self) -> list[float]:
        """Where coordinates are counted from."""

    def settings(self) -> list[tuple[str, str]]:
        """The settings that it was made with, as text."""

    def sensor(self) -> str | None:
        """Description of the sensor, if known."""

    def nbytes(self) -> int:
        """Memory of the fields, bytes."""

    def fields(self) -> tuple[bool, bool]:
        """Whether it has signed distances, and whether it has occupancy."""

    def submaps(self) -> list[tuple[int, list[list[float]], list[int], int]]:
        """Each submap: identifier, the pose in the map frame as a 4 x 4 matrix, its nodes, the number of changes."""

    def poses(self) -> list[tuple[int, list[list[float]]]]:
        """The nodes with the present poses of their scans."""

    def bounds(self) -> tuple[list[float], list[float]] | None:
        """Smallest and largest coordinates of what was observed, map frame; none for an empty map."""

    def mesh(self, surface: str, lod: int, min_weight: float, close_gaps: bool, keep_all: bool, unfused: bool, submap: int | None) -> tuple[Any, ...]:
        """Vertices, triangles, normals, scales, intensities and colours of a surface, of one submap or of all."""

    def blocks(self, submap: int) -> list[tuple[int, NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]]] | None:
        """The voxels of a submap, by scale: the scale, coordinates of the blocks, distances and weights of their voxels."""

    def query(self, points: NDArray[Any]) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]:
        """Signed distances, gradients and states at the rows of an N x 3 array, float32 or float64."""

    def distances(self, points: NDArray[Any]) -> NDArray[np.float32]:
        """Signed distances at the rows of an N x 3 array, float32 or float64; NaN where none is known."""

    def states(self, points: NDArray[Any]) -> NDArray[np.uint8]:
        """States at the rows of an N x 3 array, float32 or float64."""

@final
class Odometry:
    """Poses of scans, one after the other."""

    def __new__(cls, voxel_size: float | None, min_range: float, max_range: float, deskew: bool) -> Odometry: ...
    def register(
        self, points: NDArray[np.float32], rows: int, time: float | None, times: NDArray[np.float32] | None
    ) -> tuple[list[list[float]], str, int, bool, float, float, list[list[float]], list[list[float]], str | None]:
        """Registers a scan to those before. Returns the fields of `voxelastic.OdometryReport`."""

@final
class Localiser:
    """Finds scans in a map."""

    @staticmethod
    def of_map(map: Map) -> Localiser | None:
        """Prepares the search in a map with surfaces; none if it has none."""

    def locate(
        self,
        points: NDArray[np.float32],
        rows: int,
        times: NDArray[np.float32] | None,
        guess: tuple[Sequence[float], float] | None,
    ) -> list[tuple[list[list[float]], bool, float, float, float, list[list[float]] | None]]:
        """The first fields of `voxelastic.Location`, the best first; none if the scan has no returns or fits nowhere. `guess`: a position, and a distance from it in metres."""

@final
class Simulation:
    """A simulation."""

    def __new__(
        cls,
        world: str,
        scans: int | None,
        spacing: float,
        rate: float | None,
        sensor: str,
        columns: int | None,
        max_range: float,
        noise: float,
        moving: bool,
        drift: float,
        loop_radius: float,
        seed: int,
    ) -> Simulation: ...
    def len(self) -> int:
        """Number of scans."""

    def poses(self) -> tuple[list[list[list[float]]], list[list[list[float]]], list[float]]:
        """True poses and those of the odometry as 4 x 4 matrices, and the times."""

    def scan(self, k: int) -> Scan:
        """Scan `k` with its true pose."""

    def events(self, k: int) -> list[tuple[str, Any]]:
        """What a SLAM system would report at scan `k`, in order."""

    def write(self, path: str | os.PathLike[str]) -> None:
        """Writes a folder."""

    def distance(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Exact signed distances from points to the surfaces of the world."""

    def surface(self, spacing: float, max_range: float) -> NDArray[np.float32]:
        """Points of the surface that the sensor can see, one in each cube of `spacing` metres."""

def world_names() -> list[str]:
    """The worlds of simulations."""

def compare_surfaces(
    points: NDArray[np.float32],
    triangles: NDArray[np.int32] | None,
    truth: NDArray[np.float32],
    simulation: Simulation | None,
    align: bool,
    truth_voxel: float,
    thresholds: Sequence[float],
    max_points: int,
) -> str:
    """Compares the points of a map, or its mesh, with true points, or with a world: as JSON."""

def write_mesh(
    path: str | os.PathLike[str],
    vertices: NDArray[np.float32],
    triangles: NDArray[np.uint32],
    normals: NDArray[np.float32],
    colours: NDArray[np.uint8] | None,
    intensity: NDArray[np.float32] | None,
    origin: Sequence[float],
) -> None:
    """Writes a mesh in the format that the ending of its name says."""

def export(map: Map, path: str, voxel: float | None, lod: int, min_weight: float) -> None:
    """Writes a map in the format that the name of the file or folder says."""

def merge_into(
    map: Map, into: str | os.PathLike[str], pose: NDArray[np.float64] | None, same_frame: bool
) -> tuple[list[int], str, list[list[float]], int, float, list[tuple[str, str]]]:
    """Adds a map to one on disk. Returns the fields of `voxelastic.Merged`, and what was said: codes and texts."""

def mesh_distances(
    vertices: NDArray[np.float32], triangles: NDArray[np.int32], points: NDArray[np.float32], cut_off: float
) -> NDArray[np.float32]:
    """Distances from points to a mesh, metres; infinity beyond `cut_off`."""

def trajectory_errors(
    truth: Sequence[NDArray[np.float64]], estimate: Sequence[NDArray[np.float64]], fit: str
) -> tuple[str, NDArray[np.float64]]:
    """Absolute errors of a trajectory as JSON, and those of the positions in metres. `fit` is `none`, `rigid` or `first`."""

@final
class Splitter:
    """Cuts a recording into pieces of some metres of path."""

    def __new__(cls, first_node: int, metres: float, scale: float, place_voxel: float | None) -> Splitter: ...
    def next(self, events: Events) -> tuple[bytes, int] | None:
        """The next piece: its scans as bytes, and how many there are; none at the end."""

    def track(
        self,
    ) -> tuple[
        list[tuple[int, float, list[float]]],
        list[tuple[int, int, list[float], list[float] | None]],
        list[tuple[int, int, list[float], list[float] | None]],
        bytes,
        bytes,
        float,
        list[str],
        list[float],
    ]:
        """After the last piece: nodes with times and poses, odometry edges, loop edges, places, their descriptors, the edge of their voxels, problems, what poses count from."""

def unpack_scans(piece: bytes) -> list[Scan]:
    """The scans of a piece, each with its pose."""

def alike_places(first: bytes, second: bytes, most: int) -> list[tuple[int, int, float]]:
    """Pairs of places that look alike in two recordings, by their descriptors: numbers of both, and how alike, at most 1."""

def verify_places(
    first: bytes, second: bytes, pairs: Sequence[tuple[int, int, float]]
) -> list[tuple[tuple[int, int, list[float], list[float] | None], str, float | None, float | None]]:
    """Registers places of two recordings to each other: of each closure that was tried the edge, the verdict, the overlap and the contradiction."""

def optimise_graph(
    nodes: Sequence[tuple[int, Sequence[float]]], edges: Sequence[tuple[int, int, Sequence[float], Sequence[float] | None]], fixed: Sequence[int]
) -> tuple[list[list[float]], bool]:
    """The new poses of the nodes of a pose graph, in order, and whether the optimisation converged."""

def join_manifests(texts: Sequence[str], poses: Mapping[int, Sequence[float]], only_posed: bool, origin: Sequence[float]) -> str:
    """The manifest of the map that has the submaps of several maps, at these root poses, which count from `origin`; with `only_posed` no others."""

def cells_of_box(low: Sequence[float], high: Sequence[float], voxel: float, level: int) -> list[list[int]]:
    """The cells of tiles of a level that a box of the map frame touches, in the order in which tiles are joined."""

def write_tiles(
    map: Map, cell: tuple[int, Sequence[int]], heights: tuple[float, float], folder: str | os.PathLike[str]
) -> tuple[bytes, list[str]] | None:
    """Writes the tiles of a map in one cell to a folder: what the next level is made of, and the names of the files; none without a surface there."""

def finish_tiles(parts: Sequence[str | os.PathLike[str]], voxel: float, folder: str | os.PathLike[str], title: str, origin: Sequence[float]) -> int:
    """Writes the upper levels of tiles, the tileset and the page, from parts in the order of their cells, of a map around `origin`. Returns the number of tiles written here."""
