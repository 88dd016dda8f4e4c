"""Scores of the removal of moving things, beside DUFOMap, on a simulated folder with labels.

    voxelastic simulate street -o street --traffic 24 --rate 10 --scans 150 --drift 0
    voxelastic map street -o all.vox --poses groundtruth
    voxelastic map street -o clean.vox --poses groundtruth --dynamic remove --dynamic-points moving.ply
    voxelastic mesh all.vox -o all.ply && voxelastic mesh clean.vox -o clean.ply
    python3 moving.py street moving.ply [all.ply clean.ply] [--json]

The folder may be one of SemanticKITTI, too (velodyne/, labels/, poses.txt, calib.txt): what has the label of a moving thing moves, what has no label does not count.
With --json the scores are JSON objects, one a line.

Needs numpy and scipy; open3d for the scores of the maps; dufomap for the peer (pip install dufomap). Prints the shares of static points kept (SA) and of
points on things that move removed (DA), and AA, the root of their product. Online, a point is removed if it was set aside when it came; points on what
stands and moves at another time do not count. Offline, it is removed if it is not within 10 cm of the clean surface, of those within 10 cm of the surface of
everything; what stands at first and leaves counts as moving, what has come to rest does not count. Thin things are static points in whose neighbourhood
points lie along a line; the share is of those within 10 cm of the surface of everything.
"""
import json
import sys
import time
from pathlib import Path

import numpy as np

NEAR, FAR = 1.0, 60.0


def read_pcd(path):
    data = path.read_bytes()
    at = data.index(b"DATA binary")
    head = {line.split()[0]: line.split()[1:] for line in data[:at].decode().splitlines() if line and line[0] != "#"}
    kinds = {("F", "4"): "<f4", ("U", "4"): "<u4", ("U", "2"): "<u2", ("U", "1"): "u1"}
    fields = np.dtype([(n, kinds[k, s]) for n, s, k in zip(head["FIELDS"], head["SIZE"], head["TYPE"])])
    cloud = np.frombuffer(data[data.index(b"\n", at) + 1 :], fields, count=int(head["POINTS"][0]))
    return np.stack([cloud["x"], cloud["y"], cloud["z"]], 1)


def rotation(x, y, z, w):
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def scans(folder):
    """Points in the lidar frame, labels and pose of each scan."""
    if (folder / "velodyne").is_dir():
        yield from semantic_kitti(folder)
        return
    poses = np.loadtxt(folder / "groundtruth.tum")
    for k, (path, row) in enumerate(zip(sorted((folder / "scans").glob("*.pcd")), poses)):
        points = read_pcd(path)
        labels = np.fromfile(folder / "labels" / f"{path.stem}.label", "<u4")
        ranges = np.linalg.norm(points, axis=1)
        kept = np.isfinite(ranges) & (ranges > NEAR) & (ranges < FAR)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation(*row[4:]), row[1:4]
        yield points[kept], labels[kept], pose


def semantic_kitti(folder):
    """The same of a folder of SemanticKITTI, whose poses are those of the camera."""
    lines = (folder / "calib.txt").read_text().splitlines()
    t_camera_lidar = np.eye(4)
    t_camera_lidar[:3] = next(np.array(line.split()[1:], float).reshape(3, 4) for line in lines if line.startswith("Tr:"))
    rows = np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)
    for path, row in zip(sorted((folder / "velodyne").glob("*.bin")), rows):
        points = np.fromfile(path, np.float32).reshape(-1, 4)[:, :3]
        classes = np.fromfile(folder / "labels" / f"{path.stem}.label", "<u4") & 0xFFFF
        labels = np.where(classes >= 252, 1, np.where(classes <= 1, 9, 0))
        ranges = np.linalg.norm(points, axis=1)
        kept = (ranges > NEAR) & (ranges < FAR)
        camera = np.eye(4)
        camera[:3] = row
        yield points[kept], labels[kept], np.linalg.inv(t_camera_lidar) @ camera @ t_camera_lidar


def in_map(points, pose):
    return points.astype(float) @ pose[:3, :3].T + pose[:3, 3]


def vertices(path):
    """Points of a binary PLY whose vertices begin with x y z as floats."""
    data = path.read_bytes()
    head = data[: data.index(b"end_header\n")].decode().splitlines()
    count, sizes = 0, {"float": 4, "uchar": 1, "int": 4, "uint": 4, "double": 8}
    size, is_vertex = 0, False
    for line in head:
        words = line.split()
        if words[0] == "element":
            is_vertex = words[1] == "vertex"
            count = int(words[2]) if is_vertex else count
        elif words[0] == "property" and is_vertex:
            size += sizes[words[1]]
    raw = np.frombuffer(data[data.index(b"end_header\n") + 11 :], "u1", count=count * size).reshape(count, size)
    return raw[:, :12].copy().view("<f4").astype(float)


