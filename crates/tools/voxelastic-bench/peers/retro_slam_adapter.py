"""RETRO-SLAM as a peer of `voxelastic-bench --slam`: odometry, closures and its pose graph, with its defaults.

    python3 retro_slam_adapter.py request.json
"""
from slam import ABSENT, REQUEST, emit, leave, measure, np, rows

try:
    from importlib.metadata import version

    from retro_slam.config import load_config
    from retro_slam.slam import RetroSLAM
except ImportError:
    leave(ABSENT, "RETRO-SLAM is left out: pip install retro-slam map-closures pydantic-settings (VOXELASTIC_PYTHON names the Python)")

emit(system=f"RETRO-SLAM {version('retro-slam')}")
has_times = bool(REQUEST["scans"]) and "time_s" in REQUEST["scans"][0]
# user code: begin
config = load_config(None)
config.odometry.preprocessing.deskew = has_times
config.odometry.preprocessing.max_range, config.odometry.preprocessing.min_range = REQUEST["max_range_m"], REQUEST["min_range_m"]
config.odometry.registration.max_num_threads = REQUEST["threads"]
config.odometry.mapping.voxel_size = REQUEST["max_range_m"] / 100
slam = RetroSLAM(config)


def register(points, times):
    span = np.ptp(times) if len(times) else 0
    slam.process_scan(points, (times - times.min()) / span if span > 0 else np.zeros(0))
    return None
# user code: end


if measure(register):
    slam.exit()
    emit(poses=[rows(pose) for pose in slam.poses[: len(REQUEST["scans"])]])
    for closure in slam.loop_closures:
        # Of key poses, which say not of which scan they are: the nearest pose of a scan stands for each.
        ends = [int(np.abs(slam.poses[:, :3, 3] - slam.keyposes[k][:3, 3]).sum(axis=1).argmin()) for k in (closure.ref_scan_id, closure.query_scan_id)]
        pose = np.linalg.inv(slam.poses[ends[0]]) @ slam.poses[ends[1]]
        emit(closure=ends, t_from_to=rows(pose))
