"""VDBFusion as a peer of `voxelastic bench`: a request in, a JSON object a line out (the protocol is in src/peers/mod.rs).

    python3 vdbfusion_adapter.py request.json

Needs numpy and the package vdbfusion. Surfaces only: the band is three voxels to each side, its authors' choice, and no space is carved. It is
kept to as many processors as the request has threads, where the system can do that.
"""
import json
import os
import sys
import time
from pathlib import Path

ABSENT = 77  # exit code: the peer is not installed
OTHER_FIELD = 78  # exit code: the peer does not map this field


def say(**what):
    print(json.dumps(what), flush=True)


def matrix(x, y, z, qx, qy, qz, qw):
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qz * qw), 2 * (qx * qz + qy * qw)],
        [2 * (qx * qy + qz * qw), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qx * qw)],
        [2 * (qx * qz - qy * qw), 2 * (qy * qz + qx * qw), 1 - 2 * (qx * qx + qy * qy)],
    ]
    pose[:3, 3] = x, y, z
    return pose


def in_map(scan, request):
    """Points of a scan within the ranges, in the map frame, and the sensor's pose."""
    points = np.fromfile(scan["points"], np.float32).reshape(-1, 4)[:, :3].astype(float)
    ranges = np.linalg.norm(points, axis=1)
    points = points[(ranges > request["min_range_m"]) & (ranges <= request["max_range_m"])]
    pose = matrix(*scan["t_map_lidar"])
    return np.ascontiguousarray(points @ pose[:3, :3].T + pose[:3, 3]), pose


def peak_mb():
    """Most memory of this process, megabytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024 / 1e6
    return None


def main(request):
    say(system=f"VDBFusion {version('vdbfusion')}")
    volume = vdbfusion.VDBVolume(request["voxel_m"], 3 * request["voxel_m"], False)
    start = time.monotonic()
    for number, scan in enumerate(request["scans"]):
        if time.monotonic() - start > request["time_limit_s"]:
            return
        points, pose = in_map(scan, request)
        wall, cpu = time.monotonic(), time.process_time()
        volume.integrate(points, pose)
        cpu, wall = time.process_time() - cpu, time.monotonic() - wall
        say(scan=number, cpu_ms=cpu * 1e3, wall_ms=wall * 1e3, peak_rss_mb=peak_mb())
    vertices, _ = volume.extract_triangle_mesh(False, 1.0)
    rows = np.zeros((len(vertices), 4), np.float32)
    rows[:, :3] = vertices
    rows.tofile(request["surface"])
    say(surface=True)


if __name__ == "__main__":
    told = json.loads(Path(sys.argv[1]).read_text())
    if told["format"] != 1:
        sys.exit("this adapter reads requests of format 1")
    if told["field"] != "tsdf":
        sys.exit(OTHER_FIELD)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: told["threads"]])
    try:
        from importlib.metadata import version

        import numpy as np
        import vdbfusion
    except ImportError as missing:
        print(f"VDBFusion is left out: {missing} (pip install vdbfusion; VOXELASTIC_PYTHON names the Python)", file=sys.stderr)
        sys.exit(ABSENT)
    main(told)
