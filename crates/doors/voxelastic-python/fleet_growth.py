#!/usr/bin/env python3
"""What a fleet costs with its length: maps some of the drives of fleet_drives.py, more each time, fits a power of their length to the processor time of each stage, and says what
it would be for 1,000 km.

    python crates/doors/voxelastic-python/fleet_growth.py FOLDER                   2, 4, 7 and 10 drives, voxels of 10 cm, one thread
    python crates/doors/voxelastic-python/fleet_growth.py FOLDER --km 1000 --session-km 20

Places of each two sessions are compared. So `close` is fitted to the number of pairs, and said for sessions of --session-km: the time of a pair is taken to grow with the product of the
lengths of both, which is an upper bound, because at most eight places are tried for each. Prints JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from fleet_drives import write_drives

import voxelastic as vx
from voxelastic import fleet

LINEAR = ("split", "integrate", "tiles")
"""Stages whose tasks do not grow with the map."""


def measure(store: Path) -> dict[str, dict[str, float]]:
    """Processor time, tasks and the largest memory of each stage, from its records."""
    found: dict[str, dict[str, float]] = {}
    for path in (store / "records").glob("*.json"):
        record = json.loads(path.read_text())
        stage = found.setdefault(path.stem.rsplit("-", 1)[0], {"tasks": 0, "cpu_seconds": 0.0, "peak_mb": 0.0})
        stage["tasks"] += 1
        stage["cpu_seconds"] = round(stage["cpu_seconds"] + record["cpu_seconds"], 3)
        stage["peak_mb"] = max(stage["peak_mb"], record["peak_mb"])
    return found


def size(folder: Path) -> float:
    """MB of the files below a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 1e6


def power(x: list[float], y: list[float]) -> tuple[float, float]:
    """The exponent and the factor of a power of x that fits y."""
    exponent, logarithm = np.polyfit(np.log(x), np.log(np.maximum(y, 1e-3)), 1)
    return float(exponent), float(np.exp(logarithm))


def main() -> None:
    """Runs the measurement."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--drives", type=int, nargs="*", default=[2, 4, 7, 10])
    parser.add_argument("--voxel-size", type=float, default=0.1)
    parser.add_argument("--km", type=float, default=1000.0)
    parser.add_argument("--session-km", type=float, default=10.0)
    given = parser.parse_args()
    os.environ["RAYON_NUM_THREADS"] = "1"
    all_drives = write_drives(given.folder, max(given.drives))
    settings = vx.Settings(voxel_size=given.voxel_size, max_range=50, threads=1)
    runs: list[dict[str, Any]] = []
    for count in given.drives:
        store = given.folder / "growth"
        shutil.rmtree(store, ignore_errors=True)
        drives = list(all_drives)[:count]
        fleet.map(drives, store, settings=settings)
        paths = [np.loadtxt(Path(drive) / "poses.txt")[:, [3, 7, 11]] for drive in drives]
        length = sum(float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) for path in paths) / 1000
        run: dict[str, Any] = {"drives": count, "km": round(length, 3), "pairs": count * (count - 1) // 2}
        runs.append(run | {"stages": measure(store), "map_mb": round(size(store / "map.vox"), 1), "tiles_mb": round(size(store / "tiles"), 1), "store_mb": round(size(store), 1)})
        print(json.dumps(runs[-1]), flush=True)
    km: list[float] = [run["km"] for run in runs]
    said: dict[str, Any] = {}
    for stage in LINEAR:
        exponent, _ = power(km, [run["stages"][stage]["cpu_seconds"] for run in runs])
        per_km = runs[-1]["stages"][stage]["cpu_seconds"] / km[-1]
        said[stage] = {"exponent": round(exponent, 2), "cpu_s_per_km": round(per_km, 1), "cpu_h": round(per_km * given.km / 3600, 1)}
    per_pair = runs[-1]["stages"]["close"]["cpu_seconds"] / runs[-1]["pairs"]
    exponent, _ = power([run["pairs"] for run in runs], [run["stages"]["close"]["cpu_seconds"] for run in runs])
    sessions = max(2.0, given.km / given.session_km)
    longer = given.session_km / (km[-1] / runs[-1]["drives"])
    said["close"] = {"exponent_of_pairs": round(exponent, 2), "cpu_s_per_pair": round(per_pair, 2), "pairs": round(sessions * (sessions - 1) / 2)}
    said["close"] |= {f"cpu_h_{name}": round(per_pair * factor * said["close"]["pairs"] / 3600, 1) for name, factor in (("least", longer), ("most", longer**2))}
    exponent, factor = power(km, [run["stages"]["optimise"]["cpu_seconds"] for run in runs])
    said["optimise"] = {"exponent": round(exponent, 2), "cpu_h": round(factor * given.km**exponent / 3600, 2)}
    for name in ("map_mb", "tiles_mb", "store_mb"):
        exponent, _ = power(km, [run[name] for run in runs])
        said[name] = {"exponent": round(exponent, 2), "gb": round(runs[-1][name] / km[-1] * given.km / 1000, 1)}
    print(json.dumps({"km": given.km, "session_km": given.session_km, "of_fleets": said}, indent=1))


if __name__ == "__main__":
    main()
