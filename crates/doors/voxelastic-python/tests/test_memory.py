"""What is closed is given back to the system."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import sys
import numpy as np
import voxelastic as vx

def resident():
    lines = dict(line.split(":", 1) for line in open("/proc/self/status"))
    return 1024 * int(lines["RssAnon"].split()[0])

mapper = vx.Mapper(voxel_size=0.06, field="both")
for scan in vx.Simulation("campus", scans=8, columns=512, spacing=8):
    mapper.handle(scan)
closed = mapper
if sys.argv[1] == "map":
    closed = mapper.finish()
    closed.mesh()
    closed.query(np.random.default_rng(1).uniform(-30, 30, (300_000, 3)))
held = resident()
closed.close()
print(held, resident())
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the system does not say how much memory a process has")
@pytest.mark.parametrize("what", ["map", "mapper"])
def test_closing_gives_memory_back(what: str) -> None:
    """Not to the C library, which keeps what threads have freed: half of a map and more."""
    done = subprocess.run([sys.executable, "-c", SCRIPT, what], capture_output=True, text=True, timeout=120, check=True)
    held, left = (int(number) / 1e6 for number in done.stdout.split())
    # The interpreter, numpy and the threads have some 25 MB.
    assert held > 80 and left < 50, f"{left:.0f} MB stay of {held:.0f} MB"


def test_a_copy_keeps_the_memory(tmp_path: Path) -> None:
    import copy

    import voxelastic as vx

    mapper = vx.Mapper(voxel_size=0.1)
    mapper.handle(vx.Simulation("room", scans=1, columns=256)[0])
    map = mapper.finish()
    other = copy.copy(map)
    map.close()
    map.close()
    assert len(other.mesh()) > 100