def score(name, removed, labels, moving, cpu_ms=None):
    static = ~removed[labels == 0]
    dynamic = removed[np.isin(labels, moving)]
    sa, da = 100 * static.mean(), 100 * dynamic.mean()
    if "--json" in sys.argv:
        print(json.dumps({"system": name, "static_kept": sa, "moving_removed": da, "cpu_ms": cpu_ms}), flush=True)
        return
    print(f"{name:28s} SA {sa:6.2f}  DA {da:6.2f}  AA {np.sqrt(sa * da):6.2f} %   ({len(static)} static, {len(dynamic)} moving points)", flush=True)


def are_thin(points):
    """Which of some points are on poles, cables or rails: points within 0.3 m lie along a line, at least 0.3 m long."""
    from scipy.spatial import cKDTree

    _, first, cell = np.unique(np.floor(points / 0.05).astype(int), axis=0, return_index=True, return_inverse=True)
    samples = points[first]
    tree = cKDTree(samples)
    thin = np.zeros(len(samples), bool)
    # The neighbours of all at once take more than ten gigabytes.
    for begin in range(0, len(samples), 20_000):
        for k, near in enumerate(tree.query_ball_point(samples[begin : begin + 20_000], 0.3, workers=-1), begin):
            if len(near) >= 6:
                least, middle, most = np.sqrt(np.linalg.eigvalsh(np.cov(samples[near].T)).clip(0))
                thin[k] = most > 0.1 and middle < 0.25 * most
    return thin[cell.ravel()]


def main():
    folder, set_aside, *meshes = (Path(word) for word in sys.argv[1:] if word != "--json")
    all_scans = list(scans(folder))
    labels = np.concatenate([scan[1] for scan in all_scans])
    points = np.concatenate([in_map(scan[0], scan[2]) for scan in all_scans])

    from scipy.spatial import cKDTree

    removed = vertices(set_aside)
    near = cKDTree(removed).query(points, distance_upper_bound=2e-3)[0] < 2e-3 if len(removed) else np.zeros(len(points), bool)
    score("Voxelastic, online", near, labels, [1])
    if meshes:
        import open3d as o3d

        def distances(path):
            scene = o3d.t.geometry.RaycastingScene()
            scene.add_triangles(o3d.t.io.read_triangle_mesh(str(path)))
            parts = np.array_split(points.astype(np.float32), max(1, len(points) // 200_000))
            return np.concatenate([scene.compute_distance(o3d.core.Tensor(part)).numpy() for part in parts])

        mapped = distances(meshes[0]) < 0.1
        gone = distances(meshes[1]) > 0.1
        score("Voxelastic, offline", gone[mapped], labels[mapped], [1, 2])
        static = mapped & (labels == 0)
        thin = are_thin(points[static])
        print(f"thin things: {100 * (~gone[static][thin]).mean():.2f} % kept of {thin.sum()} points", flush=True)
    try:
        from importlib.metadata import version

        from dufomap import dufomap
    except ImportError:
        print("DUFOMap is left out: this Python has no dufomap (pip install dufomap)")
        return
    # user code: begin
    peer = dufomap(0.1, 0.2, 1, num_threads=1)
    # user code: end
    name = f"DUFOMap {version('dufomap')}"
    online, seconds = [], 0.0
    for cloud, _, pose in all_scans:
        clock = time.process_time()
        # user code: begin
        peer.run(cloud, pose, cloud_transform=True)
        online.append(peer.segment(cloud, pose, cloud_transform=True) > 0)
        # user code: end
        seconds += time.process_time() - clock
    cpu_ms = 1e3 * seconds / len(all_scans)
    score(f"{name}, online", np.concatenate(online), labels, [1], cpu_ms)
    # user code: begin
    peer.oncePropagateCluster(if_propagate=True, if_cluster=False)
    offline = np.concatenate([peer.segment(cloud, pose, cloud_transform=True) > 0 for cloud, _, pose in all_scans])
    # user code: end
    score(f"{name}, offline", offline, labels, [1, 2])
    if "--json" not in sys.argv:
        print(f"DUFOMap: {cpu_ms:.0f} ms of processor time a scan")


if __name__ == "__main__":
    main()
