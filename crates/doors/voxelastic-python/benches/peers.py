#!/usr/bin/env python3
"""The same scans through Voxelastic, VDBFusion, OctoMap and Open3D, each as a user of its package would write it: time, memory, error, lines.

    python -m venv peers && peers/bin/pip install voxelastic-*.whl vdbfusion pyoctomap open3d
    peers/bin/python crates/doors/voxelastic-python/benches/peers.py DATA/hall

Each runs in a process of its own. Every tenth scan is not mapped; the error is the distance of its points, 1 to 30 m from the sensor, to the mesh. Times are
processor time of the calls, all threads together; reading the scans is not counted. A package that is not installed is left out. "Lines" are those between the scans
and the result.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import voxelastic as vx

Scans = Iterator[tuple[NDArray[np.float32], NDArray[np.float64]]]
Result = tuple[Any, Any]

VOXEL, RANGE = 0.065, 60.0


def voxelastic_surfaces(scans: Scans) -> Result:
    mapper = vx.Mapper(voxel_size=VOXEL, max_range=RANGE)
    for points, pose in scans:
        mapper.integrate(points, pose)
    mesh = mapper.finish().mesh()
    return mesh.vertices, mesh.triangles


def voxelastic_free_space(scans: Scans) -> Result:
    mapper = vx.Mapper(voxel_size=VOXEL, max_range=RANGE, field="occupancy")
    for points, pose in scans:
        mapper.integrate(points, pose)
    return mapper.finish(), None


def vdbfusion_surfaces(scans: Scans) -> Result:
    vdbfusion: Any = importlib.import_module("vdbfusion")
    volume = vdbfusion.VDBVolume(VOXEL, 3 * VOXEL, False)
    for points, pose in scans:
        ranges = np.linalg.norm(points, axis=1)
        points = points[(ranges > 0.5) & (ranges < RANGE)]
        volume.integrate(points.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3], pose)
    vertices, triangles = volume.extract_triangle_mesh(True, 1.0)
    return vertices, triangles


def open3d_poisson(scans: Scans) -> Result:
    o3d: Any = importlib.import_module("open3d")
    cloud = o3d.geometry.PointCloud()
    for points, pose in scans:
        ranges = np.linalg.norm(points, axis=1)
        points = points[(ranges > 0.5) & (ranges < RANGE)]
        scan = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)).voxel_down_sample(VOXEL)
        scan.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=10 * VOXEL, max_nn=30))
        scan.orient_normals_towards_camera_location(np.zeros(3))
        cloud += scan.transform(pose)
    cloud = cloud.voxel_down_sample(VOXEL)
    depth = int(np.ceil(np.log2(1.1 * np.max(cloud.get_max_bound() - cloud.get_min_bound()) / VOXEL)))
    mesh, density = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=depth)
    mesh.remove_vertices_by_mask(np.asarray(density) < np.quantile(density, 0.05))
    return np.asarray(mesh.vertices), np.asarray(mesh.triangles)


def octomap_free_space(scans: Scans) -> Result:
    pyoctomap: Any = importlib.import_module("pyoctomap")
    tree = pyoctomap.OcTree(VOXEL)
    for points, pose in scans:
        points = points[np.linalg.norm(points, axis=1) > 0.5]
        tree.insertPointCloud(points.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3], pose[:3, 3].copy(), RANGE, True, True)
    tree.updateInnerOccupancy()
    return tree, None


SYSTEMS: dict[str, tuple[str, Callable[[Scans], Result], str]] = {
    "voxelastic": ("surfaces", voxelastic_surfaces, "voxelastic"),
    "vdbfusion": ("surfaces", vdbfusion_surfaces, "vdbfusion"),
    "open3d": ("surfaces (Poisson)", open3d_poisson, "open3d"),
    "voxelastic-space": ("free space", voxelastic_free_space, "voxelastic"),
    "octomap": ("free space", octomap_free_space, "pyoctomap"),
}


def lines_of(function: Callable[[Scans], Result]) -> int:
    """Lines of code of a function, with its import instead of its head."""
    return sum(bool(line.strip()) and not line.strip().startswith("#") for line in inspect.getsource(function).splitlines()) - 1


class Feed:
    """The scans of a folder, one by one, until a time limit; the time that reading takes is not counted."""

    def __init__(self, folder: Path, limit: float) -> None:
        self.files, self.poses, self.limit = sorted(folder.glob("*.npy")), np.load(folder / "poses" / "poses.npy"), limit
        self.count, self.reading = 0, 0.0

    def __iter__(self) -> Scans:
        begin = time.process_time()
        for k, (file, pose) in enumerate(zip(self.files, self.poses, strict=True)):
            if time.process_time() - begin - self.reading > self.limit:
                return
            if k % 10 != 5:
                before = time.process_time()
                points = np.load(file)
                self.reading += time.process_time() - before
                self.count += 1
                yield points, pose

    def held_out(self) -> NDArray[np.float64]:
        """Points of the scans that were not mapped, map frame."""
        parts = []
        for file, pose in list(zip(self.files, self.poses, strict=True))[5::10]:
            points = np.load(file)
            ranges = np.linalg.norm(points, axis=1)
            parts.append(points[(ranges > 1) & (ranges < 30)] @ pose[:3, :3].T + pose[:3, 3])
        return np.concatenate(parts)


def measure(name: str, folder: Path, limit: float) -> dict[str, Any]:
    """Runs a system in this process."""
    _, function, package = SYSTEMS[name]
    feed = Feed(folder, limit)
    importlib.import_module(package)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    cpu, wall = time.process_time(), time.perf_counter()
    vertices, triangles = function(iter(feed))
    cpu, wall = time.process_time() - cpu - feed.reading, time.perf_counter() - wall
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    found = {"version": version(package), "scans": feed.count, "cpu_s": cpu, "wall_s": wall, "peak_mb": peak, "import_mb": before}
    if triangles is not None and feed.count >= 0.9 * len(feed.files) - 1:
        corners, indices = np.asarray(vertices, np.float32), np.asarray(triangles, np.int32)
        mesh = vx.Mesh(corners, indices, np.zeros_like(corners), np.zeros(len(corners), np.uint8), None, None)
        distances = mesh.distance(feed.held_out(), up_to=1.0)
        found |= {"triangles": len(indices), "median_cm": 100 * float(np.median(distances)), "within_5cm": float((distances < 0.05).mean())}
    return found


def export(data: str, folder: Path) -> None:
    """The returns of a data set as N x 3 arrays, and its poses."""
    poses = []
    for k, scan in enumerate(vx.Dataset.open(data)):
        if scan.pose is None:
            sys.exit(f"{data}: the scans have no poses")
        points = scan.points.reshape(-1, 3)
        np.save(folder / f"{k:06}.npy", points[np.isfinite(points).all(axis=1) & points.any(axis=1)])
        poses.append(scan.pose)
    (folder / "poses").mkdir()
    np.save(folder / "poses" / "poses.npy", np.array(poses))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", help="scans with poses: a folder or a recording")
    parser.add_argument("--limit", type=float, default=300, help="seconds of processor time after which a system gets no further scans")
    parser.add_argument("--one", choices=SYSTEMS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measure(options.one, Path(options.data), options.limit)))
        return
    with tempfile.TemporaryDirectory() as temporary:
        export(options.data, Path(temporary))
        print("| system | what | scans | processor time a scan | peak memory | held-out points, median / within 5 cm | lines |\n| --- | --- | --- | --- | --- | --- | --- |")
        for name, (what, function, _) in SYSTEMS.items():
            command = [sys.executable, __file__, temporary, "--one", name, "--limit", str(options.limit)]
            done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"PYTHONWARNINGS": "ignore"})
            if done.returncode:
                reason = done.stderr.strip().splitlines()[-1:] or [f"it ended with {done.returncode}"]
                print(f"{name} is left out: {reason[0]}", file=sys.stderr)
                continue
            found = json.loads(done.stdout.splitlines()[-1])
            error = f"{found['median_cm']:.2f} cm / {found['within_5cm']:.1%}" if "median_cm" in found else ""
            each = f"{1e3 * found['cpu_s'] / found['scans']:,.1f} ms"
            print(f"| {name} {found['version']} | {what} | {found['scans']} | {each} | {found['peak_mb']:,.0f} MB | {error} | {lines_of(function)} |", flush=True)


if __name__ == "__main__":
    main()
