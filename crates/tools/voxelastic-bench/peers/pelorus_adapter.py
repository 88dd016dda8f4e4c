"""Pelorus as a peer of `voxelastic-bench --slam`: odometry with an inertial measurement unit, with its defaults.

    python3 pelorus_adapter.py request.json
"""
import time

from slam import ABSENT, NOT_HERE, REQUEST, at_stamps, emit, leave, measure, np

try:
    from importlib.metadata import version

    import pelorus
except ImportError:
    leave(ABSENT, "Pelorus is left out: pip install pelorus numpy (VOXELASTIC_PYTHON names the Python)")
if not REQUEST.get("imu"):
    leave(NOT_HERE, "Pelorus needs an inertial measurement unit, which this recording does not have")

emit(system=f"Pelorus {version('pelorus')}")
BEGIN = 1000  # its times begin after 0
PATIENCE_S = 2.0  # it answers from a thread of its own, and some scans not at all


def stamp(seconds):
    nanoseconds = round(seconds * 1e9)
    return {"timestamp_sec": BEGIN + nanoseconds // 10**9, "timestamp_nanosec": nanoseconds % 10**9}


# user code: begin
odometry = pelorus.Handle()
# Time, angular velocity and specific force, at the lidar and along its axes.
samples = np.fromfile(REQUEST["imu"], np.float64).reshape(-1, 7)
number, taken, found = 0, 0, []


def register(points, times):
    global number, taken
    begin = REQUEST["scans"][number]["time_s"]
    number += 1
    odometry.add_pointcloud(np.column_stack([points, np.rint((times - times.min()) * 1e9)]), **stamp(begin + times.min()))
    # Until half a turn after its end: without samples beyond it, it waits.
    until = int(np.searchsorted(samples[:, 0], begin + times.max() + 0.05))
    for row in samples[taken:until]:
        odometry.add_imu(
            orientation=[1, 0, 0, 0], orientation_covariance=[-1] + [0] * 8, angular_velocity=list(row[1:4]), angular_velocity_covariance=[0] * 9,
            linear_acceleration=list(row[4:7]), linear_acceleration_covariance=[0] * 9, **stamp(row[0]),
        )
    taken = until
    deadline = time.monotonic() + PATIENCE_S
    while (answer := odometry.try_recv()) is None and time.monotonic() < deadline:
        time.sleep(0.001)
    while answer is not None:
        found.append(answer)
        answer = odometry.try_recv()
    return None
# user code: end


def pose_of(answer):
    w, x, y, z = answer["orientation"]
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = answer["position"]
    return pose


measure(register)
if len(found) > 1:
    ends = [answer["timestamp_sec"] - BEGIN + answer["timestamp_nanosec"] * 1e-9 for answer in found]
    at_stamps(ends, [pose_of(answer) for answer in found])
