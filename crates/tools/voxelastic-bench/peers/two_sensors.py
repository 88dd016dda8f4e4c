"""One or two sensors of one recording: distances of held-out points to the mesh of VDBFusion and to those of other programs, in one run.

    voxelastic simulate street -o street --bag --sensor vlp-16 --second-lidar vlp-16 --columns 900 --spacing 0.5 --scans 150
    voxelastic map street/recording.mcap --poses street/groundtruth.tum --cloud-topic /points --cloud-topic /points_2 --every scan --hold-out 10 \
        --voxel-size 0.1 -o both.vox && voxelastic mesh both.vox -o both.ply
    python3 two_sensors.py street both.ply

Needs numpy, open3d, mcap-ros2-support and vdbfusion (Python 3.10 or older). The place of the second sensor on the first is the simulator's default.
"""
import sys
import time
from pathlib import Path

import numpy as np
import open3d as o3d
import vdbfusion
from mcap_ros2.reader import read_ros2_messages

HOLD_OUT, NEAR, FAR, VOXEL = 10, 1.0, 30.0, 0.1
MOUNTED = [-0.6, 0, -0.3, -0.3420201433, 0, 0.9396926208, 0]


def matrix(x, y, z, qx, qy, qz, qw):
    pose = np.eye(4)
    pose[:3, :3] = o3d.geometry.get_rotation_matrix_from_quaternion([qw, qx, qy, qz])
    pose[:3, 3] = x, y, z
    return pose


def points_of(message):
    offsets = {field.name: field.offset for field in message.fields}
    kind = np.dtype({"names": list("xyz"), "formats": ["<f4"] * 3, "offsets": [offsets[axis] for axis in "xyz"], "itemsize": message.point_step})
    cloud = np.frombuffer(bytes(message.data), kind, message.width * message.height)
    return np.stack([cloud[axis] for axis in "xyz"], 1).astype(float)


def within(name, mesh, points):
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
    d = scene.compute_distance(o3d.core.Tensor(points.astype(np.float32))).numpy()
    shares = " / ".join(f"{100 * (d < limit).mean():.2f}" for limit in (0.05, 0.1, 0.3))
    print(f"{name}: {len(d)} points, median {100 * np.median(d):.2f} cm, 90 % {100 * np.quantile(d, 0.9):.2f} cm, within 5 / 10 / 30 cm {shares} %")


def main(folder, meshes):
    trajectory = np.loadtxt(Path(folder) / "groundtruth.tum")
    counts, volume, held_out, clock = {}, vdbfusion.VDBVolume(VOXEL, 3 * VOXEL, False), [], 0.0
    for item in read_ros2_messages(str(Path(folder) / "recording.mcap"), topics=["/points", "/points_2"]):
        topic, message = item.channel.topic, item.ros_msg
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        nearest = np.argmin(np.abs(trajectory[:, 0] - stamp))
        assert abs(trajectory[nearest, 0] - stamp) < 1e-3, stamp
        pose = matrix(*trajectory[nearest, 1:]) @ (matrix(*MOUNTED) if topic == "/points_2" else np.eye(4))
        points = points_of(message)
        ranges = np.linalg.norm(points, axis=1)
        points = points[np.isfinite(ranges) & (ranges > 0.5) & (ranges < 60.0)]
        in_map = points @ pose[:3, :3].T + pose[:3, 3]
        counts[topic] = counts.get(topic, 0) + 1
        if counts[topic] % HOLD_OUT == 0:
            ranges = np.linalg.norm(points, axis=1)
            held_out.append(in_map[(ranges > NEAR) & (ranges < FAR)])
            continue
        start = time.process_time()
        volume.integrate(in_map, pose)
        clock += time.process_time() - start
    print(f"scans {counts}; VDBFusion takes {1e3 * clock / sum(counts.values()):.1f} ms of processor time a scan")
    held_out = np.concatenate(held_out)
    vertices, triangles = volume.extract_triangle_mesh(False, 1.0)
    within("VDBFusion", o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(triangles)), held_out)
    for path in meshes:
        within(path, o3d.io.read_triangle_mesh(path), held_out)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
