"""GenZ-LIO as a peer of `voxelastic-bench --slam`: odometry with an inertial measurement unit, with its defaults.

    python3 genz_lio_adapter.py request.json
"""
from slam import ABSENT, NOT_HERE, REQUEST, at_stamps, emit, leave, measure, np

try:
    import genz_lio
except ImportError:
    leave(ABSENT, "GenZ-LIO is left out: pip install genz-lio (VOXELASTIC_PYTHON names the Python)")
if not REQUEST.get("imu"):
    leave(NOT_HERE, "GenZ-LIO needs an inertial measurement unit, which this recording does not have")

emit(system=f"GenZ-LIO {genz_lio.__version__}")
# user code: begin
config = genz_lio.Config()
config.max_threads = REQUEST["threads"]
config.preprocess.lidar_type, config.preprocess.scan_line = genz_lio.LidarType.OUSTER, 64
config.preprocess.blind_min, config.preprocess.blind_max = REQUEST["min_range_m"], REQUEST["max_range_m"]
odometry = genz_lio.GenZLIO(config)
# Time, specific force and angular velocity, in this order, at the lidar and along its axes.
samples = np.fromfile(REQUEST["imu"], np.float64).reshape(-1, 7)[:, [0, 4, 5, 6, 1, 2, 3]]
ends, poses, taken = [], [], 0


def register(points, times):
    global taken
    begin = REQUEST["scans"][len(ends)]["time_s"]
    end = begin + (times.max() if len(times) else 0)
    until = int(np.searchsorted(samples[:, 0], end, side="right"))
    result = odometry.register_scan(points, begin + BEGIN, end + BEGIN, samples[taken:until] + [BEGIN, 0, 0, 0, 0, 0, 0], timestamps=times)
    taken = until
    ends.append(end)
    poses.append(np.array(result.pose) if result.valid or not poses else poses[-1])
    return poses[-1]
# user code: end


BEGIN = 1000.0  # its times begin after 0
measure(register)
if len(poses) > 1:
    at_stamps(ends, poses)
