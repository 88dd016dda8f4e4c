"""Writes one drive in every recording format, with other people's software: rosbags (ROS 1 bags, ROS 2 sqlite3) and mcap.

usage: write.py FOLDER

Scan k is taken at 100 + 0.1 k s; its point i lies at (1 + i / 8 + k, -i / 16, 0.5 i - k), has intensity i % 100, ring i % 16 and a time
of i / 10000 s behind the stamp. The vehicle is at (0.5 k, 0, 0) then, turned by 0.01 k rad about z; the lidar sits (0, 0, 1.5) above it.
"""
import sys
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer as McapWriter
from rosbags import rosbag2
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore, get_types_from_msg

SCANS, POINTS = 12, 320
LIVOX = {
    "livox_ros_driver2/msg/CustomPoint": "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line\n",
    "livox_ros_driver2/msg/CustomMsg": "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\nCustomPoint[] points\n",
}
TRANSFORMS = {"tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n"}
F32, F64, U32, U16, U8 = (7, "f4"), (8, "f8"), (6, "u4"), (4, "u2"), (2, "u1")
# name -> (fields, bytes of a point, rows, bytes that pad a row, big endian)
LAYOUTS = {
    "ouster": ([("x", 0, F32), ("y", 4, F32), ("z", 8, F32), ("intensity", 16, F32), ("t", 20, U32), ("reflectivity", 24, U16),
                ("ring", 26, U16), ("ambient", 28, U16), ("range", 32, U32)], 48, 16, 32, False),
    "velodyne": ([("x", 0, F32), ("y", 4, F32), ("z", 8, F32), ("intensity", 12, F32), ("ring", 16, U16), ("time", 18, F32)], 22, 1, 0, False),
    "shares": ([("x", 0, F32), ("y", 4, F32), ("z", 8, F32), ("time", 12, F32)], 16, 1, 0, False),
    "hesai": ([("x", 0, F32), ("y", 4, F32), ("z", 8, F32), ("intensity", 16, F32), ("timestamp", 24, F64), ("ring", 32, U16)], 34, 1, 0, False),
    "big": ([("z", 0, F64), ("y", 8, F64), ("x", 16, F64), ("intensity", 25, U8)], 27, 4, 5, True),
}


def seconds(k, offset=0.0):
    nanoseconds = 100_000_000_000 + round((0.1 * k + offset) * 1e9)
    return nanoseconds // 1_000_000_000, nanoseconds % 1_000_000_000


