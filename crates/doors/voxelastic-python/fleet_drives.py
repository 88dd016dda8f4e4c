#!/usr/bin/env python3
"""Measures `voxelastic.fleet` on ten simulated drives of the campus: on different days, with drift, each with a frame of its own, two with a closed way.

    python crates/doors/voxelastic-python/fleet_drives.py FOLDER                        makes the drives, maps them in one process and by 1, 2 and 4 workers
    python crates/doors/voxelastic-python/fleet_drives.py FOLDER --workers 2 --drives 4
    python crates/doors/voxelastic-python/fleet_drives.py FOLDER --threads 1 --workers 1 2 4        how it scales: a worker has one thread

Prints JSON: wall time by workers, whether all maps are the same bit for bit, errors of all poses against the world, closures and how many of them all others contradict; and for
each stage its tasks, seconds, busy seconds of all workers, the largest memory of a worker while it did a task, and the most bytes of a task that pass through the scheduler.
FOLDER keeps the drives and the maps.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import time
from pathlib import Path
from typing import Any

import numpy as np

import voxelastic as vx
from voxelastic import fleet

SCANS = 110
SHARED = 40
"""Scans of a way that two drives after each other share."""


def write_drives(folder: Path, count: int) -> dict[str, int]:
    """Writes drives that are not there yet. Returns the first scan of each in the simulation."""
    step = SCANS - SHARED
    simulation = vx.Simulation("campus", scans=step * count + SHARED, sensor="os1-64", columns=512, spacing=1.0, max_range=80)
    truth, firsts = simulation.true_poses, {}
    for number in range(count):
        # Every fifth one turns round where the way is closed.
        first, path = number * step, folder / f"day-{number:02d}"
        length = SCANS - 30 if number % 5 == 4 else SCANS
        firsts[str(path)] = first
        if path.exists():
            continue
        random = np.random.default_rng(number)
        angle = random.uniform(-np.pi, np.pi)
        start = np.eye(4)
        start[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        start[:3, 3] = random.uniform(-500, 500, 3) * [1, 1, 0.01]
        drift = np.cumsum(random.normal(0, 0.01, (length, 3)) * [1, 1, 0.3], axis=0)
        (path / "scans").mkdir(parents=True)
        rows = []
        for k in range(length):
            pose = start @ truth[first + k]
            pose[:3, 3] += drift[k]
            rows.append(pose[:3].reshape(-1))
            points = simulation[first + k].points.reshape(-1, 3)
            points = points[np.isfinite(points).all(axis=1)]
            np.hstack([points, np.zeros((len(points), 1), np.float32)]).astype(np.float32).tofile(path / "scans" / f"{k:06d}.bin")
        np.savetxt(path / "poses.txt", np.array(rows))
    np.save(folder / "truth.npy", truth)
    return firsts


def content(store: Path) -> str:
    """A hash of all that a map and its tiles are made of."""
    files = sorted(path for name in ("map.vox", "tiles") for path in (store / name).rglob("*") if path.is_file())
    return hashlib.sha256(b"".join(str(p.relative_to(store)).encode() + hashlib.sha256(p.read_bytes()).digest() for p in files)).hexdigest()[:16]


def errors(store: Path, report: fleet.FleetReport, firsts: dict[str, int], truth: Any) -> dict[str, float]:
    """Distances of all poses from the true ones after one rigid alignment, metres."""
    nodes = {int(node): np.array(pose[:3]) for node, pose in json.loads((store / report.node_poses).read_text()).items()}
    first = {session.number: firsts[session.name] for session in report.sessions}
    found = np.array([nodes[node] for node in sorted(nodes)])
    true = np.array([truth[first[node >> 32] + (node & 0xFFFFFFFF), :3, 3] for node in sorted(nodes)])
    a, b = found - found.mean(axis=0), true - true.mean(axis=0)
    u, _, vt = np.linalg.svd(a.T @ b)
    turn = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    off = np.linalg.norm(a @ turn - b, axis=1)
    return {"mean_m": round(float(off.mean()), 3), "rmse_m": round(float(np.sqrt((off**2).mean())), 3), "largest_m": round(float(off.max()), 3)}


def figures(stage: fleet.Stage) -> dict[str, float]:
    """What a stage took."""
    busy = round(sum(stage.seconds_by_worker.values()), 1)
    return {"tasks": stage.tasks, "seconds": stage.wall_seconds, "busy_seconds": busy, "peak_mb": stage.peak_mb, "most_bytes": stage.most_bytes}


def main() -> None:
    """Runs the measurement."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--drives", type=int, default=10)
    parser.add_argument("--workers", type=int, nargs="*", default=[0, 1, 2, 4], help="0: in this process")
    parser.add_argument("--threads", type=int, help="threads of each worker, and of this process [default: as many as there are cores for each process]")
    parser.add_argument("--voxel-size", type=float, default=0.15)
    given = parser.parse_args()
    # Workers have it, too. It must be there before the first use of the library.
    os.environ["RAYON_NUM_THREADS"] = str(given.threads or len(os.sched_getaffinity(0)))
    firsts = write_drives(given.folder, given.drives)
    truth = np.load(given.folder / "truth.npy")
    settings = vx.Settings(voxel_size=given.voxel_size, max_range=50)
    results: dict[str, Any] = {}
    for workers in given.workers:
        store = given.folder / f"store-{workers}"
        shutil.rmtree(store, ignore_errors=True)
        begun = time.perf_counter()
        if workers == 0:
            report = fleet.map(firsts, store, settings=settings, title="campus")
        else:
            import distributed

            module: Any = distributed
            with module.LocalCluster(n_workers=workers, threads_per_worker=1, host="127.0.0.1", dashboard_address=None) as cluster, cluster.get_client() as client:
                begun = time.perf_counter()
                report = fleet.map(firsts, store, client, settings=settings, title="campus")
        results[str(workers)] = {
            "seconds": round(time.perf_counter() - begun, 1),
            "hash": content(store),
            "joined": len(report.joined),
            "submaps": report.submaps,
            "closures": report.closures,
            "outvoted": report.outvoted,
            "tried": report.tried,
            "errors": errors(store, report, firsts, truth),
            "stages": {stage.name: figures(stage) for stage in report.stages},
        }
    print(json.dumps({"same_bits": len({result["hash"] for result in results.values()}) == 1, "workers": results}, indent=1))


if __name__ == "__main__":
    main()
