"""Writes recordings with fixes by rosbags: fixes.bag (ROS 1), fixes.mcap and gps.mcap (ROS 2), sentences.mcap."""
import sys
from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

folder = Path(sys.argv[1])
GPS_STATUS = """std_msgs/Header header
uint16 satellites_used
int32[] satellite_used_prn
uint16 satellites_visible
int32[] satellite_visible_prn
int32[] satellite_visible_z
int32[] satellite_visible_azimuth
int32[] satellite_visible_snr
int16 status
uint16 motion_source
uint16 orientation_source
uint16 position_source
"""
GPS_FIX = "std_msgs/Header header\ngps_common/GPSStatus status\n" + "".join(
    f"float64 {name}\n"
    for name in "latitude longitude altitude track speed climb pitch roll dip time gdop pdop hdop vdop tdop err err_horz err_vert err_track err_speed err_climb "
    "err_time err_pitch err_roll err_dip".split()
) + "float64[9] position_covariance\nuint8 position_covariance_type\n"
SENTENCE = "std_msgs/Header header\nstring sentence\n"


def header(store, is_ros1, k):
    stamp = store.types["builtin_interfaces/msg/Time"](sec=1000 + k, nanosec=250_000_000)
    Header = store.types["std_msgs/msg/Header"]
    return Header(seq=k, stamp=stamp, frame_id="gps") if is_ros1 else Header(stamp=stamp, frame_id="gps")


def nav_sat_fix(store, is_ros1, k):
    Status, Fix = store.types["sensor_msgs/msg/NavSatStatus"], store.types["sensor_msgs/msg/NavSatFix"]
    status = Status(status=-1 if k == 2 else 2, service=1)
    covariance = np.array([0.01, 0.001, 0, 0.001, 0.04, 0, 0, 0, 0.09])
    return Fix(header=header(store, is_ros1, k), status=status, latitude=48.1 + 1e-5 * k, longitude=11.5, altitude=520.0 + k, position_covariance=covariance, position_covariance_type=2)


def odometry(store, is_ros1, k):
    t = store.types
    pose = t["geometry_msgs/msg/Pose"](position=t["geometry_msgs/msg/Point"](x=691650.0 + k, y=5334754.0, z=519.0), orientation=t["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0))
    zero = t["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    twist = t["geometry_msgs/msg/TwistWithCovariance"](twist=t["geometry_msgs/msg/Twist"](linear=zero, angular=zero), covariance=np.zeros(36))
    covariance = np.zeros(36)
    covariance[[0, 7, 14]] = [0.01, 0.04, 0.09]
    pose = t["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=covariance)
    return t["nav_msgs/msg/Odometry"](header=header(store, is_ros1, k), child_frame_id="base", pose=pose, twist=twist)


def gps_fix(store, is_ros1, k):
    none = np.zeros(0, dtype=np.int32)
    seen = np.arange(5, dtype=np.int32)
    status = store.types["gps_common/msg/GPSStatus"](
        header=header(store, is_ros1, k), satellites_used=5, satellite_used_prn=seen, satellites_visible=0, satellite_visible_prn=none, satellite_visible_z=none,
        satellite_visible_azimuth=none, satellite_visible_snr=none, status=0, motion_source=1, orientation_source=1, position_source=1,
    )
    numbers = {name: 0.0 for name in "track speed climb pitch roll dip time gdop pdop hdop vdop tdop err err_track err_speed err_climb err_time err_pitch err_roll err_dip".split()}
    return store.types["gps_common/msg/GPSFix"](
        header=header(store, is_ros1, k), status=status, latitude=48.1 + 1e-5 * k, longitude=11.5, altitude=520.0 + k, err_horz=2.45, err_vert=3.92,
        position_covariance=np.zeros(9), position_covariance_type=0, **numbers,
    )


def sentence(store, is_ros1, k):
    body = f"GPGGA,1200{k:02d}.00,4806.00000,N,01130.00000,E,4,12,0.7,474.0,M,46.0,M,,"
    total = 0
    for byte in body.encode():
        total ^= byte
    return store.types["nmea_msgs/msg/Sentence"](header=header(store, is_ros1, k), sentence=f"${body}*{total:02X}\r\n")


def write(path, is_ros1, topics):
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    for text, name in [(GPS_STATUS, "gps_common/msg/GPSStatus"), (GPS_FIX, "gps_common/msg/GPSFix"), (SENTENCE, "nmea_msgs/msg/Sentence")]:
        store.register(get_types_from_msg(text, name))
    writer = Writer1(path) if is_ros1 else Writer2(path, version=8, storage_plugin=StoragePlugin.MCAP)
    with writer:
        for topic, kind, make in topics:
            connection = writer.add_connection(topic, kind, typestore=store)
            for k in range(4):
                data = store.serialize_ros1(make(store, is_ros1, k), kind) if is_ros1 else store.serialize_cdr(make(store, is_ros1, k), kind)
                writer.write(connection, (1000 + k) * 10**9 + 300_000_000, data)


fix = ("/fix", "sensor_msgs/msg/NavSatFix", nav_sat_fix)
write(folder / "fixes.bag", True, [fix, ("/utm", "nav_msgs/msg/Odometry", odometry)])
write(folder / "fixes", False, [fix, ("/utm", "nav_msgs/msg/Odometry", odometry)])
write(folder / "gps", False, [("/gps", "gps_common/msg/GPSFix", gps_fix)])
write(folder / "sentences", False, [("/nmea", "nmea_msgs/msg/Sentence", sentence)])
write(folder / "two", False, [fix, ("/fix_2", "sensor_msgs/msg/NavSatFix", nav_sat_fix)])
