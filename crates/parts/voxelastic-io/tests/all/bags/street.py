"""Puts a KITTI street into every recording format, and ten of its scans into every format of clouds whose library is installed:
street.py STREET FOLDER. Uses write.py's writers."""
import sys
from pathlib import Path

import numpy as np

street, folder = Path(sys.argv[1]), Path(sys.argv[2]) / "recordings"
folder.mkdir()
one, two = Drive(ros1=True), Drive(ros1=False)
scans = sorted((street / "velodyne").glob("*.bin"))


def messages(drive):
    field = drive.type("sensor_msgs/msg/PointField")
    fields = [field(name=n, offset=4 * k, datatype=7, count=1) for k, n in enumerate(("x", "y", "z", "intensity"))]
    out = []
    for k, scan in enumerate(scans):
        raw = np.fromfile(scan, np.uint8)
        n = raw.size // 16
        cloud = drive.type("sensor_msgs/msg/PointCloud2")(
            header=drive.header(k, "lidar"), height=1, width=n, fields=fields, is_bigendian=False, point_step=16, row_step=16 * n, data=raw, is_dense=True)
        time = 100_000_000_000 + k * 100_000_000
        out += [("/points", time, cloud), ("/odometry", time + 50_000_000, drive.odometry(k))]
    return out


for name, compression in (("none", None), ("bz2", Writer1.CompressionFormat.BZ2), ("lz4", Writer1.CompressionFormat.LZ4)):
    bag1(folder / f"ros1_{name}.bag", messages(one), one, compression)
for name in ("none", "lz4", "zstd"):
    mcap(folder / f"ros2_{name}.mcap", messages(two), two, getattr(CompressionType, name.upper()))
sqlite(folder / "ros2_sqlite", messages(two), two)
sqlite(folder / "ros2_sqlite_zstd", messages(two), two, packed=True)


def clouds(kind):
    """A folder for a format, and the scans to be written there."""
    out = folder.parent / "clouds" / kind
    out.mkdir(parents=True)
    for scan in scans[:10]:
        yield str(out / f"{scan.stem}.{kind}"), np.fromfile(scan, np.float32).reshape(-1, 4).astype(np.float64)


for path, points in clouds("bin"):
    points.astype(np.float32).tofile(path)
try:
    import open3d

    for kind in ("pcd", "ply"):
        for path, points in clouds(kind):
            open3d.io.write_point_cloud(path, open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points[:, :3])))
except ImportError:
    pass
try:
    import laspy

    for kind in ("las", "laz"):
        for path, points in clouds(kind):
            las = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
            las.header.scales = [1e-3] * 3
            las.x, las.y, las.z = points[:, :3].T
            las.write(path)
except ImportError:
    pass
try:
    import pye57

    for path, points in clouds("e57"):
        file = pye57.E57(path, mode="w")
        file.write_scan_raw(dict(zip(("cartesianX", "cartesianY", "cartesianZ", "intensity"), points.T)))
        file.close()
except ImportError:
    pass
