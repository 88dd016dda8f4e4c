"""Scores of the removal of moving things on a drive without labels, as far as it can be told what moves.

    voxelastic map kitti00-seq --poses poses_groundtruth.txt -o all.vox && voxelastic mesh all.vox -o all.ply
    voxelastic map kitti00-seq --poses poses_groundtruth.txt --dynamic remove --dynamic-points moving.ply -o clean.vox && voxelastic mesh clean.vox -o clean.ply
    python3 moving_kitti.py kitti00-seq moving.ply all.ply clean.ply

Where the recording car drives, nothing stands: what is above the road in its own lane, before it comes or after it was there, has moved, and so has what hangs together
with it in the same scan. What is in a cube of 20 cm in eight scans or more, over two seconds or more, stands. All other points have no label. Needs numpy and scipy;
open3d for the scores of the maps; dufomap for the peer.
"""
import sys
import time
from pathlib import Path

import numpy as np
from moving import score, vertices
from scipy.spatial import cKDTree

# The lidar is so high above the road, and the car so wide, metres.
HEIGHT, HALF_WIDTH = 1.73, 0.9
# Above the road by this, because poses are off by some centimetres.
LOW, HIGH = 0.35, 2.0
NEAR, FAR = 4.0, 40.0
LINK, REACH = 0.5, 3.0
CUBE, LEAST_SCANS, LEAST_SPAN = 0.2, 8, 20


def labels_of(clouds, poses):
    """0 for what stands, 1 for what moves, 9 for the rest, of the points of each scan in the map frame."""
    path = np.array([pose[:3, 3] for pose in poses])
    lane = cKDTree(path[:, :2])
    labels, cubes = [], []
    for k, (points, ranges) in enumerate(clouds):
        label = np.full(len(points), 9)
        off, nearest = lane.query(points[:, :2])
        above = points[:, 2] - (path[nearest, 2] - HEIGHT)
        stands_out = (above > LOW) & (above < HIGH) & (ranges > NEAR) & (ranges < FAR)
        seeds = np.flatnonzero(stands_out & (off < HALF_WIDTH) & (np.abs(nearest - k) > 3) & (nearest > 0) & (nearest < len(path) - 1))
        if len(seeds):
            candidates = np.flatnonzero(stands_out & (cKDTree(points[seeds, :2]).query(points[:, :2], distance_upper_bound=REACH)[0] < REACH))
            tree, found, front = cKDTree(points[candidates]), set(), list(np.flatnonzero(np.isin(candidates, seeds)))
            while front:
                found.update(front)
                near = tree.query_ball_point(points[candidates[front]], LINK)
                front = list(set().union(*near) - found)
            label[candidates[sorted(found)]] = 1
        labels.append(label)
        cubes.append(np.floor(points / CUBE).astype(np.int64) @ np.array([1, 1 << 20, 1 << 40]))
    keys = np.unique(np.concatenate(cubes))
    first, last, count = np.full(len(keys), 1 << 30), np.full(len(keys), -1), np.zeros(len(keys), int)
    places = [np.searchsorted(keys, cube) for cube in cubes]
    for k, place in enumerate(places):
        unique = np.unique(place)
        first[unique] = np.minimum(first[unique], k)
        last[unique] = k
        count[unique] += 1
    stands = (count >= LEAST_SCANS) & (last - first >= LEAST_SPAN)
    for label, place in zip(labels, places):
        label[stands[place] & (label != 1)] = 0
    return labels


def main():
    folder, set_aside, *meshes = map(Path, sys.argv[1:])
    rows = np.loadtxt(folder / "poses_groundtruth.txt").reshape(-1, 3, 4)
    poses = [np.vstack([row, [0, 0, 0, 1]]) for row in rows]
    raw, clouds = [], []
    for pose, path in zip(poses, sorted((folder / "velodyne").iterdir())):
        points = np.fromfile(path, np.float32).reshape(-1, 4)[:, :3].astype(float)
        ranges = np.linalg.norm(points, axis=1)
        points, ranges = points[(ranges > 1) & (ranges < 60)], ranges[(ranges > 1) & (ranges < 60)]
        raw.append(points)
        clouds.append((points @ pose[:3, :3].T + pose[:3, 3], ranges))
    per_scan = labels_of(clouds, poses)
    moving = [int((label == 1).sum()) for label in per_scan]
    print(f"points that move, by scan: {moving}")
    labels, points = np.concatenate(per_scan), np.concatenate([cloud for cloud, _ in clouds])
    removed = vertices(set_aside)
    score("Voxelastic, online", cKDTree(removed).query(points, distance_upper_bound=5e-3)[0] < 5e-3, labels, [1])
    if meshes:
        import open3d as o3d

        def distances(path):
            scene = o3d.t.geometry.RaycastingScene()
            scene.add_triangles(o3d.t.io.read_triangle_mesh(str(path)))
            return np.concatenate([scene.compute_distance(o3d.core.Tensor(part)).numpy() for part in np.array_split(points.astype(np.float32), 100)])

        mapped = distances(meshes[0]) < 0.1
        score("Voxelastic, offline", distances(meshes[1])[mapped] > 0.1, labels[mapped], [1])
    try:
        from dufomap import dufomap
    except ImportError:
        print("DUFOMap is left out: this Python has no dufomap (pip install dufomap)")
        return
    peer, online, seconds = dufomap(0.1, 0.2, 1, num_threads=1), [], 0.0
    for cloud, pose in zip(raw, poses):
        clock = time.process_time()
        peer.run(cloud.astype(np.float32), pose, cloud_transform=True)
        online.append(peer.segment(cloud.astype(np.float32), pose, cloud_transform=True) > 0)
        seconds += time.process_time() - clock
    score("DUFOMap, online", np.concatenate(online), labels, [1])
    peer.oncePropagateCluster(if_propagate=True, if_cluster=False)
    offline = [peer.segment(cloud.astype(np.float32), pose, cloud_transform=True) > 0 for cloud, pose in zip(raw, poses)]
    score("DUFOMap, offline", np.concatenate(offline), labels, [1])
    print(f"DUFOMap: {1e3 * seconds / len(poses):.0f} ms of processor time a scan")


if __name__ == "__main__":
    main()
