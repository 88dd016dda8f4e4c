#!/usr/bin/env python3
"""What calls on a map cost: a million distances at once, and a mesh handed over to numpy.

    voxelastic map DATA/hall -o hall.vox --field both
    python crates/doors/voxelastic-python/benches/calls.py hall.vox

Points are within 5 cm of the surface, or anywhere in the bounds of the map. Processor time is that of all threads, so a busy machine changes it little; divided by the
number of threads it is what a quiet machine needs at best. A mesh is extracted by other threads: what the calling thread needs meanwhile is what numpy adds.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import voxelastic as vx

Points = NDArray[np.float32]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("map", type=Path, help="a saved map with both fields")
    parser.add_argument("--points", type=int, default=1_000_000, help="points of a query")
    parser.add_argument("--repeat", type=int, default=7, help="calls of each kind, in turn")
    options = parser.parse_args()
    map, random = vx.Map.open(options.map), np.random.default_rng(1)
    mesh, bounds = map.mesh(), map.bounds
    assert bounds is not None, "the map is empty"
    chosen = mesh.vertices[random.integers(0, len(mesh.vertices), options.points)]
    places = {
        "near surfaces": (chosen + random.uniform(-0.05, 0.05, chosen.shape)).astype(np.float32),
        "anywhere": random.uniform(bounds[0], bounds[1], chosen.shape).astype(np.float32),
    }
    kinds: dict[str, Callable[[Points], object]] = {
        "distance": map.distance,
        "state": map.state,
        "query": map.query,
        "query, 1,000 at a time": lambda points: [map.query(points[k : k + 1000]) for k in range(0, len(points), 1000)],
    }
    calls = {f"{kind}, {name}": partial(call, points) for name, points in places.items() for kind, call in kinds.items()}
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in calls}
    for _ in range(options.repeat):
        for name, call in calls.items():
            cpu, wall = time.process_time(), time.perf_counter()
            call()
            times[name].append((time.process_time() - cpu, time.perf_counter() - wall))
    print(f"{map}; {options.points:,} points\n\n| call | processor time, median (least) | wall time, median (least) |\n| --- | --- | --- |")
    for name, pairs in times.items():
        cells = [f"{1e3 * statistics.median(values):.0f} ms ({1e3 * min(values):.0f})" for values in zip(*pairs, strict=True)]
        print(f"| {name} | {' | '.join(cells)} |")
    handed_over = []
    for _ in range(options.repeat):
        begin = time.thread_time()
        mesh = map.mesh()
        handed_over.append(time.thread_time() - begin)
    owned = [array.flags.owndata for array in (mesh.vertices, mesh.triangles, mesh.normals)]
    millions = len(mesh) / 1e6
    print(f"\n{mesh}: {1e3 * statistics.median(handed_over):.2f} ms in the calling thread, {1e3 * statistics.median(handed_over) / millions:.2f} ms for a million triangles")
    print(f"memory of the extraction itself, not a copy: {'no' if any(owned) else 'yes'}")


if __name__ == "__main__":
    main()
