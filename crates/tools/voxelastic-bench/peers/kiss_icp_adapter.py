"""KISS-ICP as a peer of `voxelastic-bench --slam`: odometry, with its defaults.

    python3 kiss_icp_adapter.py request.json
"""
from slam import ABSENT, REQUEST, at_stamps, emit, leave, measure, np

try:
    from importlib.metadata import version

    from kiss_icp.config import KISSConfig
    from kiss_icp.kiss_icp import KissICP
except ImportError:
    leave(ABSENT, "KISS-ICP is left out: pip install kiss-icp (VOXELASTIC_PYTHON names the Python)")

emit(system=f"KISS-ICP {version('kiss-icp')}")
# user code: begin
config = KISSConfig()
has_times = bool(REQUEST["scans"]) and "time_s" in REQUEST["scans"][0]
config.data.deskew = has_times
config.data.max_range, config.data.min_range = REQUEST["max_range_m"], REQUEST["min_range_m"]
config.registration.max_num_threads, config.mapping.voxel_size = REQUEST["threads"], REQUEST["max_range_m"] / 100
odometry = KissICP(config)
# user code: end


ends, poses = [], []


def register(points, times):
    # Its times go from 0 at the begin of the sweep to 1 at the end, whose pose it finds.
    # user code: begin
    span = np.ptp(times) if len(times) else 0
    odometry.register_frame(points, (times - times.min()) / span if span > 0 else np.zeros(0))
    # user code: end
    if has_times:
        ends.append(REQUEST["scans"][len(ends)]["time_s"] + (times.max() if len(times) else 0))
        poses.append(odometry.last_pose)
    return odometry.last_pose


measure(register)
if len(poses) > 1:
    at_stamps(ends, poses)
