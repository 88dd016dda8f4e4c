"""MapClosures as a peer of `voxelastic-bench --slam`: closures between local maps, by poses that are given (what its own pipeline does with the
odometry of KISS-ICP, which loses itself on thin scans). A closure is what its pipeline takes for one: enough inliers.

    python3 map_closures_adapter.py request.json
"""
from slam import ABSENT, NOT_HERE, REQUEST, emit, leave, measure, np, rows

if REQUEST["scans"] and "t_map_lidar" not in REQUEST["scans"][0]:
    leave(NOT_HERE, "MapClosures needs odometry")
try:
    from importlib.metadata import version

    from map_closures.config import MapClosuresConfig
    from map_closures.map_closures import MapClosures
    from map_closures.voxel_map import VoxelMap
except ImportError:
    leave(ABSENT, "MapClosures is left out: pip install map-closures (VOXELASTIC_PYTHON names the Python)")

emit(system=f"MapClosures {version('map-closures')}")
# user code: begin
config = MapClosuresConfig()
closer = MapClosures(config)
poses = [np.vstack([np.reshape(scan["t_map_lidar"], (3, 4)), [0, 0, 0, 1]]) for scan in REQUEST["scans"]]
length, last = REQUEST["max_range_m"], len(poses) - 1
local_map = VoxelMap(config.density_map_resolution, length)
anchors, scan = [0], -1


def register(points, times):
    global local_map, scan
    scan += 1
    pose = np.linalg.inv(poses[anchors[-1]]) @ poses[scan]
    ranges = np.linalg.norm(points, axis=1)
    local_map.integrate_frame(points[(ranges > REQUEST["min_range_m"]) & (ranges < length)], pose)
    if np.linalg.norm(pose[:3, 3]) > length or scan == last:
        for closure in closer.get_closures(len(anchors) - 1, local_map.point_cloud()):
            if closure.number_of_inliers > config.inliers_threshold:
                earlier, later = anchors[closure.source_id], anchors[closure.target_id]
                # Its pose takes the earlier map to the later one.
                emit(closure=[earlier, later], t_from_to=rows(np.linalg.inv(np.asarray(closure.pose))))
        local_map.remove_far_away_points(pose[:3, 3])
        kept = local_map.point_cloud()
        local_map.clear()
        local_map.integrate_frame(kept, np.linalg.inv(poses[scan]) @ poses[anchors[-1]])
        anchors.append(scan)
    return None
# user code: end


measure(register)
