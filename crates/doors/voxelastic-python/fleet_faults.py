#!/usr/bin/env python3
"""Maps simulated drives while workers are killed, the scheduler is restarted and the store fails, and compares the maps with that of one process, bit by bit.

    python crates/doors/voxelastic-python/fleet_faults.py FOLDER                 the drives of fleet_drives.py, four of them; some ten minutes
    python crates/doors/voxelastic-python/fleet_faults.py FOLDER --drives 10

Prints JSON: for each kind of fault whether the map is the same, how many faults there were, and how many tasks were done more than once.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import distributed

import voxelastic as vx
from voxelastic import fleet

STAGES = ("probe", "split", "close", "optimise", "integrate", "assemble", "tiles", "finish-tiles")
"""The kinds of tasks, by the names of their records."""

dask: Any = distributed
"""It has no types."""


class Faults(dask.WorkerPlugin):  # type: ignore[misc]
    """Faults of a worker. The worst moment for a task to be lost is when all of it is done but its record.

    Args:
        folder: Where it notes what happened.
        kill: Kinds of tasks; the first task of each is killed with its worker, before it writes its record.
        failing: Share of writes that fail.
    """

    name = "faults"

    def __init__(self, folder: Path, kill: Sequence[str] = (), failing: float = 0.0) -> None:
        self.folder, self.kill, self.failing = folder, tuple(kill), failing

    def setup(self, worker: Any) -> None:
        """Replaces what writes to the store, in the process of a worker."""
        from voxelastic.fleet import _store

        put, luck = _store._put, random.Random(os.getpid())

        def unreliable(fs: Any, path: str, content: bytes) -> None:
            if luck.random() < self.failing:
                self.note("failures", path)
                raise OSError(5, "the store does not answer")
            if "/records/" in path:
                record = Path(path).stem
                self.note("attempts", record)
                if (kind := record.rsplit("-", 1)[0]) in self.kill and self.is_first(kind):
                    os.kill(os.getpid(), signal.SIGKILL)
            put(fs, path, content)

        _store._put = unreliable

    def note(self, what: str, line: str) -> None:
        """Notes something."""
        with (self.folder / what).open("a") as file:
            file.write(f"{line}\n")

    def is_first(self, kind: str) -> bool:
        """Whether no task of a kind was killed yet."""
        try:
            (self.folder / f"killed-{kind}").touch(exist_ok=False)
        except FileExistsError:
            return False
        return True

    def noted(self, what: str) -> list[str]:
        """What was noted."""
        path = self.folder / what
        return path.read_text().split() if path.exists() else []

    def killed(self) -> list[str]:
        """Kinds of tasks of which one was killed."""
        return sorted(path.name.removeprefix("killed-") for path in self.folder.glob("killed-*"))

    def repeated(self) -> dict[str, int]:
        """Tasks that came to their end more than once, and how often."""
        return {record: count - 1 for record, count in Counter(self.noted("attempts")).items() if count > 1}


NOTES = "VOXELASTIC_FLEET_NOTES"
"""Variable of the environment with the folder where workers of a [`Cluster`] note what happened."""


def dask_setup(worker: Any) -> None:
    """What Dask calls in each worker that loads this file when it starts."""
    Faults(Path(os.environ[NOTES])).setup(worker)


class Cluster:
    """A scheduler and workers as `dask scheduler` and `dask worker` start them, each a process of its own.

    Args:
        workers: How many workers.
        notes: Folder where they note what happened, for [`Faults`].
    """

    def __init__(self, workers: int, notes: Path | None = None) -> None:
        self.workers, self.notes, self.running = workers, notes, list[subprocess.Popen[bytes]]()
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"

    def start(self) -> None:
        """Starts all of them."""
        self._start("scheduler", "--port", str(self.port))
        # A client that looks for the one before may hold its port for a moment; a supervisor starts a service that ends again.
        while not self._answers():
            if self.running[0].poll() is not None:
                self.running.clear()
                self._start("scheduler", "--port", str(self.port))
            time.sleep(0.1)
        for _ in range(self.workers):
            preload = () if self.notes is None else ("--preload", __file__)
            self._start("worker", self.address, "--nthreads", "1", "--local-directory", tempfile.gettempdir(), *preload)

    def _start(self, what: str, *arguments: str) -> None:
        command = [sys.executable, "-m", f"distributed.cli.dask_{what}", *arguments, "--host", "127.0.0.1", "--no-dashboard"]
        environment = os.environ if self.notes is None else os.environ | {NOTES: str(self.notes)}
        self.running.append(subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL))

    def _answers(self) -> bool:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), timeout=1) as connection:
            return bool(connection.getsockname()[1] != self.port)
        return False

    def restart(self) -> None:
        """Kills the scheduler (-9), of which the workers end, too; and starts all of them again, as a supervisor of services does."""
        self.running[0].kill()
        for process in self.running:
            process.wait()
        self.running.clear()
        self.start()

    def stop(self) -> None:
        """Kills all of them."""
        for process in self.running:
            process.kill()
            process.wait()
        self.running.clear()

    def __enter__(self) -> Cluster:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


@contextlib.contextmanager
def local_client(workers: int) -> Iterator[Any]:
    """A client of workers on this machine."""
    with dask.LocalCluster(n_workers=workers, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, silence_logs=50) as cluster:
        with cluster.get_client() as client:
            yield client


def kill_at_random(client: Any, seconds: float) -> Callable[[], int]:
    """Kills a worker every so many seconds, until what it returns is called, which returns how many."""
    ended, killed, luck = threading.Event(), list[int](), random.Random(1)

    def work() -> None:
        while not ended.wait(seconds):
            workers = list(client.cluster.workers.values())
            process = luck.choice(workers).process if workers else None
            if process is not None and process.pid is not None:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(process.pid, signal.SIGKILL)
                    killed.append(process.pid)

    thread = threading.Thread(target=work)
    thread.start()

    def stop() -> int:
        ended.set()
        thread.join()
        return len(killed)

    return stop


def main() -> None:
    """Runs the measurement."""
    from fleet_drives import content, write_drives

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--drives", type=int, default=4)
    parser.add_argument("--voxel-size", type=float, default=0.15)
    parser.add_argument("--kill-every", type=float, default=8.0, metavar="S", help="time between workers that are killed at random, seconds [default: 8]")
    given = parser.parse_args()
    os.environ["RAYON_NUM_THREADS"] = "1"
    drives = write_drives(given.folder, given.drives)
    settings = vx.Settings(voxel_size=given.voxel_size, max_range=50)
    results: dict[str, Any] = {}

    def run(name: str, client: Any, faults: Faults | None = None, progress: Any = None) -> None:
        store = given.folder / f"faults-{name.replace(' ', '-')}"
        shutil.rmtree(store, ignore_errors=True)
        begun = time.perf_counter()
        report = fleet.map(drives, store, client, settings=settings, title="campus", progress=progress)
        tasks = sum(stage.tasks for stage in report.stages)
        results[name] = {"hash": content(store), "tasks": tasks, "seconds": round(time.perf_counter() - begun, 1)}
        results[name]["problems"] = [session.problem for session in report.sessions if session.problem] + report.regions_failed
        results[name]["same_bits"] = results[name]["hash"] == results["none, one process"]["hash"]
        if faults is not None:
            results[name]["repeated"] = faults.repeated()
        print(name, json.dumps(results[name]), file=sys.stderr)

    run("none, one process", None)
    with tempfile.TemporaryDirectory() as folder, local_client(2) as client:
        faults = Faults(Path(folder), kill=STAGES)
        client.register_plugin(faults)
        run("a worker killed in each stage", client, faults)
        results["a worker killed in each stage"]["killed"] = faults.killed()
    with tempfile.TemporaryDirectory() as folder, local_client(2) as client:
        faults = Faults(Path(folder))
        client.register_plugin(faults)
        stop = kill_at_random(client, given.kill_every)
        try:
            run("workers killed at random", client, faults)
        finally:
            count = stop()
        results["workers killed at random"]["killed"] = count
    with tempfile.TemporaryDirectory() as folder, local_client(2) as client:
        faults = Faults(Path(folder), failing=0.01)
        client.register_plugin(faults)
        run("1 % of writes fail", client, faults)
        results["1 % of writes fail"]["failures"] = len(faults.noted("failures"))
    with tempfile.TemporaryDirectory() as folder, Cluster(2) as cluster, dask.Client(cluster.address, timeout=60) as client:
        faults, restarted = Faults(Path(folder)), list[str]()
        client.register_plugin(faults)

        def restart(stage: str, done: int, all_: int) -> None:
            # In the middle of each stage of several tasks, and between each two others.
            if stage not in restarted and done >= all_ // 2:
                restarted.append(stage)
                cluster.restart()
                client.wait_for_workers(2)
                client.register_plugin(faults)

        run("scheduler restarted in each stage", client, faults, restart)
        results["scheduler restarted in each stage"]["restarted"] = restarted
    print(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
