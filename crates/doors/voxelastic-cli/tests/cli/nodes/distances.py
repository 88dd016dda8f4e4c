"""Asks `voxelastic live` for distances: `distances.py PORT HEALTH SCANS FOLDER`, over Zenoh as rmw_zenoh calls a service; messages by rosbags.

It listens at PORT, waits until the node whose health is at the URL HEALTH has mapped SCANS scans, and asks about the points of FOLDER/points.f64. What the node
answers is in FOLDER/answer.json then, with the slice of distances that it publishes about the last of these scans, which is 0.1 s after the one before.
"""
import json
import math
import sys
import time
import urllib.request
from pathlib import Path

import numpy
import zenoh
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

KIND = "voxelastic_msgs/srv/GetDistances"
KEY = "0/voxelastic/distances/voxelastic_msgs::srv::dds_::GetDistances_/RIHS01_ef40534d30cf0c442ea35e62a106215ff9e5b2932b29fe4a3e742b7c313a0224"

port, health, scans, folder = sys.argv[1], sys.argv[2], int(sys.argv[3]), Path(sys.argv[4])
store = get_typestore(Stores.ROS2_JAZZY)
# The definition itself, in its two parts.
parts = (Path(__file__).parents[4] / "voxelastic-live/ros/voxelastic_msgs/srv/GetDistances.srv").read_text().split("---\n")
for part, name in zip(parts, (KIND + "_Request", KIND + "_Response")):
    store.register({name: next(iter(get_types_from_msg(part, name).values()))})
config = zenoh.Config()
for name, value in [("mode", '"peer"'), ("scouting/multicast/enabled", "false"), ("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')]:
    config.insert_json5(name, value)


def mapped():
    try:
        return json.load(urllib.request.urlopen(health, timeout=10)).get("scans", 0)
    except OSError:
        return 0


slices = {}


def take(sample):
    cloud = store.deserialize_cdr(bytes(sample.payload), "sensor_msgs/msg/PointCloud2")
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "intensity"] and cloud.point_step == 16 and cloud.header.frame_id == "map"
    slices[round(cloud.header.stamp.sec + 1e-9 * cloud.header.stamp.nanosec, 3)] = cloud.data.view("<f4").reshape(-1, 4).tolist()


with zenoh.open(config) as session:
    held = session.declare_subscriber("0/voxelastic/distance_slice/**", take)
    while mapped() < scans:
        time.sleep(0.05)
    points = [store.types["geometry_msgs/msg/Point"](*p) for p in numpy.fromfile(folder / "points.f64").reshape(-1, 3).tolist()]
    request = bytes(store.serialize_cdr(store.types[KIND + "_Request"](points), KIND + "_Request"))
    attachment = (1).to_bytes(8, "little") + time.time_ns().to_bytes(8, "little") + bytes([16]) + bytes(16)
    replies = []
    while not replies:
        replies = [reply.ok for reply in session.get(KEY, payload=request, attachment=attachment, timeout=60) if reply.ok]
    answer = store.deserialize_cdr(bytes(replies[0].payload), KIND + "_Response")
    said = {
        "success": bool(answer.success),
        "known": [bool(known) for known in answer.known],
        "distances": [None if math.isnan(d) else float(d) for d in answer.distances],
        "gradients": [[g.x, g.y, g.z] for g in answer.gradients],
    }
    begin = time.monotonic()
    while (last := round(0.1 * (scans - 1), 3)) not in slices:
        assert time.monotonic() - begin < 60, f"no slice of {last}, but of {sorted(slices)}"
        time.sleep(0.05)
    said["slice"] = slices[last]
    (folder / "answer.json").write_text(json.dumps(said))
