"""Puts a KITTI street into every recording format: street.py STREET FOLDER. Uses write.py's writers."""
import sys
from pathlib import Path

import numpy as np

street, folder = Path(sys.argv[1]), Path(sys.argv[2])
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
