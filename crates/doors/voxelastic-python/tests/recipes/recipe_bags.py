"""Messages of ROS 1 and ROS 2 as drivers and SLAM systems publish them, and recordings of them, written with rosbags."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from recipe_world import Array, quaternion
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

FORMATS = {"u1": 2, "u2": 4, "u4": 6, "f4": 7, "f8": 8}
"""Numbers of `sensor_msgs/PointField`."""

Fields = Sequence[tuple[str, int, str]]
"""Name, offset and format of each field of a point."""

LIVOX_POINT = "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line\n"
LIVOX_CLOUD = "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\nCustomPoint[] points\n"


def records(fields: Fields, step: int, columns: dict[str, Any]) -> NDArray[np.uint8]:
    """The bytes of N points; fields that are in no column are 0."""
    dtype = np.dtype({"names": [f[0] for f in fields], "formats": ["<" + f[2] for f in fields], "offsets": [f[1] for f in fields], "itemsize": step})
    points = np.zeros(len(columns["x"]), dtype)
    for name in dtype.names or ():
        if name in columns:
            points[name] = columns[name]
    return np.frombuffer(points.tobytes(), np.uint8)


@dataclasses.dataclass
class Bag:
    """Messages with the times at which they were recorded."""

    ros: int
    """1 or 2."""
    livox: str = "livox_ros_driver2"
    """The package of Livox's messages."""

    def __post_init__(self) -> None:
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros == 1 else Stores.ROS2_HUMBLE)
        more = {f"{self.livox}/msg/CustomPoint": LIVOX_POINT, f"{self.livox}/msg/CustomMsg": LIVOX_CLOUD}
        more["tf2_msgs/msg/TFMessage"] = "geometry_msgs/TransformStamped[] transforms\n"
        for name, text in more.items():
            if name not in self.store.types:
                self.store.register(get_types_from_msg(text, name))
        self.messages: list[tuple[str, int, Any]] = []

    def make(self, of: str, /, **values: Any) -> Any:
        """A message of a type, as `nav_msgs/Odometry`."""
        package, _, kind = of.partition("/")
        return self.store.types[f"{package}/msg/{kind}"](**values)

    def add(self, topic: str, seconds: float, message: Any) -> None:
        """Adds a message that was recorded then."""
        self.messages.append((topic, round(seconds * 1e9), message))

    def header(self, seconds: float, frame: str) -> Any:
        nanoseconds = round(seconds * 1e9)
        stamp = self.make("builtin_interfaces/Time", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        return self.make("std_msgs/Header", stamp=stamp, frame_id=frame, **({"seq": 0} if self.ros == 1 else {}))

    def cloud(self, seconds: float, frame: str, fields: Fields, step: int, columns: dict[str, Any], *, rows: int = 1) -> Any:
        """A `PointCloud2`. Points without return are left out, unless the cloud has rows."""
        if rows == 1:
            known = np.isfinite(columns["x"])
            columns = {name: np.asarray(values)[known] for name, values in columns.items()}
        data = records(fields, step, columns)
        described = [self.make("sensor_msgs/PointField", name=name, offset=offset, datatype=FORMATS[kind], count=1) for name, offset, kind in fields]
        width = len(data) // step // rows
        return self.make(
            "sensor_msgs/PointCloud2", header=self.header(seconds, frame), height=rows, width=width, fields=described, is_bigendian=False, point_step=step,
            row_step=step * width, data=data, is_dense=rows == 1,
        )  # fmt: skip

    def livox_cloud(self, seconds: float, frame: str, points: Array, times: Array, lines: NDArray[np.int64]) -> Any:
        known = np.isfinite(points[:, 0])
        each = zip(points[known].astype(np.float32).astype(float).tolist(), np.round(times[known] * 1e9).astype(int).tolist(), lines[known].tolist(), strict=True)
        made = [self.make(f"{self.livox}/CustomPoint", offset_time=t, x=x, y=y, z=z, reflectivity=90, tag=16, line=line) for (x, y, z), t, line in each]
        timebase = round(seconds * 1e9)
        return self.make(
            f"{self.livox}/CustomMsg", header=self.header(seconds, frame), timebase=timebase, point_num=len(made), lidar_id=192, rsvd=np.zeros(3, np.uint8), points=made
        )

    def vector(self, values: Sequence[float] | Array, kind: str = "Vector3") -> Any:
        x, y, z = map(float, values)
        return self.make(f"geometry_msgs/{kind}", x=x, y=y, z=z)

    def rotation(self, pose: Array) -> Any:
        x, y, z, w = map(float, quaternion(pose[:3, :3]))
        return self.make("geometry_msgs/Quaternion", x=x, y=y, z=z, w=w)

    def pose(self, pose: Array) -> Any:
        return self.make("geometry_msgs/Pose", position=self.vector(pose[:3, 3], "Point"), orientation=self.rotation(pose))

    def odometry(self, seconds: float, frame: str, child: str, pose: Array) -> Any:
        twist = self.make("geometry_msgs/Twist", linear=self.vector([0, 0, 0]), angular=self.vector([0, 0, 0]))
        return self.make(
            "nav_msgs/Odometry", header=self.header(seconds, frame), child_frame_id=child,
            pose=self.make("geometry_msgs/PoseWithCovariance", pose=self.pose(pose), covariance=np.zeros(36)),
            twist=self.make("geometry_msgs/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )  # fmt: skip

    def path(self, frame: str, poses: Sequence[tuple[float, Array]]) -> Any:
        stamped = [self.make("geometry_msgs/PoseStamped", header=self.header(seconds, frame), pose=self.pose(pose)) for seconds, pose in poses]
        return self.make("nav_msgs/Path", header=self.header(poses[-1][0], frame), poses=stamped)

    def transform(self, seconds: float, parent: str, child: str, pose: Array) -> Any:
        moved = self.make("geometry_msgs/Transform", translation=self.vector(pose[:3, 3]), rotation=self.rotation(pose))
        return self.make("tf2_msgs/TFMessage", transforms=[self.make("geometry_msgs/TransformStamped", header=self.header(seconds, parent), child_frame_id=child, transform=moved)])

    def imu(self, seconds: float, frame: str, angular_velocity: Array, acceleration: Array) -> Any:
        unknown = np.zeros(9)
        return self.make(
            "sensor_msgs/Imu", header=self.header(seconds, frame), orientation=self.rotation(np.eye(4)), orientation_covariance=unknown,
            angular_velocity=self.vector(angular_velocity), angular_velocity_covariance=unknown, linear_acceleration=self.vector(acceleration),
            linear_acceleration_covariance=unknown,
        )  # fmt: skip

    def save(self, path: Path) -> Path:
        """Writes a `.bag`, or the folder of a ROS 2 bag: MCAP if its name ends with that, else sqlite3."""
        kind = StoragePlugin.MCAP if path.name.endswith("mcap") else StoragePlugin.SQLITE3
        writer: Any = Writer1(path) if self.ros == 1 else Writer2(path, version=9, storage_plugin=kind)
        serialize = self.store.serialize_ros1 if self.ros == 1 else self.store.serialize_cdr
        with writer:
            connections: dict[str, Any] = {}
            for topic, time, message in sorted(self.messages, key=lambda entry: entry[1]):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=self.store)
                writer.write(connections[topic], time, serialize(message, message.__msgtype__))
        return path
