"""OctoMap as a peer of `voxelastic bench`: a request in, a JSON object a line out (the protocol is in src/peers/mod.rs).

    python3 octomap_adapter.py request.json

Needs numpy and one of the packages pyoctomap and octomap-python. OctoMap runs with its own defaults (hit 0.7, miss 0.4, clamping 0.12 to
0.97), end points discretised first, which is its fastest way, and inner nodes updated after each scan, so that the map can be asked.
"""
import json
import sys
import time
from pathlib import Path

ABSENT = 77  # exit code: the peer is not installed
OTHER_FIELD = 78  # exit code: the peer does not map this field

try:
    import numpy as np
except ImportError:
    print("OctoMap is left out: this Python has no numpy", file=sys.stderr)
    sys.exit(ABSENT)
try:
    import pyoctomap as octomap
except ImportError:
    try:
        import octomap
    except ImportError:
        print("OctoMap is left out: this Python has neither pyoctomap nor octomap (pip install pyoctomap; VOXELASTIC_PYTHON names the Python)", file=sys.stderr)
        sys.exit(ABSENT)


def say(**what):
    print(json.dumps(what), flush=True)


def rotation(qx, qy, qz, qw):
    return np.array(
        [
            [1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qz * qw), 2 * (qx * qz + qy * qw)],
            [2 * (qx * qy + qz * qw), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qx * qw)],
            [2 * (qx * qz - qy * qw), 2 * (qy * qz + qx * qw), 1 - 2 * (qx * qx + qy * qy)],
        ]
    )


def in_map(scan, min_range):
    """Points of a scan in the map frame, and the sensor's place."""
    points = np.fromfile(scan["points"], np.float32).reshape(-1, 4)[:, :3].astype(float)
    points = points[np.linalg.norm(points, axis=1) > min_range]
    x, y, z, *q = scan["t_map_lidar"]
    return np.ascontiguousarray(points @ rotation(*q).T + [x, y, z]), np.array([x, y, z], float)


def peak_mb():
    """Most memory of this process, megabytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024 / 1e6
    return None


def occupied(tree, voxel):
    """Centres of the occupied voxels; larger leaves are cut into voxels."""
    centres = []
    for leaf in tree.begin_leafs():
        if not tree.isNodeOccupied(leaf):
            continue
        edge = max(1, round(leaf.getSize() / voxel))
        steps = (np.arange(edge) - (edge - 1) / 2) * voxel
        grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3)
        centres.append(grid + np.array(leaf.getCoordinate()))
    return np.concatenate(centres) if centres else np.zeros((0, 3))


def main(path):
    request = json.loads(Path(path).read_text())
    if request["format"] != 1:
        sys.exit("this adapter reads requests of format 1")
    if request["field"] != "occupancy":
        sys.exit(OTHER_FIELD)
    version = getattr(octomap, "__version__", "")
    say(system=f"OctoMap ({octomap.__name__} {version})".replace(" )", ")"))
    tree = octomap.OcTree(request["voxel_m"])
    start = time.monotonic()
    for number, scan in enumerate(request["scans"]):
        if time.monotonic() - start > request["time_limit_s"]:
            return
        points, origin = in_map(scan, request["min_range_m"])
        wall, cpu = time.monotonic(), time.process_time()
        tree.insertPointCloud(points, origin, request["max_range_m"], True, True)
        tree.updateInnerOccupancy()
        cpu, wall = time.process_time() - cpu, time.monotonic() - wall
        say(scan=number, cpu_ms=cpu * 1e3, wall_ms=wall * 1e3, map_mb=tree.memoryUsage() / 1e6, peak_rss_mb=peak_mb())
    write(request["surface"], occupied(tree, request["voxel_m"]))
    say(surface=True)


def write(path, centres):
    rows = np.zeros((len(centres), 4), np.float32)
    rows[:, :3] = centres
    rows.tofile(path)


if __name__ == "__main__":
    main(sys.argv[1])
