"""How far do an OctoMap and a Voxelastic map of the same scans agree, and where do they not?

    voxelastic map DATA/hall -o hall20.vox --field occupancy --voxel-size 0.2 --max-range 20 --lambda-odom 1000
    voxelastic export hall20.vox -o hall20.bt
    python3 agreement.py DATA/hall hall20.bt

Needs numpy and pyoctomap. OctoMap runs with its own defaults (hit 0.7, miss 0.4, clamping 0.12 to 0.97). Poses are those of
poses.tum; the scans are binary PCD files of x, y, z. Prints the 3 x 3 table of states over all voxels that either map knows, and what
the voxels that differ have in common.
"""
import sys
from pathlib import Path

import numpy as np
import pyoctomap

UNKNOWN, FREE, OCCUPIED = 0, 1, 2
NAMES = ["unknown", "free", "occupied"]


def scans(folder, min_range=0.5):
    """Points in the map frame and the sensor's place, scan by scan."""
    rows = [line for line in (folder / "poses.tum").read_text().splitlines() if not line.startswith("#")]
    for i, row in enumerate(rows):
        _, x, y, z, qx, qy, qz, qw = map(float, row.split())
        data = (folder / "scans" / f"{i:06d}.pcd").read_bytes()
        points = np.frombuffer(data[data.index(b"DATA binary\n") + 12 :], np.float32).reshape(-1, 3).astype(float)
        ranges = np.linalg.norm(points, axis=1)
        points = points[np.isfinite(ranges) & (ranges > min_range)]
        rotation = np.array(
            [
                [1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qz * qw), 2 * (qx * qz + qy * qw)],
                [2 * (qx * qy + qz * qw), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qx * qw)],
                [2 * (qx * qz - qy * qw), 2 * (qy * qz + qx * qw), 1 - 2 * (qx * qx + qy * qy)],
            ]
        )
        yield points @ rotation.T + [x, y, z], np.array([x, y, z])


def leaves(tree):
    """Lowest voxel, edge in voxels and state of every leaf."""
    res = tree.getResolution()
    for leaf in tree.begin_leafs():
        edge = round(leaf.getSize() / res)
        low = [round((c - 0.5 * leaf.getSize()) / res) for c in leaf.getCoordinate()]
        yield low, edge, OCCUPIED if tree.isNodeOccupied(leaf) else FREE


def grids(trees):
    """Both trees as arrays over one box."""
    lists = [list(leaves(tree)) for tree in trees]
    low = np.min([leaf[0] for each in lists for leaf in each], axis=0) - 2
    high = np.max([np.add(leaf[0], leaf[1]) for each in lists for leaf in each], axis=0) + 2
    arrays = []
    for each in lists:
        array = np.zeros(high - low, np.uint8)
        for corner, edge, state in each:
            a = np.subtract(corner, low)
            array[a[0] : a[0] + edge, a[1] : a[1] + edge, a[2] : a[2] + edge] = state
        arrays.append(array)
    return arrays


def near(mask, steps=1):
    """The mask grown by a voxel in all 26 directions, some times."""
    for _ in range(steps):
        for axis in range(3):
            mask = mask | np.roll(mask, 1, axis) | np.roll(mask, -1, axis)
    return mask


def main(folder, file, max_range=20.0):
    ours = pyoctomap.OcTree(1.0)
    assert ours.readBinary(str(file)), f"{file}: not read"
    theirs = pyoctomap.OcTree(ours.getResolution())
    for points, origin in scans(folder):
        theirs.insertPointCloud(points, origin, max_range, True, False)
    theirs.updateInnerOccupancy()
    a, b = grids([ours, theirs])
    known = (a > 0) | (b > 0)
    print(f"voxels of {ours.getResolution()} m known to either: {known.sum():,}; to both: {((a > 0) & (b > 0)).sum():,}")
    print(f"{'Voxelastic':>12} | " + " ".join(f"{'OctoMap ' + n:>18}" for n in NAMES))
    for i, name in enumerate(NAMES):
        print(f"{name:>12} | " + " ".join(f"{((a == i) & (b == j) & known).sum():18,}" for j in range(3)))
    both = (a > 0) & (b > 0)
    print(f"same state, of those known to both: {100 * (a[both] == b[both]).mean():.2f} %")
    surface = {"OctoMap's": near(b == OCCUPIED), "our": near(a == OCCUPIED)}
    edge = near((b == UNKNOWN))
    for i, j in [(OCCUPIED, FREE), (FREE, OCCUPIED), (UNKNOWN, FREE), (UNKNOWN, OCCUPIED), (FREE, UNKNOWN), (OCCUPIED, UNKNOWN)]:
        which = (a == i) & (b == j)
        n = max(which.sum(), 1)
        shares = ", ".join(f"{100 * (which & s).sum() / n:.1f} % next to {k} occupied voxels" for k, s in surface.items())
        print(f"ours {NAMES[i]}, OctoMap's {NAMES[j]}: {which.sum():,}: {shares}, {100 * (which & edge).sum() / n:.1f} % next to OctoMap's unknown")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
