"""A program that speaks ROS 2 over Zenoh: `zenoh_peer.py give|take LOCATOR FOLDER`, as dds_peer.py. It connects to LOCATOR, and reads messages by rosbags.
`zenoh_peer.py route LOCATOR FOLDER` is the router at LOCATOR."""
import json
import sys
import time
from pathlib import Path as File

import numpy
import zenoh
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

store = get_typestore(Stores.ROS2_JAZZY)
store.register(get_types_from_msg("std_msgs/Header header\nbool binary\nstring id\nfloat64 resolution\nint8[] data\n", "octomap_msgs/msg/Octomap"))
T = store.types


def key(name, kind):
    package, _, base = kind.split("/")
    return f"0/{name}/{package}::msg::dds_::{base}_/{store.hash_rihs01(kind)}"


def header(stamp, frame):
    return T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](int(stamp), int(round(stamp % 1 * 1e9))), frame)


def pose(x):
    vector = T["geometry_msgs/msg/Point"](x, 0.0, 0.0)
    return T["geometry_msgs/msg/Pose"](vector, T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0))


def attachment(sequence):
    return sequence.to_bytes(8, "little") + time.time_ns().to_bytes(8, "little") + bytes([16]) + bytes(16)


def announce(session, number, role, name, kind):
    package, _, base = kind.split("/")
    token = f"@ros2_lv/0/{session.zid()}/0/{number}/{role}/%/%/peer/%{name.replace('/', '%')}/{package}::msg::dds_::{base}_/{store.hash_rihs01(kind)}/::,10:,:,:,,"
    return session.liveliness().declare_token(token)


def service_types():
    """The services that are called, by their whole keys, and what is asked."""
    define = lambda text, name: store.register({name: next(iter(get_types_from_msg(text, name).values()))})
    parameter = "rcl_interfaces/srv/"
    for name, request, response in [
        ("nav_msgs/srv/LoadMap", "string map_url\n", "nav_msgs/OccupancyGrid map\nuint8 result\n"),
        ("voxelastic_msgs/srv/GetDistances", "geometry_msgs/Point[] points\n", "bool success\nstring message\nbool[] known\nfloat64[] distances\ngeometry_msgs/Vector3[] gradients\n"),
        ("std_srvs/srv/SetBool", "bool data\n", "bool success\nstring message\n"),
        ("std_srvs/srv/Trigger", "uint8 structure_needs_at_least_one_member\n", "bool success\nstring message\n"),
        (parameter + "ListParameters", "string[] prefixes\nuint64 depth\n", "rcl_interfaces/ListParametersResult result\n"),
        (parameter + "GetParameters", "string[] names\n", "rcl_interfaces/ParameterValue[] values\n"),
        (parameter + "DescribeParameters", "string[] names\n", "rcl_interfaces/ParameterDescriptor[] descriptors\n"),
        (parameter + "SetParameters", "rcl_interfaces/Parameter[] parameters\n", "rcl_interfaces/SetParametersResult[] results\n"),
    ]:
        define(request, name + "_Request")
        define(response, name + "_Response")
    of = lambda kind: T[kind + "_Request"]
    value = T["rcl_interfaces/msg/ParameterValue"](2, False, 4, 0.0, "", *[numpy.zeros(0, k) for k in ("u1", "?", "i8", "f8")], [])
    points = [T["geometry_msgs/msg/Point"](1.0, 2.0, 3.0), T["geometry_msgs/msg/Point"](500.0, 0.0, 0.0)]
    load, distances = "nav_msgs/srv/LoadMap", "voxelastic_msgs/srv/GetDistances"
    return {
        "load": (load, of(load)("file:///maps/a.vox")),
        "distances": (distances, of(distances)(points)),
        "explore": ("std_srvs/srv/SetBool", of("std_srvs/srv/SetBool")(True)),
        "return_home": ("std_srvs/srv/Trigger", of("std_srvs/srv/Trigger")(0)),
        "list_parameters": (parameter + "ListParameters", of(parameter + "ListParameters")([], 0)),
        "get_parameters": (parameter + "GetParameters", of(parameter + "GetParameters")(["voxel_size", "field", "nothing"])),
        "describe_parameters": (parameter + "DescribeParameters", of(parameter + "DescribeParameters")(["voxel_size"])),
        "set_parameters": (parameter + "SetParameters", of(parameter + "SetParameters")([T["rcl_interfaces/msg/Parameter"]("voxel_size", value)])),
    }


