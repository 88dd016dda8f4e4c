#!/usr/bin/env python3
"""Maps recorded data by `voxelastic.fleet`: recordings that are cut into sessions with no scan in common, each with a frame of its own, with and without their poses.

    python crates/doors/voxelastic-python/fleet_recorded.py ../shared/data FOLDER

Prints JSON: for each recording and way of cutting, what became of the sessions, closures, and the distances of all poses from the recorded ones after one rigid alignment of all.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import voxelastic as vx
from voxelastic import fleet

# Recording, file of its poses, folder of its scans, how it is cut (number of scans to lists of their numbers), what it is called.
CUTS: list[tuple[str, str, str, Callable[[int], list[Any]], str]] = [
    ("hall", "poses.tum", "scans", lambda n: [range(n // 2), range(n // 2, n)], "first and second half"),
    ("hall", "poses.tum", "scans", lambda n: [range(0, n, 2), range(1, n, 2)], "every second scan"),
    ("kitti00-street", "poses_groundtruth.txt", "velodyne", lambda n: [range(0, n, 2), range(1, n, 2)], "every second keyframe"),
    ("kitti00-seq", "poses_groundtruth.txt", "velodyne", lambda n: [range(k, n, 3) for k in range(3)], "every third sweep"),
    ("kitti00-seq", "poses_groundtruth.txt", "velodyne", lambda n: [[*range(40), *range(40, 80, 2)], [*range(41, 80, 2), *range(80, n)]], "two drives, 30 m in common"),
]


def read_poses(path: Path) -> Any:
    """N x 4 x 4 poses."""
    rows = np.loadtxt(path)
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    if path.suffix == ".tum":
        x, y, z, w = rows[:, 4:8].T / np.linalg.norm(rows[:, 4:8], axis=1)
        poses[:, 0, :3] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], axis=1)
        poses[:, 1, :3] = np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], axis=1)
        poses[:, 2, :3] = np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], axis=1)
        poses[:, :3, 3] = rows[:, 1:4]
    else:
        poses[:, :3] = rows.reshape(-1, 3, 4)
    return poses


def write_session(folder: Path, scans: list[Path], poses: Any) -> Path:
    """A folder of scans, with poses in the frame of the first one, or without."""
    shutil.rmtree(folder, ignore_errors=True)
    (folder / scans[0].parent.name).mkdir(parents=True)
    for number, scan in enumerate(scans):
        (folder / scan.parent.name / f"{number:06d}{scan.suffix}").symlink_to(scan.resolve())
    if poses is not None:
        np.savetxt(folder / "poses.txt", (np.linalg.inv(poses[0]) @ poses)[:, :3].reshape(len(poses), 12))
    return folder


def errors(found: Any, true: Any) -> dict[str, float]:
    """Distances after one rigid alignment, metres."""
    a, b = found - found.mean(axis=0), true - true.mean(axis=0)
    u, _, vt = np.linalg.svd(a.T @ b)
    off = np.linalg.norm(a @ (u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt) - b, axis=1)
    return {"mean_m": round(float(off.mean()), 3), "largest_m": round(float(off.max()), 3)}


def main() -> None:
    """Runs the measurement."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--voxel-size", type=float, default=0.15)
    given = parser.parse_args()
    settings = vx.Settings(voxel_size=given.voxel_size, max_range=50)
    results = []
    for recording, poses_file, scans_folder, cut, name in CUTS:
        scans = sorted((given.data / recording / scans_folder).iterdir())
        truth = read_poses(given.data / recording / poses_file)
        for has_poses in (True, False):
            folder = given.folder / f"{recording}-{name.replace(' ', '-')}-{'with' if has_poses else 'without'}-poses"
            parts = [list(part) for part in cut(len(scans))]
            sessions = [
                write_session(folder / f"session-{k}", [scans[i] for i in part], truth[part] if has_poses else None) for k, part in enumerate(parts)
            ]
            shutil.rmtree(folder / "store", ignore_errors=True)
            begun = time.perf_counter()
            report = fleet.map(sessions, folder / "store", settings=settings, title=recording)
            seconds = time.perf_counter() - begun
            nodes = {int(node): np.array(pose[:3]) for node, pose in json.loads((folder / "store" / report.node_poses).read_text()).items()}
            # Which scan a node is. Scans without poses, of which some may not be usable, are a tenth of a second apart.
            times = {node: time for track in (folder / "store" / "tracks").iterdir() for node, time, _ in json.loads(track.read_text())["nodes"]}
            scan_of = {node: node & 0xFFFFFFFF if has_poses else round(10 * times[node]) for node in nodes}
            known = sorted(nodes)
            true = np.array([truth[parts[node >> 32][scan_of[node]], :3, 3] for node in known])
            results.append(
                {
                    "recording": recording,
                    "sessions": name,
                    "poses": has_poses,
                    "states": [session.state for session in report.sessions],
                    "scans": [f"{session.scans} of {len(part)}" for session, part in zip(report.sessions, parts)],
                    "closures": report.closures,
                    "tried": report.tried,
                    "outvoted": report.outvoted,
                    **errors(np.array([nodes[node] for node in known]), true),
                    "submaps": report.submaps,
                    "seconds": round(seconds, 1),
                    "problems": [session.problem for session in report.sessions if session.problem],
                }
            )
            print(json.dumps(results[-1]), flush=True)


if __name__ == "__main__":
    main()
