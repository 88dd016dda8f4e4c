"""KISS-SLAM as a peer of `voxelastic-bench --slam`: odometry, closures between local maps of 100 m, and its pose graph, with its defaults.

    python3 kiss_slam_adapter.py request.json
"""
from slam import ABSENT, REQUEST, emit, leave, measure, np, rows

try:
    from importlib.metadata import version

    from kiss_slam.config.config import load_config
    from kiss_slam.slam import KissSLAM
except ImportError:
    leave(ABSENT, "KISS-SLAM is left out: pip install kiss-slam (VOXELASTIC_PYTHON names the Python)")

emit(system=f"KISS-SLAM {version('kiss-slam')}")
# user code: begin
config = load_config(None)
config.odometry.preprocessing.deskew = False  # the scans are given without times
config.odometry.preprocessing.max_range, config.odometry.preprocessing.min_range = REQUEST["max_range_m"], REQUEST["min_range_m"]
config.odometry.registration.max_num_threads = REQUEST["threads"]
config.odometry.mapping.voxel_size = REQUEST["max_range_m"] / 100
slam = KissSLAM(config)
# user code: end
# First scan of each local map; the closure's pose takes the later map to the earlier one.
first, constraints, scans = [0], [], 0
add_factor = slam.optimizer.add_factor


def remember(from_id, to_id, pose, information):
    constraints.append((from_id, to_id, np.array(pose)))
    add_factor(from_id, to_id, pose, information)


slam.optimizer.add_factor = remember


def register(points, times):
    global scans
    # user code: begin
    slam.process_scan(points, np.zeros(0))
    # user code: end
    scans += 1
    if slam.local_map_graph.last_id >= len(first):
        # A new map begins with the pose of the last scan of the one before.
        first.append(scans - 1)
    return None


if measure(register):
    emit(poses=[rows(pose) for pose in slam.poses[:scans]])
    for earlier, later in slam.closures:
        pose = [pose for a, b, pose in constraints if (a, b) == (earlier, later)][-1]
        # Of the later map in the frame of the earlier one; its factors are given the other way round.
        emit(closure=[first[earlier], first[later]], t_from_to=rows(np.linalg.inv(pose)))
