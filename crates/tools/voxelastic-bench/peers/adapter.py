"""Common parts of the adapters: they read a request and print one JSON object per line (the protocol is in src/peers/mod.rs)."""
import json
import os
import sys
import time
from pathlib import Path

ABSENT = 77  # exit code: the peer is not installed
OTHER_FIELD = 78  # exit code: the peer does not map this field


def absent(why):
    print(why, file=sys.stderr)
    sys.exit(ABSENT)


def request_for(field):
    """The request, if it is for a map of `field`; else exits."""
    if REQUEST["format"] != 1:
        sys.exit("this adapter reads requests of format 1")
    if REQUEST["field"] != field:
        sys.exit(OTHER_FIELD)
    return REQUEST


REQUEST = json.loads(Path(sys.argv[1]).read_text())
# Limit the processors to the number of threads, before numpy starts threads of its own, whose waiting would count.
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: REQUEST["threads"]])
try:
    import numpy as np
except ImportError:
    absent("This Python has no numpy (VOXELASTIC_PYTHON names another one)")


def emit(**what):
    print(json.dumps(what), flush=True)


def rotation(qx, qy, qz, qw):
    return np.array(
        [
            [1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qz * qw), 2 * (qx * qz + qy * qw)],
            [2 * (qx * qy + qz * qw), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qx * qw)],
            [2 * (qx * qz - qy * qw), 2 * (qy * qz + qx * qw), 1 - 2 * (qx * qx + qy * qy)],
        ]
    )


def in_map(scan, min_range, max_range=np.inf):
    """Points of a scan within the ranges, in the map frame, and the sensor's place."""
    points = np.fromfile(scan["points"], np.float32).reshape(-1, 4)[:, :3].astype(float)
    ranges = np.linalg.norm(points, axis=1)
    points = points[(ranges > min_range) & (ranges <= max_range)]
    x, y, z, *q = scan["t_map_lidar"]
    return np.ascontiguousarray(points @ rotation(*q).T + [x, y, z]), np.array([x, y, z], float)


def peak_mb():
    """Most memory of this process, megabytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024 / 1e6
    return None


def measure(request, points_of, integrate, surface, **sizes):
    """Integrates what `points_of` gives for each scan, within the time limit, and writes the points that `surface` gives. `sizes` are called
    after each scan and printed with it."""
    start = time.monotonic()
    for number, scan in enumerate(request["scans"]):
        if time.monotonic() - start > request["time_limit_s"]:
            return
        points, origin = points_of(scan)
        wall, cpu = time.monotonic(), time.process_time()
        integrate(points, origin)
        cpu, wall = time.process_time() - cpu, time.monotonic() - wall
        emit(scan=number, cpu_ms=cpu * 1e3, wall_ms=wall * 1e3, peak_rss_mb=peak_mb(), **{name: size() for name, size in sizes.items()})
    points = surface()
    rows = np.zeros((len(points), 4), np.float32)
    rows[:, :3] = points
    rows.tofile(request["surface"])
    emit(surface=True)
