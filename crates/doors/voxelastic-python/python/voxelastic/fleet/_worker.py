"""What a task may use of the machine, and what it has used."""

from __future__ import annotations

import os
import resource
import sys
import time
from pathlib import Path
from typing import Any

STATUS, CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def threads() -> int:
    """Threads for the library in a task: as many as its Dask worker has, so that the workers of a machine share its cores as they were started; 0, which is a
    thread per core, in a process that is no worker, and where `RAYON_NUM_THREADS` says how many."""
    if "distributed" not in sys.modules or "RAYON_NUM_THREADS" in os.environ:
        return 0
    # It has no types.
    distributed: Any = sys.modules["distributed"]
    try:
        return int(distributed.get_worker().state.nthreads)
    except ValueError:
        return 0


class Usage:
    """Time and memory from now on."""

    def __init__(self) -> None:
        self.began, self.cpu = time.time(), time.process_time()
        try:
            # The peak becomes what is in memory now (Linux, proc_pid_clear_refs(5)).
            CLEAR.write_text("5")
        except OSError:
            pass

    def record(self) -> dict[str, Any]:
        """What it took so far: `seconds` and `cpu_seconds`; `peak_mb`, the largest memory of the process meanwhile; which process it is, and when it began."""
        return {
            "seconds": round(time.time() - self.began, 3),
            "cpu_seconds": round(time.process_time() - self.cpu, 3),
            "peak_mb": round(peak_bytes() / 1e6, 1),
            "worker": os.getpid(),
            "began": round(self.began, 3),
        }


def peak_bytes() -> int:
    """Largest resident memory of this process; on Linux since it was reset."""
    try:
        line = next(line for line in STATUS.read_text().splitlines() if line.startswith("VmHWM:"))
        return 1024 * int(line.split()[1])
    except (OSError, StopIteration):
        # Of the whole life of the process, and of the one that started it.
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return most if sys.platform == "darwin" else 1024 * most
