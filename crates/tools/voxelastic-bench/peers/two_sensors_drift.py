"""Drift of the odometry of each of two sensors, and of both merged into one scan, on a simulated recording with true poses.

    voxelastic simulate street -o drive --bag --sensor vlp-16 --second-lidar vlp-16 --columns 900 --rate 10 --moving --scans 400
    python3 two_sensors_drift.py drive

Needs voxelastic and scipy. A merged scan is one of the first sensor, with the points of the scan of the second that is nearest in time, moved by its place on
the first and with their own times. Both are stamped in turns, half a period apart; true poses between scans are interpolated.
"""
import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

import voxelastic as vx

# Where `simulate --second-lidar` puts the second sensor on the first.
MOUNT = np.eye(4)
MOUNT[:3, :3] = Rotation.from_quat([-0.3420201433, 0, 0.9396926208, 0]).as_matrix()
MOUNT[:3, 3] = [-0.6, 0, -0.3]


def true_poses(path):
    """The pose of the first sensor at any time of the drive."""
    rows = np.loadtxt(path)
    turns = Slerp(rows[:, 0], Rotation.from_quat(rows[:, 4:]))

    def at(time):
        pose = np.eye(4)
        pose[:3, 3] = [np.interp(time, rows[:, 0], rows[:, k]) for k in (1, 2, 3)]
        pose[:3, :3] = turns(time).as_matrix()
        return pose

    return at, rows[-1, 0]


def drift(name, scans, true_at, of_sensor):
    """Prints the errors of the poses of a sensor, `of_sensor` in the frame of the first."""
    odometry, found, true = vx.Odometry(), [], []
    for time, points, times in scans:
        report = odometry.register(points, time=time, times=times)
        if report.status != "failed":
            found.append(report.pose)
            true.append(true_at(time) @ of_sensor)
    errors = vx.trajectory_errors(np.array(found), np.array(true))
    print(
        f"{name:6s} {len(found)} of {len(scans)} scans, {errors.path_length:.0f} m: rmse {errors.translation['rmse']:.2f} m, "
        f"{errors.rotation['rmse']:.2f} degrees; largest {errors.translation['max']:.2f} m",
        flush=True,
    )


def main():
    drive = Path(sys.argv[1])
    true_at, end = true_poses(drive / "groundtruth.tum")

    def scans(topic):
        data = vx.Dataset.open(drive / "recording.mcap", cloud_topic=topic, slam=True, every="scan")
        return [(s.time, s.points.reshape(-1, 3), s.times) for s in data if s.time <= end]

    first, second = scans("/points"), scans("/points_2")
    stamps = np.array([scan[0] for scan in second])
    both = []
    for time, points, times in first:
        other_time, other, other_times = second[int(np.abs(stamps - time).argmin())]
        moved = np.where(np.abs(other).sum(1, keepdims=True) > 0, other @ MOUNT[:3, :3].T + MOUNT[:3, 3], np.nan).astype(np.float32)
        both.append((time, np.concatenate([points, moved]), np.concatenate([times, other_times + np.float32(other_time - time)])))
    drift("first", first, true_at, np.eye(4))
    drift("second", second, true_at, MOUNT)
    drift("both", both, true_at, np.eye(4))


if __name__ == "__main__":
    main()
