"""Messages of ROS 2 as Cyclone DDS wants them."""
from dataclasses import dataclass
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, float64, int8, int32, int64, sequence, uint8, uint32, uint64


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
class ColorRGBA(IdlStruct, **message("std_msgs", "ColorRGBA")):
    r: float32
    g: float32
    b: float32
    a: float32


@dataclass
class CompressedImage(IdlStruct, **message("sensor_msgs", "CompressedImage")):
    header: Header
    format: str
    data: sequence[uint8]


@dataclass
class UVCoordinate(IdlStruct, **message("visualization_msgs", "UVCoordinate")):
    u: float32
    v: float32


@dataclass
class MeshFile(IdlStruct, **message("visualization_msgs", "MeshFile")):
    filename: str
    data: sequence[uint8]


@dataclass
class Marker(IdlStruct, **message("visualization_msgs", "Marker")):
    header: Header
    ns: str
    id: int32
    type: int32
    action: int32
    pose: Pose
    scale: Vector
    color: ColorRGBA
    lifetime: Time
    frame_locked: bool
    points: sequence[Vector]
    colors: sequence[ColorRGBA]
    texture_resource: str
    texture: CompressedImage
    uv_coordinates: sequence[UVCoordinate]
    text: str
    mesh_resource: str
    mesh_file: MeshFile
    mesh_use_embedded_materials: bool


@dataclass
class MarkerArray(IdlStruct, **message("visualization_msgs", "MarkerArray")):
    markers: sequence[Marker]


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


@dataclass
class OccupancyGridUpdate(IdlStruct, **message("map_msgs", "OccupancyGridUpdate")):
    header: Header
    x: int32
    y: int32
    width: uint32
    height: uint32
    data: sequence[int8]


@dataclass
class PoseWithCovarianceStamped(IdlStruct, **message("geometry_msgs", "PoseWithCovarianceStamped")):
    header: Header
    pose: PoseWithCovariance


@dataclass
class KeyValue(IdlStruct, **message("diagnostic_msgs", "KeyValue")):
    key: str
    value: str


@dataclass
class Status(IdlStruct, **message("diagnostic_msgs", "DiagnosticStatus")):
    level: uint8
    name: str
    message: str
    hardware_id: str
    values: sequence[KeyValue]


@dataclass
class Diagnostics(IdlStruct, **message("diagnostic_msgs", "DiagnosticArray")):
    header: Header
    status: sequence[Status]


def service(package, name):
    return {"typename": f"{package}::srv::dds_::{name}_"}


# Services as rmw_cyclonedds has them: who asks and the number of the question come first.
@dataclass
class TriggerRequest(IdlStruct, **service("std_srvs", "Trigger_Request")):
    client: uint64
    number: int64
    nothing: uint8


@dataclass
class TriggerResponse(IdlStruct, **service("std_srvs", "Trigger_Response")):
    client: uint64
    number: int64
    success: bool
    message: str


@dataclass
class SetBoolRequest(IdlStruct, **service("std_srvs", "SetBool_Request")):
    client: uint64
    number: int64
    data: bool


@dataclass
class SetBoolResponse(IdlStruct, **service("std_srvs", "SetBool_Response")):
    client: uint64
    number: int64
    success: bool
    message: str


@dataclass
class LoadMapRequest(IdlStruct, **service("nav_msgs", "LoadMap_Request")):
    client: uint64
    number: int64
    map_url: str


@dataclass
class LoadMapResponse(IdlStruct, **service("nav_msgs", "LoadMap_Response")):
    client: uint64
    number: int64
    map: OccupancyGrid
    result: uint8


@dataclass
class GetDistancesRequest(IdlStruct, **service("voxelastic_msgs", "GetDistances_Request")):
    client: uint64
    number: int64
    points: sequence[Vector]


@dataclass
class GetDistancesResponse(IdlStruct, **service("voxelastic_msgs", "GetDistances_Response")):
    client: uint64
    number: int64
    success: bool
    message: str
    known: sequence[bool]
    distances: sequence[float64]
    gradients: sequence[Vector]


@dataclass
class ParameterValue(IdlStruct, **message("rcl_interfaces", "ParameterValue")):
    type: uint8
    bool_value: bool
    integer_value: int64
    double_value: float64
    string_value: str
    byte_array_value: sequence[uint8]
    bool_array_value: sequence[bool]
    integer_array_value: sequence[int64]
    double_array_value: sequence[float64]
    string_array_value: sequence[str]


@dataclass
class GetParametersRequest(IdlStruct, **service("rcl_interfaces", "GetParameters_Request")):
    client: uint64
    number: int64
    names: sequence[str]


@dataclass
class GetParametersResponse(IdlStruct, **service("rcl_interfaces", "GetParameters_Response")):
    client: uint64
    number: int64
    values: sequence[ParameterValue]
