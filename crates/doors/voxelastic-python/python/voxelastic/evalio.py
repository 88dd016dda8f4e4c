"""The odometry of this package as a pipeline of evalio, which runs it on its data sets beside others and compares the trajectories:

    EVALIO_CUSTOM=voxelastic.evalio evalio run -d newer_college_2020/short_experiment -p voxelastic -p kiss -o results
    evalio stats results

Needs `pip install 'voxelastic[evalio]'`.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from ._estimation import Odometry
from ._needs import missing

try:
    from evalio.pipelines import Pipeline, register_pipeline
    from evalio.types import SE3, ImuMeasurement, ImuParams, LidarMeasurement, LidarParams, Point
except ModuleNotFoundError as error:
    raise missing(error, "evalio") from None

__all__ = ["Voxelastic"]


class Voxelastic(Pipeline):
    """`voxelastic.Odometry`: scans alone, without the inertial unit and without loop closures. Estimates are poses of the inertial unit at the begin of each sweep, as evalio wants them;
    a scan that cannot be registered has none.

    Parameters: `voxel_size`, metres, 0 for the one that follows from the first scan; `min_range` and `max_range`, metres, 0 for those of the data set's sensor; `deskew`.
    """

    def __init__(self) -> None:
        super().__init__()
        self._params: dict[str, bool | int | float | str] = self.default_params()
        self._sensor_range = (0.5, 100.0)
        self._t_imu_lidar: NDArray[np.float64] = np.eye(4)
        self._odometry: Odometry | None = None
        self._piece = 0
        # Where the frame of the piece is in that of the first scan, and the last pose there.
        self._t_first_piece: NDArray[np.float64] = np.eye(4)
        self._t_first_lidar: NDArray[np.float64] = np.eye(4)

    @staticmethod
    def name() -> str:
        """The name in evalio's configurations."""
        return "voxelastic"

    @staticmethod
    def version() -> str:
        """The version of this package."""
        return version("voxelastic")

    @staticmethod
    def url() -> str:
        """Where to read more."""
        return "https://github.com/voxelastic/voxelastic"

    @staticmethod
    def default_params() -> dict[str, bool | int | float | str]:
        """The parameters with their defaults."""
        return {"voxel_size": 0.0, "min_range": 0.0, "max_range": 0.0, "deskew": True}

    def set_params(self, params: Mapping[str, bool | int | float | str]) -> dict[str, bool | int | float | str]:
        """Takes the parameters of a configuration, and returns those that it does not know."""
        self._params |= {key: value for key, value in params.items() if key in self._params}
        return {key: value for key, value in params.items() if key not in self._params}

    def set_imu_params(self, params: ImuParams) -> None:
        """Nothing: the inertial unit is not used."""

    def set_lidar_params(self, params: LidarParams) -> None:
        """Takes the range of the sensor, metres."""
        self._sensor_range = (params.min_range, params.max_range)

    def set_imu_T_lidar(self, T: SE3) -> None:  # noqa: N802, N803
        """Takes the lidar frame in the frame of the inertial unit."""
        self._t_imu_lidar = np.array(T.to_mat())

    def initialize(self) -> None:
        """Begins anew with the parameters."""
        nearest, farthest = (self._params[key] or of_sensor for key, of_sensor in zip(("min_range", "max_range"), self._sensor_range, strict=True))
        voxel_size = float(self._params["voxel_size"]) or None
        # A range of 0 is every range.
        self._odometry = Odometry(
            voxel_size=voxel_size, min_range=max(float(nearest), 1e-3), max_range=float(farthest), deskew=bool(self._params["deskew"])
        )
        self._piece, self._t_first_piece, self._t_first_lidar = 0, np.eye(4), np.eye(4)

    def add_imu(self, mm: ImuMeasurement) -> None:
        """Nothing: the inertial unit is not used."""

    def add_lidar(self, mm: LidarMeasurement) -> None:
        """Registers a scan, and saves its pose."""
        if self._odometry is None:
            self.initialize()
        assert self._odometry is not None
        points = np.array(mm.to_vec_positions()).reshape(-1, 3)
        report = self._odometry.register(points, time=mm.stamp.to_sec(), times=np.array(mm.to_vec_stamps()))
        if report.problem is not None:
            return
        if report.piece != self._piece:
            # It goes on where the last scan was: nothing better is known.
            self._piece, self._t_first_piece = report.piece, self._t_first_lidar @ np.linalg.inv(report.pose)
        self._t_first_lidar = self._t_first_piece @ report.pose
        self.save(mm.stamp, SE3.from_mat(self._t_first_lidar @ np.linalg.inv(self._t_imu_lidar)))

    def map(self) -> dict[str, list[Point]]:
        """None: the local map stays within the odometry."""
        return {}


# Whoever imports this module has the pipeline, with `EVALIO_CUSTOM` or without.
register_pipeline(Voxelastic)
