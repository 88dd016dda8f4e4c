"""Odometry of KISS-ICP on a folder of scans, and errors of any trajectory against true poses.

    pip install kiss-icp==1.3.0 numpy
    python3 slam_peers.py kiss FOLDER OUT.txt           # KITTI rows; prints processor time of a scan
    python3 slam_peers.py errors POSES.txt TRUTH.txt    # absolute (after alignment) and relative over 10, 50 and 100 m, KITTI rows both

The relative error begins at every scan, as KITTI's own evaluation does with every tenth. Clouds are PCD (binary, x y z first) or KITTI .bin.
"""

import sys
import time
from pathlib import Path

import numpy as np


def cloud(path):
    if path.suffix == ".bin":
        return np.fromfile(path, np.float32).reshape(-1, 4)[:, :3].astype(np.float64)
    data = path.read_bytes()
    start = data.index(b"DATA binary\n") + len(b"DATA binary\n")
    header = dict(line.split(" ", 1) for line in data[:start].decode().splitlines() if " " in line and not line.startswith("#"))
    points, fields = int(header["POINTS"]), len(header["FIELDS"].split())
    return np.frombuffer(data[start:], np.float32, points * fields).reshape(points, fields)[:, :3].astype(np.float64)


def kiss(folder, out):
    from kiss_icp.config import KISSConfig
    from kiss_icp.kiss_icp import KissICP

    config = KISSConfig()
    config.data.deskew, config.data.max_range, config.data.min_range = False, 100.0, 0.5
    config.registration.max_num_threads, config.mapping.voxel_size = 1, 1.0
    odometry, poses, times = KissICP(config), [], []
    for path in sorted(p for p in Path(folder).iterdir() if p.suffix in (".bin", ".pcd")):
        points, begin = cloud(path), time.process_time()
        odometry.register_frame(points, np.zeros(0))
        times.append((time.process_time() - begin) * 1e3)
        poses.append(odometry.last_pose[:3].ravel())
    np.savetxt(out, poses)
    print(f"{len(times)} scans, processor time: median {np.median(times):.1f} ms, mean {np.mean(times):.1f} ms")


def errors(estimate, truth):
    load = lambda path: np.concatenate([np.loadtxt(path).reshape(-1, 3, 4), np.tile([[[0, 0, 0, 1]]], (len(np.loadtxt(path)), 1, 1))], axis=1)
    estimate, truth = load(estimate), load(truth)
    a, b = estimate[:, :3, 3], truth[:, :3, 3]
    u, _, v = np.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)))
    turn = v.T @ np.diag([1, 1, np.sign(np.linalg.det(v.T @ u.T))]) @ u.T
    distances = np.linalg.norm((a - a.mean(0)) @ turn.T + b.mean(0) - b, axis=1)
    print(f"absolute: root mean square {np.sqrt((distances**2).mean()):.3f} m, mean {distances.mean():.3f} m")
    path = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(b, axis=0), axis=1))])
    for step in (10, 50, 100):
        shares, angles = [], []
        for i in range(len(path)):
            j = np.searchsorted(path, path[i] + step)
            if j < len(path):
                error = np.linalg.inv(np.linalg.inv(truth[i]) @ truth[j]) @ np.linalg.inv(estimate[i]) @ estimate[j]
                shares.append(np.linalg.norm(error[:3, 3]) / (path[j] - path[i]) * 100)
                angles.append(np.degrees(np.arccos(np.clip((np.trace(error[:3, :3]) - 1) / 2, -1, 1))))
        if shares:
            print(f"over {step} m: {np.mean(shares):.2f} %, {np.mean(angles):.2f} degrees")


if __name__ == "__main__":
    {"kiss": kiss, "errors": errors}[sys.argv[1]](*sys.argv[2:])
