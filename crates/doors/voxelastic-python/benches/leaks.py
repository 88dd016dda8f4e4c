#!/usr/bin/env python3
"""Whether calls leak memory: a million of each of some kinds, good and refused, and the memory of the process after each tenth of them.

    python crates/doors/voxelastic-python/benches/leaks.py --calls 1000000

It fails if memory grows by more than 20 MB after the first tenth. The map is of a simulated room. Objects that are made, such as maps and mappers, are made once
in a thousand calls.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import gc
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

import voxelastic as vx

LIMIT_MB = 20


def resident_megabytes() -> float:
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def refused(call: Callable[[], object]) -> None:
    with contextlib.suppress(ValueError, FileNotFoundError):
        call()
        sys.exit("a call that must be refused was not")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--calls", type=int, default=1_000_000, help="calls of each kind")
    count = parser.parse_args().calls
    drive = vx.Simulation("room", scans=3, spacing=0.5, columns=128)
    mapper = vx.Mapper(voxel_size=0.1, field="both")
    for scan in drive:
        mapper.handle(scan)
    map, scan = mapper.finish(), drive[0]
    single, wrong, pose = np.zeros((1, 3), np.float32), np.zeros((1, 2)), np.eye(4)
    folder = Path(tempfile.mkdtemp())
    map.save(folder / "room.vox")
    data = drive.write(folder / "drive")

    def rarely() -> None:
        with vx.Map.open(folder / "room.vox") as again:
            again.mesh(lod=2)
        copy.copy(map).close()
        with vx.Mapper(voxel_size=0.2) as small:
            small.replay(data, progress=False)
            small.snapshot().query(single)
        refused(lambda: vx.Map.open(folder / "nothing.vox"))

    def questions() -> None:
        map.query(single)
        map.distance(single)
        map.state(single)
        map.ray_cast([0, 0, 0], [[1, 0, 0]])
        map.clearance(single, up_to=0.5)
        refused(lambda: map.query(wrong))

    def arrays() -> None:
        scan.shape, scan.intensity, map.submaps, map.settings  # noqa: B018
        refused(lambda: mapper.update_poses({-1: pose}))

    worst = 0.0
    for name, kind in (("questions", questions), ("arrays", arrays)):
        levels = []
        for k in range(count):
            kind()
            if k % 1000 == 0:
                rarely()
            if (k + 1) % max(1, count // 10) == 0:
                levels.append(resident_megabytes())
        worst = max(worst, max(levels[1:]) - levels[0])
        print(f"{name}, {count:,} times: {', '.join(f'{level:.1f}' for level in levels)} MB", flush=True)
    if worst > LIMIT_MB:
        sys.exit(f"memory grew by {worst:.1f} MB")
    print(f"memory grew by at most {worst:.1f} MB")


if __name__ == "__main__":
    main()
