"""A node of ROS 2 by Cyclone DDS: `dds_peer.py give|take|ask DOMAIN FOLDER`.

give  publishes the scans FOLDER/scan-*.f32 (x y z) as /points, with /odom and /tf_static, until the file FOLDER/done is there
take  subscribes to what the node /voxelastic publishes, and writes what it gets to FOLDER/taken.json, once it has some of each topic
ask   calls the services of the node /voxelastic, as rmw_cyclonedds does, and writes the answers to FOLDER/answers.json
"""
import json
import sys
import time
from pathlib import Path as File

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

import dds_types as t

RELIABLE = Policy.Reliability.Reliable(duration(seconds=1))
LATCHED = Qos(RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
SENSOR_DATA = Qos(Policy.Reliability.BestEffort, Policy.Durability.Volatile, Policy.History.KeepLast(5))
USUAL = Qos(RELIABLE, Policy.Durability.Volatile, Policy.History.KeepLast(100))


def header(stamp, frame):
    return t.Header(t.Time(int(stamp), int(round(stamp % 1 * 1e9))), frame)


def pose(x):
    return t.Pose(t.Vector(x, 0.0, 0.0), t.Quaternion(0.0, 0.0, 0.0, 1.0))


def give(participant, folder):
    writer = lambda name, kind, qos: DataWriter(participant, Topic(participant, name, kind), qos=qos)
    points = writer("rt/points", t.PointCloud2, SENSOR_DATA)
    odometry = writer("rt/odom", t.Odometry, USUAL)
    mounting = writer("rt/tf_static", t.TFMessage, LATCHED)
    # Long before anybody listens.
    mounting.write(t.TFMessage([t.TransformStamped(header(0, "base"), "lidar", pose(0.5))]))
    fields = [t.PointField(name, 4 * k, 7, 1) for k, name in enumerate("xyz")]
    nothing = t.Vector(0.0, 0.0, 0.0)
    scans = [File(name).read_bytes() for name in sorted(map(str, folder.glob("scan-*.f32")))]
    begin, k = 1000.0, 0
    while not (folder / "done").exists():
        stamp = begin + 0.1 * k
        data = scans[k % len(scans)]
        place = t.PoseWithCovariance(pose(0.25 * k), [0.0] * 36)
        odometry.write(t.Odometry(header(stamp, "odom"), "base", place, t.TwistWithCovariance(nothing, nothing, [0.0] * 36)))
        points.write(t.PointCloud2(header(stamp, "lidar"), 1, len(data) // 12, fields, False, 12, len(data), data, True))
        k += 1
        time.sleep(0.1)


def take(participant, folder):
    reader = lambda name, kind, qos: DataReader(participant, Topic(participant, "rt/" + name, kind), qos=qos)
    readers = {
        "surface_points": reader("voxelastic/surface_points", t.PointCloud2, USUAL),
        "path": reader("voxelastic/path", t.Path, LATCHED),
        "submaps": reader("voxelastic/submaps", t.PoseArray, LATCHED),
        "octomap": reader("voxelastic/octomap", t.Octomap, LATCHED),
        "grid": reader("voxelastic/grid", t.OccupancyGrid, LATCHED),
        "frontier": reader("voxelastic/frontier", t.MarkerArray, LATCHED),
        "explore_path": reader("voxelastic/explore_path", t.Path, LATCHED),
        "explore_goal": reader("voxelastic/explore_goal", t.PoseStamped, LATCHED),
        "tf": reader("tf", t.TFMessage, USUAL),
    }
    taken = {name: [] for name in readers}
    quiet = time.monotonic()
    while not all(taken.values()) or time.monotonic() - quiet < 1.5:
        for name, reader in readers.items():
            for message in reader.take(N=50):
                taken[name].append(message)
                if name == "surface_points":
                    quiet = time.monotonic()
        time.sleep(0.02)
    grid, octomap, transform = taken["grid"][-1], taken["octomap"][-1], taken["tf"][-1].transforms[0]
    (folder / "points").write_bytes(b"".join(bytes(m.data) for m in taken["surface_points"]))
    (folder / "octomap").write_bytes(bytes(b & 255 for b in octomap.data))
    place = lambda stamped: [stamped.pose.position.x, stamped.pose.position.y, stamped.pose.position.z]
    cubes = [m for m in taken["frontier"][-1].markers if (m.type, m.action) == (1, 0)]
    summary = {
        "explore_path": [place(p) for p in taken["explore_path"][-1].poses],
        "explore_goal": place(taken["explore_goal"][-1]),
        "frontier": [place(m) + [m.scale.x, m.scale.y, m.scale.z] for m in cubes],
        "point_step": taken["surface_points"][-1].point_step,
        "path": [[p.pose.position.x, p.pose.position.y, p.pose.position.z] for p in taken["path"][-1].poses],
        "stamps": [p.header.stamp.sec + 1e-9 * p.header.stamp.nanosec for p in taken["path"][-1].poses],
        "submaps": len(taken["submaps"][-1].poses),
        "resolution": octomap.resolution,
        "grid": [grid.info.width, grid.info.height, len(grid.data), list(grid.data).count(0), list(grid.data).count(100)],
        "tf": [transform.header.frame_id, transform.child_frame_id, transform.transform.position.x],
    }
    (folder / "taken.tmp").write_text(json.dumps(summary))
    (folder / "taken.tmp").rename(folder / "taken.json")


def ask(participant, folder):
    client, number = 0x1234567890ABCDEF, 0
    asked = {
        "save": ("Trigger", [0]),
        "pause": ("SetBool", [True]),
        "explore": ("SetBool", [True]),
        "return_home": ("Trigger", [0]),
        "load": ("LoadMap", ["file:///maps/a.vox"]),
        "distances": ("GetDistances", [[t.Vector(1.0, 2.0, 3.0), t.Vector(500.0, 0.0, 0.0)]]),
        "get_parameters": ("GetParameters", [["voxel_size", "field", "nothing"]]),
    }
    answers = {}
    for name, (kind, arguments) in asked.items():
        request, response = getattr(t, kind + "Request"), getattr(t, kind + "Response")
        writer = DataWriter(participant, Topic(participant, f"rq/voxelastic/{name}Request", request), qos=USUAL)
        reader = DataReader(participant, Topic(participant, f"rr/voxelastic/{name}Reply", response), qos=USUAL)
        while name not in answers:
            # Until it has found the server, nobody hears it.
            number += 1
            writer.write(request(client, number, *arguments))
            until = time.monotonic() + 1.0
            while name not in answers and time.monotonic() < until:
                for answer in reader.take(N=10):
                    if (answer.client, answer.number) == (client, number):
                        answers[name] = answer
                time.sleep(0.01)
    vector = lambda v: [v.x, v.y, v.z]
    distances = answers["distances"]
    summary = {
        "save": [answers["save"].success, answers["save"].message],
        "pause": [answers["pause"].success, answers["pause"].message],
        "explore": [answers["explore"].success, answers["explore"].message],
        "return_home": [answers["return_home"].success, answers["return_home"].message],
        "load": answers["load"].result,
        "distances": [list(distances.known), [d if d == d else None for d in distances.distances], [vector(g) for g in distances.gradients]],
        "parameters": [[v.type, v.double_value, v.string_value] for v in answers["get_parameters"].values],
    }
    (folder / "answers.tmp").write_text(json.dumps(summary))
    (folder / "answers.tmp").rename(folder / "answers.json")


mode, domain, folder = sys.argv[1], int(sys.argv[2]), File(sys.argv[3])
{"give": give, "take": take, "ask": ask}[mode](DomainParticipant(domain), folder)
