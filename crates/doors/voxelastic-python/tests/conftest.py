"""A simulated room, as a spinning sensor with 32 rings and 360 columns sees it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import voxelastic as vx

# Half of the room's edges, metres; the sensor is near its centre.
ROOM = np.array([4.0, 3.0, 1.5])

Scan = tuple[NDArray[np.float32], NDArray[np.float64]]


def pose_at(x: float, y: float, yaw: float) -> NDArray[np.float64]:
    """The lidar in the map frame."""
    cosine, sine = np.cos(yaw), np.sin(yaw)
    return np.array([[cosine, -sine, 0, x], [sine, cosine, 0, y], [0, 0, 1, 0.1], [0, 0, 0, 1.0]])


def scan_at(pose: NDArray[np.float64]) -> NDArray[np.float32]:
    """32 x 360 x 3 points of the room's walls in the lidar frame."""
    elevation = np.deg2rad(np.linspace(25, -25, 32))[:, None]
    # No beam is parallel to a wall.
    azimuth = -np.deg2rad(np.arange(360) + 0.5)[None, :]
    beams = np.stack(np.broadcast_arrays(np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)), axis=-1)
    directions = beams @ pose[:3, :3].T
    range_to_wall = ((np.sign(directions) * ROOM - pose[:3, 3]) / directions).min(axis=-1)
    points: NDArray[np.float32] = (beams * range_to_wall[..., None]).astype(np.float32)
    return points


def with_box(points: NDArray[np.float32], pose: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float32]:
    """The scan with a box in the room."""
    beams = points.astype(np.float64) @ pose[:3, :3].T
    with np.errstate(divide="ignore"):
        ends = np.stack([(low - pose[:3, 3]) / beams, (high - pose[:3, 3]) / beams])
    enter, leave = ends.min(axis=0).max(axis=-1), ends.max(axis=0).min(axis=-1)
    hits = (enter < leave) & (enter > 0) & (enter < 1)
    return np.where(hits[..., None], points * enter[..., None], points).astype(np.float32)


def room_scans(count: int) -> list[Scan]:
    """Scans on a short path through the room."""
    poses = [pose_at(-1 + 2 * k / count, 0.3 * np.sin(k), 0.2 * k) for k in range(count)]
    return [(scan_at(pose), pose) for pose in poses]


def distance_to_walls(points: NDArray[Any]) -> NDArray[np.float64]:
    """Distance to the nearest wall, from within the room."""
    distance: NDArray[np.float64] = (ROOM - np.abs(points)).min(axis=-1)
    return distance


@pytest.fixture(scope="session")
def scans() -> list[Scan]:
    return room_scans(8)


@pytest.fixture(scope="session")
def make_map(scans: list[Scan]) -> Callable[..., vx.Map]:
    def make(**settings: object) -> vx.Map:
        mapper = vx.Mapper(vx.Settings(voxel_size=0.05, max_range=20).replace(**settings))
        for points, pose in scans:
            mapper.integrate(points, pose)
        return mapper.finish()

    return make


@pytest.fixture(scope="session")
def room(make_map: Callable[..., vx.Map]) -> vx.Map:
    """A map with both fields."""
    return make_map(field="both")


@pytest.fixture(scope="session")
def solid(make_map: Callable[..., vx.Map]) -> vx.Map:
    """A map with both fields, of voxels so large that the walls have no holes between the beams."""
    return make_map(field="both", voxel_size=0.1)


@pytest.fixture
def saved(room: vx.Map, tmp_path: Path) -> Path:
    room.save(tmp_path / "room.vox")
    return tmp_path / "room.vox"
