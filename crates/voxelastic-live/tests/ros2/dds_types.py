"""Messages of ROS 2 as Cyclone DDS wants them."""
from dataclasses import dataclass
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, float64, int8, int32, sequence, uint8, uint32


def message(package, name):
    return {"typename": f"{package}::msg::dds_::{name}_"}


@dataclass
class Time(IdlStruct, **message("builtin_interfaces", "Time")):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, **message("std_msgs", "Header")):
    stamp: Time
    frame_id: str


@dataclass
class PointField(IdlStruct, **message("sensor_msgs", "PointField")):
    name: str
    offset: uint32
    datatype: uint8
    count: uint32


@dataclass
class PointCloud2(IdlStruct, **message("sensor_msgs", "PointCloud2")):
    header: Header
    height: uint32
    width: uint32
    fields: sequence[PointField]
    is_bigendian: bool
    point_step: uint32
    row_step: uint32
    data: sequence[uint8]
    is_dense: bool


@dataclass
class Vector(IdlStruct, **message("geometry_msgs", "Vector3")):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, **message("geometry_msgs", "Quaternion")):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, **message("geometry_msgs", "Pose")):
    position: Vector
    orientation: Quaternion


@dataclass
class PoseStamped(IdlStruct, **message("geometry_msgs", "PoseStamped")):
    header: Header
    pose: Pose


@dataclass
class Path(IdlStruct, **message("nav_msgs", "Path")):
    header: Header
    poses: sequence[PoseStamped]


@dataclass
class PoseArray(IdlStruct, **message("geometry_msgs", "PoseArray")):
    header: Header
    poses: sequence[Pose]


@dataclass
class TransformStamped(IdlStruct, **message("geometry_msgs", "TransformStamped")):
    header: Header
    child_frame_id: str
    transform: Pose


@dataclass
class TFMessage(IdlStruct, **message("tf2_msgs", "TFMessage")):
    transforms: sequence[TransformStamped]


@dataclass
class PoseWithCovariance(IdlStruct, **message("geometry_msgs", "PoseWithCovariance")):
    pose: Pose
    covariance: array[float64, 36]


@dataclass
class TwistWithCovariance(IdlStruct, **message("geometry_msgs", "TwistWithCovariance")):
    linear: Vector
    angular: Vector
    covariance: array[float64, 36]


@dataclass
class Odometry(IdlStruct, **message("nav_msgs", "Odometry")):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass
class Octomap(IdlStruct, **message("octomap_msgs", "Octomap")):
    header: Header
    binary: bool
    id: str
    resolution: float64
    data: sequence[int8]


@dataclass
class MapMetaData(IdlStruct, **message("nav_msgs", "MapMetaData")):
    map_load_time: Time
    resolution: float32
    width: uint32
    height: uint32
    origin: Pose


@dataclass
class OccupancyGrid(IdlStruct, **message("nav_msgs", "OccupancyGrid")):
    header: Header
    info: MapMetaData
    data: sequence[int8]