def service_key(name, kind):
    hashes = {
        "LoadMap": "1a192ac56c40fed2767dac26f0b371785372276bd465c902676d2dca135aae5a",
        "GetDistances": "ef40534d30cf0c442ea35e62a106215ff9e5b2932b29fe4a3e742b7c313a0224",
        "SetBool": "abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a",
        "Trigger": "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
        "ListParameters": "3e6062bfbb27bfb8730d4cef2558221f51a11646d78e7bb30a1e83afac3aad9d",
        "GetParameters": "bf9803d5c74cf989a5de3e0c2e99444599a627c7ff75f97b8c05b01003675cbc",
        "DescribeParameters": "845b484d71eb0673dae682f2e3ba3c4851a65a3dcfb97bddd82c5b57e91e4cff",
        "SetParameters": "56eed9a67e169f9cb6c1f987bc88f868c14a8fc9f743a263bc734c154015d7e0",
    }
    package, _, base = kind.split("/")
    return f"0/voxelastic/{name}/{package}::srv::dds_::{base}_/RIHS01_{hashes[base]}"


def read_answers(answers):
    distances, described = answers["distances"], answers["describe_parameters"].descriptors[0]
    return {
        "load": int(answers["load"].result),
        "explore": [bool(answers["explore"].success), answers["explore"].message],
        "return_home": [bool(answers["return_home"].success), answers["return_home"].message],
        "distances": [
            [bool(k) for k in distances.known],
            [float(d) if d == d else None for d in distances.distances],
            [[g.x, g.y, g.z] for g in distances.gradients],
        ],
        "parameters": [[int(v.type), v.double_value, v.string_value] for v in answers["get_parameters"].values],
        "names": list(answers["list_parameters"].result.names),
        "described": [described.name, int(described.type), bool(described.read_only)],
        "set": [[bool(r.successful), r.reason] for r in answers["set_parameters"].results],
    }


