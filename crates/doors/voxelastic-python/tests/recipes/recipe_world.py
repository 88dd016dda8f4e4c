"""A walk through the simulated room with a sensor of any kind: every beam is cast along the exact distances of the world, from where the sensor was just then."""

from __future__ import annotations

import dataclasses
import functools
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import voxelastic as vx

Array = NDArray[np.float64]

SWEEP_S = 0.1
STEPS = 40
NEAR_M = 3e-4
"""A beam goes on by the distance to the nearest surface until it is so near; one that is not there after so many steps grazes an edge, and has no return."""
NOISE_M = 0.005
GRAVITY = 9.81


@functools.cache
def world() -> vx.Simulation:
    """A closed room of 10 x 8 x 3 m with a crate, a pillar, a ball and a rail."""
    return vx.Simulation("room", scans=2)


def rigid(translation: ArrayLike, rotation: ArrayLike | None = None) -> Array:
    """A pose as a matrix, 4 x 4."""
    pose = np.eye(4)
    pose[:3, 3] = translation
    if rotation is not None:
        pose[:3, :3] = rotation
    return pose


def rotations(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike) -> Array:
    """Rotations about x, then y, then z of the map: N x 3 x 3 of N angles in radians, 3 x 3 of one."""
    (a, b, c), (d, e, f) = (np.cos(np.array([roll, pitch, yaw], float)), np.sin(np.array([roll, pitch, yaw], float)))
    rows = [[b * c, d * e * c - a * f, a * e * c + d * f], [b * f, d * e * f + a * c, a * e * f - d * c], [-e, d * b, a * b]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def quaternion(rotation: Array) -> Array:
    """x, y, z, w of a rotation matrix."""
    m = rotation
    squares = np.array([1 + m[0, 0] - m[1, 1] - m[2, 2], 1 - m[0, 0] + m[1, 1] - m[2, 2], 1 - m[0, 0] - m[1, 1] + m[2, 2], 1 + np.trace(m)])
    largest = int(squares.argmax())
    rows = [
        [squares[0], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[2, 1] - m[1, 2]],
        [m[0, 1] + m[1, 0], squares[1], m[1, 2] + m[2, 1], m[0, 2] - m[2, 0]],
        [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], squares[2], m[1, 0] - m[0, 1]],
        [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], squares[3]],
    ]
    found: Array = np.array(rows[largest]) / np.linalg.norm(rows[largest])
    return found


@dataclasses.dataclass(frozen=True)
class Walk:
    """A loop through the room at about 0.9 m/s, with the sway of somebody who walks. It begins at rest."""

    rest: float = 0.0
    """Seconds at rest, before a second and a half in which the walk begins."""

    def way(self, times: Array) -> Array:
        """Radians of the loop that lie behind the sensor."""
        speed, start = 0.5, 1.5
        if self.rest == 0:
            return speed * times
        since = np.clip(times - self.rest, 0, None)
        share = np.minimum(since / start, 1)
        return speed * np.where(since < start, start * share**3 * (1 - 0.5 * share), since - start / 2)

    def poses(self, times: ArrayLike) -> Array:
        """N x 4 x 4: the sensor in the map frame at N times; 4 x 4 at one."""
        way = self.way(np.asarray(times, float))
        pose = np.zeros((*way.shape, 4, 4))
        pose[..., 3, 3] = 1
        pose[..., 0, 3] = 2.2 * np.sin(way)
        pose[..., 1, 3] = -1.5 * np.cos(way)
        pose[..., 2, 3] = 1.2 + 0.02 * np.sin(9 * way)
        pose[..., :3, :3] = rotations(0.03 * np.sin(7 * way), 0.03 * np.sin(5 * way + 1) - 0.03 * np.sin(1), way + 0.15 * np.sin(3 * way))
        return pose

    def imu(self, times: Array, t_lidar_imu: NDArray[Any]) -> tuple[Array, Array]:
        """Angular velocity and specific force, N x 3 each, along the axes of a unit at this place beside the sensor."""
        step = 1e-3
        before, at, after = (self.poses(times + k * step) @ t_lidar_imu for k in (-1, 0, 1))
        turned = np.einsum("nji,njk->nik", before[:, :3, :3], after[:, :3, :3])
        skew = (turned - np.swapaxes(turned, 1, 2)) / (4 * step)
        acceleration = (before[:, :3, 3] - 2 * at[:, :3, 3] + after[:, :3, 3]) / step**2 + [0, 0, GRAVITY]
        return skew[:, [2, 0, 1], [1, 2, 0]], np.einsum("nji,nj->ni", at[:, :3, :3], acceleration)


@dataclasses.dataclass(frozen=True)
class Beams:
    """What a sensor looks along during a sweep. All arrays have N entries, in the order in which its driver lists the points."""

    directions: Array
    """N x 3 unit vectors in the sensor's frame."""
    times: Array
    """Seconds since the sweep began."""
    rings: NDArray[np.int64]
    origins: Array | float = 0.0
    """N x 3: where the beams begin in the sensor's frame."""


def spinning(elevations: ArrayLike, columns: int, *, by_column: bool = False, forward: str = "x") -> Beams:
    """A sensor that turns clockwise, from behind it, ring by ring or column by column; `forward` is the axis that points ahead: x, or y with x to the right."""
    rows = np.deg2rad(np.asarray(elevations, float))
    azimuth = np.pi - 2 * np.pi * (np.arange(columns) + 0.5) / columns
    ahead = 0.0 if forward == "x" else np.pi / 2
    ring, column = (index.ravel("F" if by_column else "C") for index in np.meshgrid(np.arange(len(rows)), np.arange(columns), indexing="ij"))
    e, a = rows[ring], azimuth[column] + ahead
    directions = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)
    return Beams(directions, SWEEP_S * column / columns, ring)


