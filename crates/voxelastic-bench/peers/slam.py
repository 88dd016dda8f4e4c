"""Common parts of the adapters for `voxelastic bench --slam`: they read a request and print one JSON object per line (the protocol is in
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
    return np.ascontiguousarray(np.fromfile(scan["points"], np.float32).reshape(-1, 4)[:, :3].astype(np.float64))


def measure(register):
    """Calls `register(points)` for each scan within the time limit, and prints its time and the pose that it returns (or None)."""
    start = time.monotonic()
    for number, scan in enumerate(REQUEST["scans"]):
        if time.monotonic() - start > REQUEST["time_limit_s"]:
            return False
        points = points_of(scan)
        cpu = time.process_time()
        pose = register(points)
        emit(scan=number, cpu_ms=(time.process_time() - cpu) * 1e3, pose=None if pose is None else rows(pose))
    return True


def rows(pose):
    return [float(v) for v in np.asarray(pose)[:3].ravel()]