def give(session, folder):
    topics = {"points": "sensor_msgs/msg/PointCloud2", "odom": "nav_msgs/msg/Odometry", "tf_static": "tf2_msgs/msg/TFMessage"}
    tokens = [announce(session, k, "MP", name, kind) for k, (name, kind) in enumerate(topics.items())]
    plain = {name: session.declare_publisher(key(name, kind)) for name, kind in topics.items() if name != "tf_static"}
    # As rmw_zenoh does for transient-local topics: kept for those who come late.
    latched = zenoh.ext.declare_advanced_publisher(
        session, key("tf_static", topics["tf_static"]), cache=zenoh.ext.CacheConfig(max_samples=1), publisher_detection=True
    )
    send = lambda publisher, message, kind, k: publisher.put(bytes(store.serialize_cdr(message, kind)), attachment=attachment(k))
    link = T["geometry_msgs/msg/TransformStamped"](
        header(0, "base"), "lidar", T["geometry_msgs/msg/Transform"](T["geometry_msgs/msg/Vector3"](0.5, 0.0, 0.0), pose(0).orientation)
    )
    send(latched, T["tf2_msgs/msg/TFMessage"]([link]), topics["tf_static"], 1)
    fields = [T["sensor_msgs/msg/PointField"](name, 4 * k, 7, 1) for k, name in enumerate("xyz")]
    zero = T["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    twist = T["geometry_msgs/msg/TwistWithCovariance"](T["geometry_msgs/msg/Twist"](zero, zero), numpy.zeros(36))
    scans = [File(name).read_bytes() for name in sorted(map(str, folder.glob("scan-*.f32")))]
    k = 0
    while not (folder / "done").exists():
        stamp, data = 1000.0 + 0.1 * k, numpy.frombuffer(scans[k % len(scans)], numpy.uint8)
        place = T["geometry_msgs/msg/PoseWithCovariance"](pose(0.25 * k), numpy.zeros(36))
        send(plain["odom"], T["nav_msgs/msg/Odometry"](header(stamp, "odom"), "base", place, twist), topics["odom"], k)
        cloud = T["sensor_msgs/msg/PointCloud2"](header(stamp, "lidar"), 1, len(data) // 12, fields, False, 12, len(data), data, True)
        send(plain["points"], cloud, topics["points"], k)
        k += 1
        time.sleep(0.1)
    del tokens


def take(session, folder):
    own = "voxelastic/"
    topics = {
        own + "surface_points": "sensor_msgs/msg/PointCloud2",
        own + "surface": "visualization_msgs/msg/MarkerArray",
        own + "path": "nav_msgs/msg/Path",
        own + "submaps": "geometry_msgs/msg/PoseArray",
        own + "octomap": "octomap_msgs/msg/Octomap",
        own + "grid": "nav_msgs/msg/OccupancyGrid",
        own + "frontier": "visualization_msgs/msg/MarkerArray",
        own + "explore_path": "nav_msgs/msg/Path",
        own + "explore_goal": "geometry_msgs/msg/PoseStamped",
        "tf": "tf2_msgs/msg/TFMessage",
        "diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    }
    taken, quiet, held = {name: [] for name in topics}, [time.monotonic()], []
    for k, (name, kind) in enumerate(topics.items()):

        def handle(sample, name=name, kind=kind):
            taken[name].append(store.deserialize_cdr(bytes(sample.payload), kind))
            if name.endswith("surface_points"):
                quiet[0] = time.monotonic()

        # By the whole key, as rmw_zenoh subscribes: the hash of the type must be right.
        history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
        held.append(zenoh.ext.declare_advanced_subscriber(session, key(name, kind), handle, history=history))
        held.append(announce(session, k, "MS", name, kind))
    begin, is_late = time.monotonic(), False
    while not all(taken.values()) or time.monotonic() - quiet[0] < 1.5:
        time.sleep(0.02)
        if not is_late and time.monotonic() - begin > 60:
            is_late = True
            print("nothing came of", [name for name, messages in taken.items() if not messages], file=sys.stderr)
    last = {name.removeprefix(own): messages[-1] for name, messages in taken.items()}
    trigger = "0/voxelastic/save/std_srvs::srv::dds_::Trigger_/RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
    parts = service_types()
    answers = {}
    for name, (kind, request) in parts.items():
        payload = store.serialize_cdr(request, kind + "_Request") if request is not None else bytes([0, 1, 0, 0, 0])
        replied = session.get(service_key(name, kind), payload=bytes(payload), attachment=attachment(8), timeout=20)
        answers[name] = [store.deserialize_cdr(bytes(reply.ok.payload), kind + "_Response") for reply in replied][0]
    replies = [bytes(reply.ok.payload) for reply in session.get(trigger, payload=bytes([0, 1, 0, 0, 0]), attachment=attachment(7), timeout=20)]
    (folder / "points").write_bytes(b"".join(bytes(m.data) for m in taken[own + "surface_points"]))
    (folder / "octomap").write_bytes(bytes(int(b) & 255 for b in last["octomap"].data))
    grid, link = last["grid"], last["tf"].transforms[0]
    corners = [(p.x, p.y, p.z) for m in taken[own + "surface"] for marker in m.markers for p in marker.points]
    place = lambda stamped: [stamped.pose.position.x, stamped.pose.position.y, stamped.pose.position.z]
    cubes = [m for m in last["frontier"].markers if (m.type, m.action) == (1, 0)]
    summary = {
        "explore_path": [place(p) for p in last["explore_path"].poses],
        "explore_goal": place(last["explore_goal"]),
        "frontier": [place(m) + [m.scale.x, m.scale.y, m.scale.z] for m in cubes],
        "point_step": last["surface_points"].point_step,
        "path": [[p.pose.position.x, p.pose.position.y, p.pose.position.z] for p in last["path"].poses],
        "stamps": [p.header.stamp.sec + 1e-9 * p.header.stamp.nanosec for p in last["path"].poses],
        "submaps": len(last["submaps"].poses),
        "resolution": last["octomap"].resolution,
        "grid": [grid.info.width, grid.info.height, len(grid.data), int((grid.data == 0).sum()), int((grid.data == 100).sum())],
        "tf": [link.header.frame_id, link.child_frame_id, link.transform.translation.x],
        "corners": len(corners),
        "diagnostics": {v.key: v.value for v in last["diagnostics"].status[0].values},
        "services": read_answers(answers),
        "saved": [bool(replies[0][4]), replies[0][12:-1].decode()] if replies else None,
    }
    (folder / "taken.tmp").write_text(json.dumps(summary))
    (folder / "taken.tmp").rename(folder / "taken.json")


def route(session, folder):
    while not (folder / "done").exists():
        time.sleep(0.1)


mode, locator, folder = sys.argv[1], sys.argv[2], File(sys.argv[3])
is_router = mode == "route"
config = zenoh.Config()
for name, value in [("mode", '"router"' if is_router else '"peer"'), ("scouting/multicast/enabled", "false"), ("timestamping/enabled", "true")]:
    config.insert_json5(name, value)
config.insert_json5("listen/endpoints", json.dumps([locator if is_router else "tcp/127.0.0.1:0"]))
config.insert_json5("connect/endpoints", json.dumps([] if is_router else [locator]))
with zenoh.open(config) as session:
    {"give": give, "take": take, "route": route}[mode](session, folder)