def rosette(points: int, sweep: int) -> Beams:
    """A Livox with a full circle of view: four lines that wander between 7 degrees below and 52 above the horizon, never twice along the same curve."""
    k = np.arange(points)
    turn = k / points + sweep
    line = k % 4
    azimuth = 2 * np.pi * (20.37 * turn + 0.013 * line)
    elevation = np.deg2rad(22.5 + 29.5 * np.sin(2 * np.pi * (53.71 * turn + 0.25 * line)))
    directions = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=1)
    return Beams(directions, SWEEP_S * k / points, line)


def sweep(poses: Callable[[Array], Array], begin: float, beams: Beams, *, from_one_place: bool = False, seed: int = 0) -> Array:
    """N x 3 points in the sensor's frame: each in that of its own time, as drivers publish them, or all in that of `begin`. NaN where nothing came back."""
    times = np.full(len(beams.times), begin) if from_one_place else begin + beams.times
    at = poses(times)
    directions = np.einsum("nij,nj->ni", at[:, :3, :3], beams.directions)
    origins = at[:, :3, 3] + np.einsum("nij,nj->ni", at[:, :3, :3], np.broadcast_to(beams.origins, beams.directions.shape))
    ranges = np.zeros(len(times))
    under_way, at_last, ways = np.arange(len(times)), origins, directions
    for _ in range(STEPS):
        if len(under_way) == 0:
            break
        distance = world().distance(at_last)
        ranges[under_way] += distance
        more = distance > NEAR_M
        under_way, ways = under_way[more], ways[more]
        at_last = at_last[more] + distance[more, None] * ways
    ranges += np.random.default_rng(seed).normal(0, NOISE_M, len(ranges))
    ranges[under_way] = np.nan
    return beams.directions * ranges[:, None] + beams.origins


def undistorted(points: Array, poses: Callable[[Array], Array], begin: float, beams: Beams, at: float) -> Array:
    """The points of a sweep in the sensor's frame of one time."""
    moved = np.linalg.inv(poses(np.array(at))) @ poses(begin + beams.times)
    there: Array = np.einsum("nij,nj->ni", moved[:, :3, :3], points) + moved[:, :3, 3]
    return there


def intensities(points: Array) -> NDArray[np.float32]:
    """Strengths of returns, 0 to 255, that decrease with the distance."""
    strengths: NDArray[np.float32] = np.nan_to_num(200 / (1 + np.linalg.norm(points, axis=1))).astype(np.float32)
    return strengths


@dataclasses.dataclass(frozen=True)
class Measured:
    """How far a map is from the world, metres."""

    median: float
    most: float
    """95 % of the mesh are nearer to the world's surface."""
    complete: float
    """Share of the world's surface around the walk that has the mesh within 5 cm."""
    map: vx.Map

    def __str__(self) -> str:
        return f"{100 * self.median:.2f} cm in the median, 95 % within {100 * self.most:.2f} cm, {100 * self.complete:.1f} % of the surface"


def fitted(vertices: Array, pose: Array) -> Array:
    """The pose, near `pose`, under which vertices lie best on the surfaces of the world: least squares of distances below 0.3 m."""
    some = vertices[:: max(1, len(vertices) // 5000)]
    for _ in range(20):
        at = some @ pose[:3, :3].T + pose[:3, 3]
        distance = world().distance(at)
        slope = np.stack([world().distance(at + step) - world().distance(at - step) for step in 1e-3 * np.eye(3)], axis=1) / 2e-3
        near = np.abs(distance) < 0.3
        design = np.hstack([np.cross(at, slope), slope])[near]
        change = np.linalg.lstsq(design, -distance[near], rcond=None)[0]
        pose = rigid(change[3:], rotations(*change[:3])) @ pose
    return pose


def measured(path: Path, t_world_map: ArrayLike = np.eye(4), *, fit: bool = False, up_to: float = 2.8) -> Measured:
    """Compares a saved map with the world. With `fit`, where the map lies may differ a little from `t_world_map`: odometry says where its own frame is only by what it saw first.
    Whether the surface is complete is asked up to a height, metres: not every sensor looks up."""
    made = vx.Map.open(path)
    mesh = made.mesh()
    assert len(mesh) > 500, f"a mesh of {len(mesh)} triangles"
    vertices = mesh.vertices + mesh.origin
    pose = np.asarray(t_world_map, float)
    if fit:
        pose = fitted(vertices, pose)
    distance = np.abs(world().distance(vertices @ pose[:3, :3].T + pose[:3, 3]))
    surface = world().surface(0.2, max_range=30).astype(np.float64)
    back = np.linalg.inv(pose)
    inside = surface[(surface[:, 2] > 0.2) & (surface[:, 2] < up_to)]
    covered = mesh.distance((inside @ back[:3, :3].T + back[:3, 3] - mesh.origin).astype(np.float32)) < 0.05
    return Measured(float(np.median(distance)), float(np.quantile(distance, 0.95)), float(covered.mean()), made)


def voxelastic(*words: object, fails: bool = False) -> str:
    """Runs the command, and returns what it says on both channels."""
    done = subprocess.run([sys.executable, "-m", "voxelastic", *map(str, words)], capture_output=True, text=True, timeout=600)
    assert (done.returncode != 0) == fails, done.stdout + done.stderr
    return done.stdout + done.stderr


SMALL = ("--voxel-size", "0.05", "--max-range", "15", "--overwrite")
"""Settings for maps of the room that are made in a second or two."""
