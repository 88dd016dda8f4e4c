"""A map: opened, saved, meshed and queried."""

from __future__ import annotations

import dataclasses
import os
import pathlib
import warnings
from typing import TYPE_CHECKING, Any, Literal, NoReturn, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _arrays, _native, _picture
from ._answers import Blocks, Merged, Path, Query, RayHits, Slice, State, Submap, _submaps
from ._arrays import Points, Pose
from ._errors import RunWarning
from ._memory import give_back
from ._mesh import Mesh
from ._settings import Settings

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["Map", "Surface"]

Surface: TypeAlias = Literal["measured", "occupied", "free", "frontier"]
"""Kinds of surfaces: `measured` is that of the signed distances (of occupied space in maps without them); `occupied` bounds occupied space, `free`
bounds free space, and `frontier` is the part of that which adjoins unknown space."""


_PICTURE_BYTES = 200_000_000


def _positive(value: float, name: str) -> float:
    if not (value > 0 and np.isfinite(value)):
        raise ValueError(f"{name}: expected metres, more than 0, not {value!r}")
    return float(value)


class Map:
    """A map, in memory. It does not change: threads may share it.

    Coordinates are metres in the map frame, counted from `origin`. Long calls let other threads run, and Ctrl-C ends them. `with Map.open(path) as map` frees its memory at the end of
    the block; what is asked after that is a `ValueError`. A copy shares the memory and is closed by itself.
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
    def open(cls, path: str | os.PathLike[str], *, keep_vanished: bool = False) -> Map:
        """Opens a map that was saved, a directory such as `hall.vox`, and loads all of it.

        Args:
            path: The directory.
            keep_vanished: Whether to keep, in a map of several sessions or of laps apart, what later ones saw to be gone: surfaces and occupied space where they know free space
                only. Otherwise the map is as it was last, as the commands show it; saved again, it is without the rest.

        Raises:
            FileNotFoundError: There is nothing of this name.
            FileError: It is no map, or it is damaged, or it was written by a newer version.
        """
        path = pathlib.Path(path)
        if not path.exists():
            raise FileNotFoundError(f"{path}: there is nothing of this name; expected the directory of a map")
        native, remarks = _native.Map.open(path, keep_vanished)
        for remark in remarks:
            warnings.warn(f"{path}: {remark}", stacklevel=2)
        return cls._of(native)

    def close(self) -> None:
        """Frees the memory, and gives it back to the system, as soon as no call and no copy uses it any more. Closing a second time does nothing."""
        if self._inner.close():
            give_back()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __copy__(self) -> Map:
        return Map._of(self._inner.copy())

    def __deepcopy__(self, _: dict[int, object]) -> Map:
        return self.__copy__()

    def __reduce__(self) -> NoReturn:
        raise TypeError("a Map is not pickled, because it may be larger than memory allows twice: save it, and open it in the other process")

    def save(self, path: str | os.PathLike[str]) -> None:
        """Saves the map as a directory. A map that is there already is replaced, at once and completely; its unchanged parts are not written again.

        Args:
            path: The directory; its name usually ends with `.vox`.

        Raises:
            FileError: Something else is there, or another process writes to it, or the disk is full.
        """
        self._inner.save(pathlib.Path(path))

    def export(self, path: str | os.PathLike[str], *, voxel_size: float | None = None, lod: int = 0, min_weight: float = 1.0) -> None:
        """Writes the map in a format of other programs, as the command `export` does.

        Args:
            path: The file; its ending says the format. A cloud of the surface is `.ply`, `.pcd`, `.las`, `.laz`, `.copc.laz` or `.e57`, in the frame of the poses, that is with
                `origin`. Free and occupied space is an OctoMap, `.bt` (states) or `.ot` (log-odds), whose coordinates count from `origin`. A folder, which is there or
                ends with a slash (`"tiles/"`), gets the surface as 3D Tiles with a page that shows them. `map.yaml` is the floor as 2-D maps for Nav2, one for each storey.
            voxel_size: Edge of the voxels of an OctoMap, metres; by default that of the finest voxel.
            lod: Level of detail of the surface, a number from 0 (full resolution) to 3.
            min_weight: Smallest number of observations of a voxel that contributes to the surface.

        Raises:
            ValueError: No format has such an ending, or an argument is out of range or does not go with the format.
            FileError: The map has nothing of the kind, or the file cannot be written.
        """
        self._check_surface(lod, min_weight)
        name = os.fspath(path)
        is_octomap = name.lower().endswith((".bt", ".ot"))
        if voxel_size is not None and not is_octomap:
            raise ValueError("voxel_size: it is for OctoMaps (.bt, .ot); `lod` reduces clouds and tiles")
        if is_octomap:
            self._needs_occupancy("an OctoMap")
            if (lod, min_weight) != (0, 1.0):
                raise ValueError("lod, min_weight: they are for surfaces; `voxel_size` reduces an OctoMap")
            if self.origin.any():
                warnings.warn(f"{name}: an OctoMap cannot reach so far, so it counts from the origin of the map: add {self.origin.tolist()}", stacklevel=2)
        _native.export(self._inner, name, None if voxel_size is None else _positive(voxel_size, "voxel_size"), int(lod), float(min_weight))

    def merge_into(self, path: str | os.PathLike[str], *, pose: Pose | None = None, same_frame: bool = True) -> Merged:
        """Adds the map as a session to one on disk, as the command `merge` does: where it lies there is found from surfaces that both have, and its poses are corrected
        to those of the other. The map on disk is replaced when all is written; this one stays as it is. `Map.open(path)` has both then.

        Args:
            path: The directory of the other map, which has the same size of voxels and the same fields.
            pose: About where the frame of this map lies in the frame of the other, if that is known.
            same_frame: Whether both may have the same frame, as maps of one surveyed frame do. Otherwise, as for scans without poses, places alone tell.

        Raises:
            FileNotFoundError: There is nothing of this name.
            FileError: It is not known where this map lies in the other one, or the other one cannot be read or written. It is as it was.
            ValueError: The maps have voxels of different sizes, or different fields.
        """
        path = pathlib.Path(path)
        if not path.exists():
            raise FileNotFoundError(f"{path}: there is nothing of this name; expected the directory of a map")
        exact = None if pose is None else _arrays.pose(pose)
        numbers, by, matrix, edges, bent, said = _native.merge_into(self._inner, path, exact, bool(same_frame))
        for code, text in said:
            warnings.warn(RunWarning(text, code), stacklevel=2)
        return Merged(numbers, by, np.array(matrix), edges, bent)

    @property
    def origin(self) -> NDArray[np.float64]:
        """What all coordinates of the map are counted from: those of submaps, meshes and queries, and what `bounds` says; a point (x, y, z) in the frame of the poses that
        were mapped, metres. Single precision has steps of half a metre at UTM coordinates, so a map of poses far from zero is made around an origin near the
        first of them. It is zero for poses within a few kilometres of zero."""
        return np.array(self._inner.origin())

    def _points(self, points: Any, name: str = "points") -> NDArray[Any]:
        """N x 3 points for a query, metres, counted from the origin. Those that were not are refused: nothing would be known about them."""
        array = _arrays.points(points)
        origin = self.origin
        if origin.any() and len(array):
            first = np.asarray(array[0], dtype=np.float64)
            if np.linalg.norm(first - origin) < np.linalg.norm(first):
                raise ValueError(f"{name}: coordinates of this map count from its origin: pass `{name} - map.origin`, in double precision")
        return array

    def _doubles(self, points: Any, name: str) -> NDArray[np.float64]:
        """The same, N x 3 in metres, in double precision."""
        return np.ascontiguousarray(self._points(points, name), dtype=np.float64)

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
        return _submaps(self._inner.submaps())

    @property
    def poses(self) -> dict[int, NDArray[np.float64]]:
        """Where the scans of the map were taken, as they are known now, after all corrections: the lidar frame in the frame of the poses that were mapped, 4 x 4, by
        node. With the origin: these are the poses of the trajectory."""
        return {node: np.array(pose) for node, pose in self._inner.poses()}

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

    def mesh(self, *, lod: int = 0, min_weight: float = 1.0, surface: Surface = "measured", unfused: bool = False, close_gaps: bool = True, keep_all: bool = False, submap: int | None = None) -> Mesh:
        """The surface of the whole map, or of a submap. Overlapping submaps are fused, so that a place has one surface.

        Args:
            lod: Level of detail: 0 is full resolution, 3 has vertices eight voxels apart.
            min_weight: Smallest number of observations of a voxel that contributes to a measured surface.
            surface: Which surface.
            unfused: Do not fuse: the measured surfaces of all submaps on top of each other. Surfaces of occupancy are always those of the submaps.
            close_gaps: Close gaps of one voxel.
            keep_all: Keep small components, too: pieces of a few triangles that few rays saw. Unfused surfaces and those of submaps always have them.
            submap: Number of a submap, one of those of `submaps`: its own surface, as it is in `unfused`.

        Returns:
            The mesh; without triangles if the map has no such surface.

        Raises:
            ValueError: An argument is out of range, or there is no such submap.
        """
        self._check_surface(lod, min_weight)
        if surface not in ("measured", "occupied", "free", "frontier"):
            raise ValueError(f'surface: expected "measured", "occupied", "free" or "frontier", not {surface!r}')
        if submap is not None:
            self._check_submap(submap)
        arrays = self._inner.mesh(surface, int(lod), float(min_weight), bool(close_gaps), bool(keep_all), bool(unfused), submap)
        return dataclasses.replace(Mesh(*arrays), origin=self.origin)

    def query(self, points: Points) -> Query:
        """Distances to surfaces with their gradients, and whether space is free. `distance` and `state` are faster where that is all you need.

        Where submaps overlap, the distance is the one nearest to zero, and a point is occupied if it is so in any submap.

        Args:
            points: N x 3 coordinates in the map frame, metres. About points that are not finite, nothing is known.

        Raises:
            ValueError: The array has another shape.
        """
        return Query(*self._inner.query(self._points(points)))

    def distance(self, points: Points) -> NDArray[np.float32]:
        """Signed distances to the nearest surface: those of `query`, in a fraction of its time.

        Args:
            points: N x 3 coordinates in the map frame, metres.

        Returns:
            N distances, metres, positive in front of surfaces. They are known in the truncation band around surfaces; NaN elsewhere.

        Raises:
            ValueError: The map has no signed distances, or the array has another shape.
        """
        self._needs_distances("distance")
        return self._inner.distances(self._points(points))

    def state(self, points: Points) -> NDArray[np.uint8]:
        """Whether space is free, occupied or unknown: as `query` tells it, without distances.

        Args:
            points: N x 3 coordinates in the map frame, metres.

        Returns:
            N values of `State`.

        Raises:
            ValueError: The map has no occupancy, or the array has another shape.
        """
        self._needs_occupancy("state")
        return self._inner.states(self._points(points))

    def blocks(self, submap: int) -> list[Blocks]:
        """The signed distances of a submap as dense arrays, for torch and the like: one entry for each size of voxels that it has, finest first.

        Args:
            submap: Its number, one of those of `submaps`.

        Raises:
            ValueError: There is no such submap, or the map has no signed distances.
        """
        self._needs_distances("blocks")
        self._check_submap(submap)
        found = self._inner.blocks(submap) or []
        arrays = []
        for scale, coordinates, distance, weight in found:
            shape = (len(coordinates), *(3 * [8 >> scale]))
            arrays.append(Blocks(coordinates, distance.reshape(shape), weight.reshape(shape), self.voxel_size * 2**scale))
        return arrays

    def ray_cast(
        self, origins: Points, directions: Points, *, max_range: float = 1000.0, unknown_blocks: bool = False
    ) -> RayHits:
        """Where rays end: at the first voxel that is occupied. In maps with signed distances, too, at the surface in it.

        Args:
            origins: N x 3 points in the map frame, or one for all rays.
            directions: N x 3 directions in the map frame, of any length but zero.
            max_range: Length of the rays, metres.
            unknown_blocks: Whether rays end in unknown space, too.

        Raises:
            ValueError: The map has no occupancy, or an array has another shape.
        """
        self._needs_occupancy("ray_cast")
        starts = self._doubles(np.atleast_2d(np.asarray(_arrays.here(origins, "origins"))), "origins")
        rays = _arrays.doubles(directions, "directions")
        if len(starts) not in (1, len(rays)):
            raise ValueError(f"origins: expected one, or as many as directions, which are {len(rays)}, not {len(starts)}")
        return RayHits(*_native.ray_cast(self._inner, starts, rays, _positive(max_range, "max_range"), bool(unknown_blocks)))

    def render_scan(self, pose: Pose, sensor: str = "os1-64", *, columns: int | None = None, max_range: float = 100.0) -> NDArray[np.float32]:
        """What a sensor would measure in the map, from one point, without noise.

        Args:
            pose: The lidar frame in the map frame.
            sensor: Name of a preset, as for the setting `sensor`.
            columns: Number of columns of a revolution; by default that of the preset.
            max_range: Largest range, metres.

        Returns:
            Rows x columns x 3 points in the lidar frame, metres; NaN: no return. `Mapper.integrate` takes it.

        Raises:
            ValueError: The map has no occupancy, or there is no such sensor.
        """
        beams, rows = _native.beam_directions(sensor, columns)
        matrix = _arrays.matrix(pose)
        hits = self.ray_cast(matrix[:3, 3], beams @ matrix[:3, :3].T, max_range=max_range)
        points: NDArray[np.float32] = (beams * hits.distance[:, None]).astype(np.float32)
        return points.reshape(rows, -1, 3)

    def render_depth(self, pose: Pose, intrinsics: ArrayLike, size: tuple[int, int], *, max_range: float = 100.0) -> NDArray[np.float32]:
        """The depth image of a pinhole camera in the map.

        Args:
            pose: The camera frame (x to the right, y down, z forward) in the map frame.
            intrinsics: The 3 x 3 camera matrix, pixels; the centre of the first pixel is (0, 0).
            size: Rows and columns of the image.
            max_range: Largest distance from the camera, metres.

        Returns:
            Rows x columns depths along z, metres; NaN: nothing there.

        Raises:
            ValueError: The map has no occupancy, or the matrix is not that of a camera.
        """
        camera = np.asarray(intrinsics, dtype=np.float64)
        if camera.shape != (3, 3) or not np.isfinite(camera).all() or np.linalg.det(camera) == 0:
            raise ValueError("intrinsics: expected a 3 x 3 camera matrix")
        rows, columns = (int(n) for n in size)
        if rows < 1 or columns < 1:
            raise ValueError(f"size: expected rows and columns, not {size!r}")
        v, u = np.mgrid[:rows, :columns].reshape(2, -1)
        rays = np.stack([u, v, np.ones_like(u)], axis=1) @ np.linalg.inv(camera).T
        matrix = _arrays.matrix(pose)
        hits = self.ray_cast(matrix[:3, 3], rays @ matrix[:3, :3].T, max_range=max_range)
        depth: NDArray[np.float32] = (hits.distance * rays[:, 2] / np.linalg.norm(rays, axis=1)).astype(np.float32)
        return depth.reshape(rows, columns)

    def clearance(self, points: Points, *, up_to: float = 2.0, unknown_blocks: bool = True) -> NDArray[np.float64]:
        """Distances to the nearest obstacles: how large a ball fits.

        Args:
            points: N x 3 coordinates in the map frame, metres.
            up_to: The largest distance of interest, metres: less is faster.
            unknown_blocks: Whether unknown space is an obstacle.

        Returns:
            N distances, metres: 0 in obstacles, `up_to` where none is nearer.

        Raises:
            ValueError: The map has no occupancy, or the array has another shape.
        """
        self._needs_occupancy("clearance")
        return _native.clearance(self._inner, self._doubles(points, "points"), _positive(up_to, "up_to"), bool(unknown_blocks))

    def esdf(self, points: Points, *, max_distance: float = 2.0, unknown_blocks: bool = False) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Distances to the nearest obstacles and their gradients, by a Euclidean distance field. It is computed around the points, and the map keeps it for the next ones:
        asking there again takes a fraction of the time.

        Distances are exact for the voxels of the map, from centre to centre. Where the map has surfaces and only obstacles count, they are corrected by them to a
        fraction of a voxel.

        Args:
            points: N x 3 coordinates in the map frame, metres.
            max_distance: The largest distance that is told apart, metres; at most 48 voxels.
            unknown_blocks: Whether unknown space is an obstacle.

        Returns:
            N distances, metres, at most `max_distance`; N x 3 gradients, away from the obstacle, zero where none is nearer than `max_distance`.

        Raises:
            ValueError: `max_distance` is out of range, the array has another shape, or the map has no occupancy and unknown space is to be an obstacle.
        """
        if unknown_blocks:
            self._needs_occupancy("esdf")
        return _native.esdf(self._inner, self._doubles(points, "points"), _positive(max_distance, "max_distance"), bool(unknown_blocks))

    def slice(
        self, axis: Literal["x", "y", "z"] = "z", at: float = 1.0, *, thickness: float = 0.0, pixel: float | None = None, of: Literal["state", "distance"] | None = None
    ) -> Slice:
        """A cross-section of the whole map.

        Args:
            axis: The axis of the map frame that it is perpendicular to.
            at: Where on that axis, metres.
            thickness: Of the slice from `at` on, metres: pixels are occupied if anything in it is, else free if anything is; distances are those nearest to zero.
            pixel: Edge of a pixel, metres; by default that of the finest voxel.
            of: States or distances; by default states, if the map has occupancy.

        Raises:
            ValueError: The map does not have what is asked for, or it would be larger than 16,384 pixels.
        """
        names = ("x", "y", "z")
        if axis not in names:
            raise ValueError(f'axis: expected "x", "y" or "z", not {axis!r}')
        kind = of or ("state" if self.has_occupancy else "distance")
        if kind not in ("state", "distance"):
            raise ValueError(f'of: expected "state" or "distance", not {of!r}')
        if kind == "state":
            self._needs_occupancy("a slice of states")
        bounds = self.bounds
        if bounds is None or (kind == "distance" and not self.has_distances):
            raise ValueError('the map has no signed distances; make it with field="tsdf" or field="both"')
        if not (np.isfinite(at) and np.isfinite(thickness) and thickness >= 0):
            raise ValueError("at, thickness: expected metres, the thickness 0 or more")
        edge = _positive(self.voxel_size if pixel is None else pixel, "pixel")
        across, up = (k for k in range(3) if k != names.index(axis))
        if max(bounds[1][across] - bounds[0][across], bounds[1][up] - bounds[0][up]) > 16_384 * edge:
            raise ValueError(f"pixel: {edge:g} m would make more than 16,384 pixels along an edge; use larger ones")
        values = _native.slice(self._inner, names.index(axis), float(at), float(thickness), edge, bounds.tolist(), kind == "distance")
        left, bottom = float(bounds[0][across]), float(bounds[0][up])
        return Slice(values, (left, left + values.shape[1] * edge, bottom, bottom + values.shape[0] * edge))

    def plan(
        self,
        start: ArrayLike,
        goal: ArrayLike,
        *,
        radius: float,
        wheels: bool = False,
        step: float | None = None,
        unknown_blocks: bool = True,
        time: float = 1.0,
        samples: int | None = None,
        seed: int = 1,
    ) -> Path:
        """Plans a short path that is free.

        Args:
            start: Where the robot's centre is, map frame, metres. For a wheeled robot at any height above the floor.
            goal: Where it should go.
            radius: Radius of the ball around the centre that must stay free, metres.
            wheels: The robot follows the floor; otherwise it flies.
            step: Largest step of the floor, metres; by default 0.2 m.
            unknown_blocks: Whether unknown space is an obstacle.
            time: Seconds to search for shorter paths.
            samples: Limit of samples. If it is reached before the time, the result is the same on every machine.
            seed: A whole number that the random numbers follow from.

        Raises:
            PlanError: The robot does not fit at an end, and `nearest` is where it does; or no path was found.
            ValueError: The map has no occupancy.
        """
        self._needs_occupancy("plan")
        begin, end = (self._doubles([point], name)[0].tolist() for point, name in ((start, "start"), (goal, "goal")))
        found = _native.plan(self._inner, begin, end, float(radius), bool(wheels), step, bool(unknown_blocks), float(time), samples, int(seed))
        return Path(**found)

    @staticmethod
    def _check_surface(lod: int, min_weight: float) -> None:
        if lod not in (0, 1, 2, 3):
            raise ValueError(f"lod: expected 0, 1, 2 or 3, not {lod!r}")
        if not 0 <= min_weight <= 1000:
            raise ValueError(f"min_weight: expected a number from 0 to 1000, not {min_weight!r}")

    def _check_submap(self, number: int) -> None:
        known = [submap.id for submap in self.submaps]
        if number not in known:
            raise ValueError(f"submap: there is none with number {number}; there are {known}")

    def _needs_distances(self, what: str) -> None:
        if not self.has_distances:
            raise ValueError(f'{what} needs signed distances, which the map does not have; make it with field="tsdf" or field="both"')

    def _needs_occupancy(self, what: str) -> None:
        if not self.has_occupancy:
            raise ValueError(f'{what} needs free and occupied space, which the map does not have; make it with field="occupancy" or field="both"')

    def _repr_html_(self) -> str:
        """For notebooks: a line of text, and a picture from above unless the map is large."""
        if self._inner.is_closed():
            return _picture.html(repr(self), None, 1.0)
        mesh = self.mesh(lod=1, unfused=True) if self.nbytes < _PICTURE_BYTES else None
        return _picture.html(repr(self), mesh, 2 * self.voxel_size)

    def __repr__(self) -> str:
        if self._inner.is_closed():
            return "Map(closed)"
        fields = [name for name, has in (("distances", self.has_distances), ("occupancy", self.has_occupancy)) if has]
        submaps = self._inner.submaps()
        scans = sum(len(nodes) for _, _, nodes, _ in submaps)
        parts = [f"{scans:,} scans", f"{len(submaps):,} submaps", f"voxels of {self.voxel_size:g} m", " and ".join(fields) or "empty", f"{self.nbytes / 1e6:.1f} MB"]
        return f"Map({', '.join(parts)})"
