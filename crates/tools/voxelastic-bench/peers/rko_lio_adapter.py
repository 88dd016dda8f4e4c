"""RKO-LIO as a peer of `voxelastic-bench --slam`: odometry with an inertial measurement unit, with its defaults.

    python3 rko_lio_adapter.py request.json
"""
from slam import ABSENT, NOT_HERE, REQUEST, at_stamps, emit, leave, measure, np

try:
    from importlib.metadata import version

    from rko_lio.config import LIOConfig
    from rko_lio.lio import LIO
except ImportError:
    leave(ABSENT, "RKO-LIO is left out: pip install rko-lio (VOXELASTIC_PYTHON names the Python)")
if not REQUEST.get("imu"):
    leave(NOT_HERE, "RKO-LIO needs an inertial measurement unit, which this recording does not have")

emit(system=f"RKO-LIO {version('rko-lio')}")
# Time, angular velocity and specific force, at the lidar and along its axes.
samples = np.fromfile(REQUEST["imu"], np.float64).reshape(-1, 7)
# user code: begin
config = LIOConfig(max_num_threads=REQUEST["threads"], max_range=REQUEST["max_range_m"], min_range=REQUEST["min_range_m"], initialization_phase=True)
odometry = LIO(config)
ends, poses, taken = [], [], 0


def register(points, times):
    global taken
    begin = REQUEST["scans"][len(ends)]["time_s"]
    stamps = begin + times
    end = stamps.max() if len(stamps) else begin
    while taken < len(samples) and samples[taken, 0] <= end:
        odometry.add_imu_measurement(samples[taken, 4:7], samples[taken, 1:4], nanoseconds(samples[taken, 0]))
        taken += 1
    odometry.register_scan(points, np.array([nanoseconds(t) for t in stamps]))
    ends.append(end)
    poses.append(np.array(odometry.pose()))
    return poses[-1]
# user code: end


def nanoseconds(seconds):
    # It takes no times before 0.
    return int(round((seconds + 100) * 1e9))


measure(register)
if len(poses) > 1:
    at_stamps(ends, poses)