class Drive:
    def __init__(self, ros1):
        self.store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        self.ros1 = ros1
        for name, text in (LIVOX | TRANSFORMS).items():
            if name not in self.store.types:
                self.store.register(get_types_from_msg(text, name))

    def type(self, name):
        return self.store.types[name]

    def header(self, k, frame, offset=0.0):
        stamp = self.type("builtin_interfaces/msg/Time")(*seconds(k, offset))
        extra = {"seq": k} if self.ros1 else {}
        return self.type("std_msgs/msg/Header")(stamp=stamp, frame_id=frame, **extra)

    def cloud(self, k, layout, frame="lidar", offset=0.0):
        fields, step, rows, padding, big = LAYOUTS[layout]
        order = ">" if big else "<"
        i = np.arange(POINTS)
        values = {
            "x": 1 + i / 8 + k, "y": -i / 16, "z": 0.5 * i - k, "intensity": i % 100, "ring": i % 16, "t": i * 100_000,
            "time": i / 1e4, "timestamp": 100 + 0.1 * k + i / 1e4,
        }
        if layout == "shares":
            values["time"] = i / (POINTS - 1)
        dtype = np.dtype({"names": [f[0] for f in fields], "formats": [order + f[2][1] for f in fields], "offsets": [f[1] for f in fields],
                          "itemsize": step})
        points = np.zeros(POINTS, dtype)
        for name in dtype.names:
            points[name] = values.get(name, 7)
        width = POINTS // rows
        raw = np.frombuffer(points.tobytes(), np.uint8).reshape(rows, width * step)
        raw = np.concatenate([raw, np.full((rows, padding), 0xEE, np.uint8)], axis=1)
        field = self.type("sensor_msgs/msg/PointField")
        return self.type("sensor_msgs/msg/PointCloud2")(
            header=self.header(k, frame, offset), height=rows, width=width, fields=[field(name=n, offset=o, datatype=t[0], count=1) for n, o, t in fields],
            is_bigendian=big, point_step=step, row_step=width * step + padding, data=raw.reshape(-1), is_dense=True)

    def livox(self, k):
        point = self.type("livox_ros_driver2/msg/CustomPoint")
        points = [point(offset_time=i * 100_000, x=float(1 + i / 8 + k), y=float(-i / 16), z=float(0.5 * i - k), reflectivity=i % 100, tag=16, line=i % 16)
                  for i in range(POINTS)]
        return self.type("livox_ros_driver2/msg/CustomMsg")(
            header=self.header(k, "lidar"), timebase=0, point_num=POINTS, lidar_id=0, rsvd=np.zeros(3, np.uint8), points=points)

    def pose(self, k):
        t, q = self.type("geometry_msgs/msg/Point"), self.type("geometry_msgs/msg/Quaternion")
        half = 0.005 * k
        return self.type("geometry_msgs/msg/Pose")(position=t(x=0.5 * k, y=0.0, z=0.0), orientation=q(x=0.0, y=0.0, z=np.sin(half), w=np.cos(half)))

    def odometry(self, k):
        vector = self.type("geometry_msgs/msg/Vector3")
        zero = vector(x=0.0, y=0.0, z=0.0)
        with_covariance = self.type("geometry_msgs/msg/PoseWithCovariance")(pose=self.pose(k), covariance=np.zeros(36))
        twist = self.type("geometry_msgs/msg/TwistWithCovariance")(twist=self.type("geometry_msgs/msg/Twist")(linear=zero, angular=zero), covariance=np.zeros(36))
        return self.type("nav_msgs/msg/Odometry")(header=self.header(k, "odom"), child_frame_id="base_link", pose=with_covariance, twist=twist)

    def pose_stamped(self, k):
        return self.type("geometry_msgs/msg/PoseStamped")(header=self.header(k, "odom"), pose=self.pose(k))

    def path(self, k):
        return self.type("nav_msgs/msg/Path")(header=self.header(k, "odom"), poses=[self.pose_stamped(j) for j in range(int(k) + 1)])

    def transforms(self, k, parent, child, pose):
        vector = self.type("geometry_msgs/msg/Vector3")(x=pose.position.x, y=pose.position.y, z=pose.position.z)
        transform = self.type("geometry_msgs/msg/Transform")(translation=vector, rotation=pose.orientation)
        stamped = self.type("geometry_msgs/msg/TransformStamped")(header=self.header(k, parent), child_frame_id=child, transform=transform)
        return self.type("tf2_msgs/msg/TFMessage")(transforms=[stamped])

    def mounting(self, base="base_link"):
        pose = self.pose(0)
        pose.position.z = 1.5
        return self.transforms(0, base, "lidar", pose)

    def messages(self, clouds="ouster", poses="odometry"):
        """(topic, type, time ns, message); poses come 0.25 s after their time, as SLAM systems publish them."""
        out = [("/tf_static", 99_900_000_000, self.mounting())]
        livox = clouds == "livox"
        for k in range(SCANS):
            s, ns = seconds(k)
            at = s * 1_000_000_000 + ns
            out.append(("/points", at + 100_000_000, self.livox(k) if livox else self.cloud(k, clouds)))
            if poses == "tf":
                out.append(("/tf", at + 250_000_000, self.transforms(k, "odom", "base_link", self.pose(k))))
            else:
                out.append((f"/{poses}", at + 250_000_001, getattr(self, poses)(k)))
        return sorted(out, key=lambda m: m[1])


def two_lidars(drive, poses="odometry", is_beside=True, topic="/rear"):
    """A drive with a second lidar, of another make: in the frame rear, 0.04 s after the first, 2 m behind the lidar and turned by half a turn."""
    out = drive.messages(poses=poses)
    if is_beside:
        pose = drive.pose(0)
        pose.position.x = -2.0
        pose.orientation.z, pose.orientation.w = 1.0, 0.0
        out.append(("/tf_static", 99_900_000_001, drive.transforms(0, "lidar", "rear", pose)))
    for k in range(SCANS - 1):
        s, ns = seconds(k, 0.04)
        out.append((topic, s * 1_000_000_000 + ns + 100_000_000, drive.cloud(k, "velodyne", "rear", 0.04)))
    return sorted(out, key=lambda m: m[1])


def fill(writer, messages, drive, serialize):
    """Writes messages with a writer of rosbags."""
    with writer:
        connections = {}
        for topic, time, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=drive.store)
            writer.write(connections[topic], time, serialize(message, kind))


