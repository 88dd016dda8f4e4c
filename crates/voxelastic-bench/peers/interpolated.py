"""How right is what was interpolated? Distances of the points of held-out scans to a mesh of `voxelastic mesh --interpolated`, by whether the nearest
triangle is measured or interpolated (has a marked vertex).

    python interpolated.py MESH.ply FOLDER POSES --hold-out 10 --max-range 60

FOLDER has scans as .bin (KITTI) or .pcd; POSES is a TUM or a KITTI file, one pose a scan. Needs numpy and open3d.
"""

import argparse
from pathlib import Path

import numpy as np
import open3d as o3d


def read_ply(path):
    """Positions, marks and triangles of a mesh that `voxelastic mesh` wrote."""
    data = Path(path).read_bytes()
    head, body = data.split(b"end_header\n", 1)
    kinds = {"float": "<f4", "double": "<f8", "uchar": "u1"}
    fields, counts = [], {}
    for line in head.decode().splitlines():
        words = line.split()
        if words[0] == "element":
            counts[words[1]] = int(words[2])
        elif words[0] == "property" and words[1] != "list":
            fields.append((words[2], kinds[words[1]]))
    vertices = np.frombuffer(body, fields, counts["vertex"])
    faces = np.frombuffer(body, [("count", "u1"), ("vertices", "<u4", 3)], counts["face"], vertices.nbytes)
    positions = np.stack([vertices[axis] for axis in "xyz"], 1).astype(np.float32)
    return positions, vertices["interpolated"].astype(bool), faces["vertices"].astype(np.uint32)


def read_poses(path):
    """4 x 4 matrices of a file with lines of twelve numbers, or of a time, a position and a quaternion."""
    poses = []
    for line in Path(path).read_text().splitlines():
        if line.startswith("#") or not line.strip():
            continue
        numbers, pose = np.array(line.split(), float), np.eye(4)
        if len(numbers) == 12:
            pose[:3] = numbers.reshape(3, 4)
        else:
            x, y, z, w = numbers[4:8]
            pose[:3, :3] = o3d.geometry.get_rotation_matrix_from_quaternion([w, x, y, z])
            pose[:3, 3] = numbers[1:4]
        poses.append(pose)
    return poses


def read_points(path):
    if path.suffix == ".bin":
        return np.fromfile(path, np.float32).reshape(-1, 4)[:, :3]
    return np.asarray(o3d.io.read_point_cloud(str(path), remove_nan_points=True).points, np.float32)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mesh")
    parser.add_argument("folder", type=Path)
    parser.add_argument("poses")
    parser.add_argument("--hold-out", type=int, default=10)
    parser.add_argument("--max-range", type=float, default=60.0)
    args = parser.parse_args()
    positions, marks, triangles = read_ply(args.mesh)
    is_interpolated = marks[triangles].any(1)
    corners = positions[triangles].astype(np.float64)
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.core.Tensor(positions), o3d.core.Tensor(triangles))
    scans = sorted(path for path in args.folder.rglob("*") if path.suffix in (".bin", ".pcd"))
    poses = read_poses(args.poses)
    distances, kinds = [], []
    for k in range(args.hold_out - 1, len(scans), args.hold_out):
        points = read_points(scans[k])
        ranges = np.linalg.norm(points, axis=1)
        points = points[(ranges > 0.5) & (ranges < args.max_range)]
        points = (points @ poses[k][:3, :3].T + poses[k][:3, 3]).astype(np.float32)
        found = scene.compute_closest_points(o3d.core.Tensor(points))
        distances.append(np.linalg.norm(found["points"].numpy() - points, axis=1))
        kinds.append(is_interpolated[found["primitive_ids"].numpy()])
    distances, kinds = np.concatenate(distances), np.concatenate(kinds)
    for name, chosen, area in (("measured", ~kinds, areas[~is_interpolated]), ("interpolated", kinds, areas[is_interpolated])):
        d = distances[chosen]
        within = ", ".join(f"{100 * (d < limit).mean():.2f}" for limit in (0.05, 0.1, 0.2, 0.5))
        print(f"{name}: {area.sum():.0f} m2, {len(d)} points, median {100 * np.median(d):.2f} cm, within 5, 10, 20, 50 cm: {within} %")


if __name__ == "__main__":
    main()
