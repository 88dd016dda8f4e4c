"""A data set of evalio: the simulated walk, as a sensor sees it that is mounted on an inertial unit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from enum import auto
from pathlib import Path

import numpy as np
from evalio.datasets import Dataset, DatasetIterator
from evalio.types import SE3, Duration, ImuMeasurement, ImuParams, LidarMeasurement, LidarParams, Point, Stamp, Trajectory
from recipe_world import SWEEP_S, Walk, rigid, rotations, spinning, sweep

BEGIN = 1_700_000_000
SWEEPS = 40
ROWS, COLUMNS = 32, 180
WALK = Walk()
T_IMU_LIDAR = rigid([0.05, -0.1, 0.2], rotations(0, 0, 2.0))


def stamp(sweeps: int) -> Stamp:
    """When a sweep began."""
    return Stamp.from_nsec(BEGIN * 10**9 + sweeps * 10**8)


class Sweeps(DatasetIterator):
    """Sweeps, and a sample of the unit before each."""

    def lidar_iter(self) -> Iterator[LidarMeasurement]:
        beams = spinning(np.linspace(15, -25, ROWS), COLUMNS)
        for k in range(SWEEPS):
            points = np.nan_to_num(sweep(WALK.poses, SWEEP_S * k, beams, seed=k))
            each = zip(points.tolist(), np.round(1e9 * beams.times).astype(int).tolist(), beams.rings.tolist(), strict=True)
            yield LidarMeasurement(stamp(k), [Point(x=x, y=y, z=z, t=Duration.from_nsec(t), row=row) for (x, y, z), t, row in each])

    def imu_iter(self) -> Iterator[ImuMeasurement]:
        for k in range(SWEEPS):
            yield ImuMeasurement(stamp(k), np.zeros(3), np.array([0, 0, 9.81]))

    def __iter__(self) -> Iterator[ImuMeasurement | LidarMeasurement]:
        for sample, scan in zip(self.imu_iter(), self.lidar_iter(), strict=True):
            yield sample
            yield scan

    def __len__(self) -> int:
        return SWEEPS


class SimulatedWalk(Dataset):
    """The walk through the room."""

    room = auto()

    def data_iter(self) -> DatasetIterator:
        return Sweeps()

    def ground_truth_raw(self) -> Trajectory:
        poses = WALK.poses(SWEEP_S * np.arange(SWEEPS)) @ np.linalg.inv(T_IMU_LIDAR)
        return Trajectory(stamps=[stamp(k) for k in range(SWEEPS)], poses=[SE3.from_mat(pose) for pose in poses])

    def imu_T_lidar(self) -> SE3:  # noqa: N802
        return SE3.from_mat(T_IMU_LIDAR)

    def imu_T_gt(self) -> SE3:  # noqa: N802
        return SE3.identity()

    def imu_params(self) -> ImuParams:
        return ImuParams.up()

    def lidar_params(self) -> LidarParams:
        return LidarParams(num_rows=ROWS, num_columns=COLUMNS, min_range=0.3, max_range=30.0)

    def files(self) -> Sequence[str | Path]:
        return []

    def quick_len(self) -> int:
        return SWEEPS