def bag1(path, messages, drive, compression=None):
    writer = Writer1(path)
    writer.chunk_threshold = 40_000
    if compression:
        writer.set_compression(compression)
    fill(writer, messages, drive, drive.store.serialize_ros1)


def sqlite(path, messages, drive, packed=False):
    try:
        writer = Writer2(path, version=8)
    except TypeError:
        writer = Writer2(path)  # rosbags before 0.10 knows one version
    if packed:
        names = Writer2 if hasattr(Writer2, "CompressionMode") else rosbag2
        writer.set_compression(names.CompressionMode.MESSAGE, names.CompressionFormat.ZSTD)
    fill(writer, messages, drive, drive.store.serialize_cdr)


def mcap(path, messages, drive, compression, chunked=True):
    with open(path, "wb") as file:
        writer = McapWriter(file, compression=compression, use_chunking=chunked, chunk_size=40_000)
        writer.start("ros2", "test")
        channels = {}
        for n, (topic, time, message) in enumerate(messages):
            kind = message.__msgtype__
            if topic not in channels:
                schema = writer.register_schema(kind, "ros2msg", b"")
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], time, bytes(drive.store.serialize_cdr(message, kind)), time, n)
        writer.finish()


def split(folder, messages, drive):
    """A drive in two files of each kind, as `ros2 bag record --max-bag-size` leaves it."""
    half = len(messages) // 2
    for kind in ("db3", "mcap"):
        out = folder / f"split_{kind}"
        out.mkdir()
        for part, some in enumerate((messages[:half], messages[half:])):
            name = out / f"drive_{part}.{kind}"
            if kind == "mcap":
                mcap(name, some, drive, CompressionType.ZSTD)
            else:
                sqlite(out / "part", some, drive)
                (out / "part" / "part.db3").rename(name)
                (out / "part" / "metadata.yaml").rename(out / "metadata.yaml")
                (out / "part").rmdir()


def main():
    folder = Path(sys.argv[1])
    one, two = Drive(ros1=True), Drive(ros1=False)
    for name, compression in (("none", None), ("bz2", Writer1.CompressionFormat.BZ2), ("lz4", Writer1.CompressionFormat.LZ4)):
        bag1(folder / f"ouster_{name}.bag", one.messages(), one, compression)
    for name in ("none", "lz4", "zstd"):
        mcap(folder / f"ouster_{name}.mcap", two.messages(), two, getattr(CompressionType, name.upper()))
    mcap(folder / "ouster_flat.mcap", two.messages(), two, CompressionType.NONE, chunked=False)
    sqlite(folder / "ouster_plain", two.messages(), two)
    sqlite(folder / "ouster_packed", two.messages(), two, packed=True)
    split(folder, two.messages(), two)
    for clouds in ("velodyne", "hesai", "big", "livox"):
        bag1(folder / f"{clouds}_layout.bag", one.messages(clouds), one)
        mcap(folder / f"{clouds}_layout.mcap", two.messages(clouds), two, CompressionType.ZSTD)
    bag1(folder / "two.bag", two_lidars(one), one)
    mcap(folder / "two.mcap", two_lidars(two), two, CompressionType.ZSTD)
    sqlite(folder / "two_tf", two_lidars(two, "tf"), two)
    sqlite(folder / "two_path", two_lidars(two, "path"), two)
    mcap(folder / "two_apart.mcap", two_lidars(two, is_beside=False), two, CompressionType.NONE)
    for poses in ("odometry", "tf"):
        mcap(folder / f"two_on_one_{poses}.mcap", two_lidars(two, poses, topic="/points"), two, CompressionType.ZSTD)
    mcap(folder / "two_on_one_apart.mcap", two_lidars(two, is_beside=False, topic="/points"), two, CompressionType.NONE)
    mcap(folder / "shares.mcap", two.messages("shares"), two, CompressionType.NONE)
    on_a_rack = [(topic, time, two.mounting("rack") if topic == "/tf_static" else message) for topic, time, message in two.messages(poses="tf")]
    mcap(folder / "apart.mcap", on_a_rack, two, CompressionType.NONE)
    for poses in ("pose_stamped", "path", "tf"):
        bag1(folder / f"ouster_{poses}.bag", one.messages(poses=poses), one)
        sqlite(folder / f"ouster_{poses}", two.messages(poses=poses), two)


if __name__ == "__main__" and len(sys.argv) == 2:
    main()
