"""Common parts of the adapters for `voxelastic-bench --slam`: they read a request and print one JSON object per line (the protocol is in
src/slam/peer.rs)."""
import json
import os
import sys
import time
from pathlib import Path

ABSENT = 77  # exit code: the peer is not installed
NOT_HERE = 78  # exit code: the peer cannot do this with these scans

REQUEST = json.loads(Path(sys.argv[1]).read_text())
# Before numpy starts threads of its own.
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: REQUEST["threads"]])
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "TBB_NUM_THREADS"):
    os.environ[name] = str(REQUEST["threads"])


def leave(code, why):
    print(why, file=sys.stderr)
    sys.exit(code)


if REQUEST["format"] != 1:
    sys.exit("this adapter reads requests of format 1")
try:
    import numpy as np
except ImportError:
    leave(ABSENT, "This Python has no numpy (VOXELASTIC_PYTHON names another one)")

# What the peers print themselves goes to stderr.
OUT = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)


def emit(**what):
    print(json.dumps(what), file=OUT, flush=True)


def points_of(scan):
    """Points, and the time of each after the scan's, seconds (none where the scans have no times)."""
    rows = np.fromfile(scan["points"], np.float32).reshape(-1, 4)
    return np.ascontiguousarray(rows[:, :3].astype(np.float64)), rows[:, 3].astype(np.float64) if "time_s" in scan else np.zeros(0)


def peak_mb():
    """Most memory of this process, megabytes."""
    status = Path("/proc/self/status")
    found = [line.split()[1] for line in status.read_text().splitlines() if line.startswith("VmHWM:")] if status.exists() else []
    return int(found[0]) * 1024 / 1e6 if found else None


def measure(register, prepared=None):
    """Calls `register(points, times)` for each scan within the time limit, and prints its time and the pose that it returns (or None). What `prepared` makes
    of points and times before is passed on instead of them, and does not count."""
    start = time.monotonic()
    for number, scan in enumerate(REQUEST["scans"]):
        if time.monotonic() - start > REQUEST["time_limit_s"]:
            return False
        given = points_of(scan)
        if prepared:
            given = prepared(*given)
        cpu = time.process_time()
        pose = register(*given)
        emit(scan=number, cpu_ms=(time.process_time() - cpu) * 1e3, pose=None if pose is None else rows(pose), peak_rss_mb=peak_mb())
    return True


def rows(pose):
    return [float(v) for v in np.asarray(pose)[:3].ravel()]


def at_stamps(ends, poses):
    """Prints the poses at the times of the scans, for systems whose poses are those of the ends of sweeps (`ends`, seconds): between neighbours
    positions are interpolated linearly, rotations along the shortest arc; before the first end, its pose."""
    stamps = [scan["time_s"] for scan in REQUEST["scans"]][: len(poses)]
    found = []
    for stamp in stamps:
        k = int(np.clip(np.searchsorted(ends, stamp), 1, len(ends) - 1))
        share = float(np.clip((stamp - ends[k - 1]) / (ends[k] - ends[k - 1]), 0, 1))
        a, b = np.asarray(poses[k - 1]), np.asarray(poses[k])
        pose = np.eye(4)
        pose[:3, :3] = a[:3, :3] @ turn(log(a[:3, :3].T @ b[:3, :3]) * share)
        pose[:3, 3] = (1 - share) * a[:3, 3] + share * b[:3, 3]
        found.append(rows(pose))
    emit(poses=found)


def log(rotation):
    angle = np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))
    axis = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    return axis * (0.5 if angle < 1e-9 else angle / (2 * np.sin(angle)))


def turn(vector):
    angle = np.linalg.norm(vector)
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
