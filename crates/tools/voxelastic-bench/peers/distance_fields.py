"""Distance fields of others on the same map, keyframe by keyframe.

    cargo run --release -p voxelastic-esdf --example seeds -- campus 60 seeds > seeds/ours.txt
    python3 distance_fields.py seeds [EVERY]

Needs numpy, and what is installed of edt, scipy and open3d. None of them is incremental: after each keyframe (each EVERY-th, by default 6th) the occupied voxels of
our map are put into a dense grid around them, which is not timed, and the whole field is computed again, one thread, unlimited distance. Ours is updated where the map
has changed, up to 2 m. Prints processor times, and how distances at the end differ from ours and from the world's, at places in free space 0.2 to 1.8 m from a surface.
"""
import os
import sys
import time
from importlib.metadata import version
from pathlib import Path

if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:1])
import numpy as np

VOXEL, REACH = 0.2, 2.0
folder, every = Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 6


def peers():
    """Name, and what computes the distances of a grid's voxels to those that are set, metres."""
    try:
        import edt

        yield f"edt {version('edt')}", lambda grid: edt.edt(~grid, anisotropy=(VOXEL,) * 3, black_border=False, parallel=1)
    except ImportError:
        print("edt is not installed")
    try:
        import scipy
        from scipy.ndimage import distance_transform_edt

        yield f"scipy {scipy.__version__}", lambda grid: distance_transform_edt(~grid, sampling=VOXEL)
    except ImportError:
        print("scipy is not installed")


def timed(work):
    start = time.process_time()
    result = work()
    return result, 1e3 * (time.process_time() - start)


def dense(voxels):
    """A grid with the reach around all voxels, and its lowest voxel."""
    pad = int(np.ceil(REACH / VOXEL))
    low = voxels.min(0) - pad
    grid = np.zeros(voxels.max(0) + pad + 1 - low, bool)
    grid[tuple((voxels - low).T)] = True
    return grid, low


def interpolated(field, at):
    """Between the centres of eight voxels; the reach outside of the field."""
    first = np.floor(at).astype(int)
    inside = ((first >= 0) & (first + 1 < field.shape)).all(1)
    first, share = first[inside], (at - first)[inside]
    found, between = np.full(len(at), REACH), np.zeros(len(first))
    for corner in np.ndindex(2, 2, 2):
        weight = np.where(corner, share, 1 - share).prod(1)
        between += weight * np.minimum(field[tuple((first + corner).T)], REACH)
    found[inside] = between
    return found


def report(name, distances, reference, others):
    off = np.abs(np.minimum(distances, REACH) - np.minimum(reference, REACH))
    print(f"{name} against {others}: mean {100 * off.mean():.2f} cm, median {100 * np.median(off):.2f}, 99 % {100 * np.percentile(off, 99):.2f} at {off.size} places")


keyframes = sorted(folder.glob("[0-9]*.npy"))
keyframes = sorted(set(keyframes[every - 1 :: every] + keyframes[-1:]))
points, ours, truth = (np.load(folder / f"{name}.npy") for name in ("points", "voxels", "truth"))
report("ours", ours, truth, "the world")
systems = list(peers())
times = {name: [] for name, _ in systems}
for keyframe in keyframes:
    voxels = np.load(keyframe)
    grid, low = dense(voxels)
    line = [f"{keyframe.stem}: {len(voxels)} occupied, {grid.size / 1e6:.0f} million voxels"]
    for name, compute in systems:
        field, ms = timed(lambda: compute(grid))
        times[name].append(ms)
        line.append(f"{name} {ms:.0f} ms")
        if keyframe == keyframes[-1]:
            found = interpolated(field, points / VOXEL - 0.5 - low)
            report(name, found, ours, "ours")
            report(name, found, truth, "the world")
        del field
    print(", ".join(line), flush=True)
for name, of in times.items():
    print(f"{name}: median {np.median(of):.0f} ms, most {max(of):.0f} ms a keyframe, {len(of)} keyframes")

try:
    import open3d as o3d

    # A cube for each occupied voxel; distances at the places only, not in a field.
    voxels = np.load(keyframes[-1])
    corners = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)])
    faces = np.array([[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4], [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]])
    vertices = ((voxels[:, None] + corners) * VOXEL).reshape(-1, 3).astype(np.float32)
    triangles = (np.arange(len(voxels))[:, None, None] * 8 + faces).reshape(-1, 3).astype(np.uint32)

    def build():
        scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        scene.add_triangles(o3d.core.Tensor(vertices), o3d.core.Tensor(triangles))
        scene.compute_distance(o3d.core.Tensor(points[:1].astype(np.float32)), nthreads=1)
        return scene

    scene, building = timed(build)
    found, asking = timed(lambda: scene.compute_distance(o3d.core.Tensor(points.astype(np.float32)), nthreads=1).numpy())
    print(f"open3d {o3d.__version__}: scene of {len(triangles)} triangles {building:.0f} ms, {len(points)} places {asking:.0f} ms")
    report("open3d", found, ours, "ours")
    report("open3d", found, truth, "the world")
except ImportError:
    print("open3d is not installed")
