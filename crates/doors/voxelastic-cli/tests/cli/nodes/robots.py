"""A robot on Cyclone DDS, `robots.py DOMAIN FOLDER`: in the namespace robot1 it drives in circles through a room (x -4..8, y -3..5, z -0.6..2.4) with odometry that drifts, and asks
the node /robot1/mapper. What it saw is in FOLDER/seen.json then."""
import json
import math
import shutil
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float32, int64, sequence, uint8, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

import dds_types as t
import lidar

SPACE = "robot1"
RELIABLE = Policy.Reliability.Reliable(duration(seconds=1))
LATCHED = Qos(RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
USUAL = Qos(RELIABLE, Policy.Durability.Volatile, Policy.History.KeepLast(200))
SENSOR = Qos(Policy.Reliability.BestEffort, Policy.Durability.Volatile, Policy.History.KeepLast(5))
PATIENCE = 120.0


@dataclass
class State(IdlStruct, **t.message("lifecycle_msgs", "State")):
    id: uint8
    label: str


@dataclass
class Transition(IdlStruct, **t.message("lifecycle_msgs", "Transition")):
    id: uint8
    label: str


@dataclass
class GetStateRequest(IdlStruct, **t.service("lifecycle_msgs", "GetState_Request")):
    client: uint64
    number: int64
    nothing: uint8


@dataclass
class GetStateResponse(IdlStruct, **t.service("lifecycle_msgs", "GetState_Response")):
    client: uint64
    number: int64
    state: State


@dataclass
class ChangeStateRequest(IdlStruct, **t.service("lifecycle_msgs", "ChangeState_Request")):
    client: uint64
    number: int64
    transition: Transition


@dataclass
class ChangeStateResponse(IdlStruct, **t.service("lifecycle_msgs", "ChangeState_Response")):
    client: uint64
    number: int64
    success: bool


@dataclass
class GetPlanRequest(IdlStruct, **t.service("nav_msgs", "GetPlan_Request")):
    client: uint64
    number: int64
    start: t.PoseStamped
    goal: t.PoseStamped
    tolerance: float32


@dataclass
class GetPlanResponse(IdlStruct, **t.service("nav_msgs", "GetPlan_Response")):
    client: uint64
    number: int64
    plan: t.Path


@dataclass
class GetMapRequest(IdlStruct, **t.service("nav_msgs", "GetMap_Request")):
    client: uint64
    number: int64
    nothing: uint8


@dataclass
class GetMapResponse(IdlStruct, **t.service("nav_msgs", "GetMap_Response")):
    client: uint64
    number: int64
    map: t.OccupancyGrid


@dataclass
class LoadMapRequest(IdlStruct, **t.service("nav_msgs", "LoadMap_Request")):
    client: uint64
    number: int64
    map_url: str


@dataclass
class LoadMapResponse(IdlStruct, **t.service("nav_msgs", "LoadMap_Response")):
    client: uint64
    number: int64
    map: t.OccupancyGrid
    result: uint8


@dataclass
class TriggerRequest(IdlStruct, **t.service("std_srvs", "Trigger_Request")):
    client: uint64
    number: int64
    nothing: uint8


@dataclass
class TriggerResponse(IdlStruct, **t.service("std_srvs", "Trigger_Response")):
    client: uint64
    number: int64
    success: bool
    message: str


participant, folder = DomainParticipant(int(sys.argv[1])), Path(sys.argv[2])
writer = lambda name, kind, qos: DataWriter(participant, Topic(participant, f"rt/{name}", kind), qos=qos)
reader = lambda name, kind, qos: DataReader(participant, Topic(participant, f"rt/{name}", kind), qos=qos)
stamp = lambda s: t.Time(int(s), int(s % 1 * 1e9))
header = lambda s, frame: t.Header(stamp(s), frame)
turn = lambda yaw: t.Quaternion(0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
place = lambda x, y, z, yaw=0.0: t.Pose(t.Vector(x, y, z), turn(yaw))
link = lambda s, parent, child, pose: t.TransformStamped(header(s, parent), child, pose)

RAYS, ROOM = lidar.rays(16, 360), ((-4.0, -3.0, -0.6), (8.0, 5.0, 2.4))


class Robot(threading.Thread):
    """Lidar 0.4 m above the base; odometry drifts by 8 cm a second until it stops that."""

    def __init__(self):
        super().__init__(daemon=True)
        self.is_mounted = self.is_silent = self.has_rival = self.is_done = False
        self.drift, self.drifts, self.poses, self.now = 0.0, True, [], (0.0, 0.0, 0.0)

    def run(self):
        points, odometry = writer(f"{SPACE}/points", t.PointCloud2, SENSOR), writer(f"{SPACE}/odom", t.Odometry, USUAL)
        transforms, fixed = writer(f"{SPACE}/tf", t.TFMessage, USUAL), writer(f"{SPACE}/tf_static", t.TFMessage, LATCHED)
        fixed.write(t.TFMessage([link(0, "base_link", "imu_link", place(0.0, 0.0, 0.0))]))
        fields, zero = [t.PointField(name, 4 * k, 7, 1) for k, name in enumerate("xyz")], t.Vector(0.0, 0.0, 0.0)
        is_mounted, begin, k = False, time.time(), 0
        while not self.is_done:
            now = time.time()
            phase = 0.5 * (now - begin)
            x, y, yaw = 1.5 * math.cos(phase), 1.5 * math.sin(phase), phase + math.pi / 2
            if self.is_mounted and not is_mounted:
                both = [link(0, "base_link", "imu_link", place(0.0, 0.0, 0.0)), link(0, "base_link", "lidar", place(0.0, 0.0, 0.4))]
                is_mounted = not fixed.write(t.TFMessage(both))
            if is_mounted and self.drifts:
                self.drift += 0.08 * 0.04
            self.now = (x + self.drift, y, yaw)
            pose = place(x + self.drift, y, 0.0, yaw)
            twist = t.TwistWithCovariance(zero, zero, [0.0] * 36)
            odometry.write(t.Odometry(header(now, "odom"), "base_link", t.PoseWithCovariance(pose, [0.0] * 36), twist))
            moving = [link(now, "odom", "base_link", pose)]
            if self.has_rival:
                moving.append(link(now, "map", "odom", place(5.0, 0.0, 0.0)))
            transforms.write(t.TFMessage(moving))
            if k % 5 == 0 and not self.is_silent:
                data = lidar.scan(RAYS, ROOM, x, y, yaw).tobytes()
                points.write(t.PointCloud2(header(now, "lidar"), 16, 360, fields, False, 12, 12 * 360, data, True))
                self.poses.append(t.PoseStamped(header(now, "odom"), place(x, y, 0.0, yaw)))
            k += 1
            time.sleep(max(0.0, begin + 0.04 * k - time.time()))


number = 0


def call(name, request, response, *arguments):
    """As rmw_cyclonedds does; asked again until it is heard."""
    global number
    asks = DataWriter(participant, Topic(participant, f"rq/{SPACE}/mapper/{name}Request", request), qos=USUAL)
    answers = DataReader(participant, Topic(participant, f"rr/{SPACE}/mapper/{name}Reply", response), qos=USUAL)
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        matched = time.monotonic() + 5.0
        while not (asks.get_matched_subscriptions() and answers.get_matched_publications()) and time.monotonic() < matched:
            time.sleep(0.02)
        number += 1
        asks.write(request(77, number, *arguments))
        wait = time.monotonic() + 10.0
        while time.monotonic() < wait:
            for answer in answers.take(N=10):
                if (answer.client, answer.number) == (77, number):
                    return answer
            time.sleep(0.01)
    raise SystemExit(f"no answer of {name}")


class KeptGrid:
    """A grid that is kept up from what changes in it, as Nav2's static layer does."""

    def __init__(self):
        self.readers = [reader("map", t.OccupancyGrid, LATCHED), reader("map_updates", t.OccupancyGridUpdate, USUAL)]
        self.info, self.cells, self.frame, self.wholes, self.parts = None, None, None, 0, 0

    def take(self):
        """Whether something has come."""
        messages = [message for topic in self.readers for message in topic.take(N=100) if hasattr(message, "header")]
        for message in sorted(messages, key=lambda message: message.sample_info.source_timestamp):
            if isinstance(message, t.OccupancyGrid):
                self.info, self.frame, self.wholes = message.info, message.header.frame_id, self.wholes + 1
                self.cells = numpy.array(message.data, numpy.int8).reshape(message.info.height, message.info.width)
            elif self.cells is not None:
                rows, columns = slice(message.y, message.y + message.height), slice(message.x, message.x + message.width)
                self.cells[rows, columns] = numpy.array(message.data, numpy.int8).reshape(message.height, message.width)
                self.parts += 1
        return len(messages) > 0

    def is_of(self, other):
        """Whether it is the same as another message says, now or after what comes next."""
        self.take()
        place = lambda info: (info.width, info.height, info.resolution, info.origin.position.x, info.origin.position.y)
        return place(self.info) == place(other.info) and self.cells.tobytes() == numpy.array(other.data, numpy.int8).tobytes()


diagnostics, grid = reader("diagnostics", t.Diagnostics, USUAL), KeptGrid()
paths = reader(f"{SPACE}/mapper/path", t.Path, LATCHED)
taken = []


def look():
    for message in diagnostics.take(N=50):
        taken.extend(status for status in message.status if status.name == f"{SPACE}/mapper")


def wait_for(what, find):
    """What it finds, once it does."""
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        look()
        found = find()
        if found:
            return found
        time.sleep(0.05)
    raise SystemExit(f"no {what}; the last of the node: {taken[-1:]}")


def said(words, since):
    return next((status for status in taken[since:] if words in status.message), None)


def old_walls():
    """Occupied cells well inside the room, of the grid as it is; none if nothing came."""
    if not grid.take() or grid.cells is None:
        return None
    info, (rows, columns) = grid.info, numpy.nonzero(grid.cells == 100)
    x = info.origin.position.x + (columns + 0.5) * info.resolution
    y = info.origin.position.y + (rows + 0.5) * info.resolution
    seen["grid_frame"] = grid.frame
    return int(((x > -3.6) & (x < 7.6) & (y > -2.6) & (y < 4.6)).sum())


seen, robot = {}, Robot()
robot.start()
state = lambda: (lambda answer: [answer.state.id, answer.state.label])(call("get_state", GetStateRequest, GetStateResponse, 0))
change = lambda id, label="": call("change_state", ChangeStateRequest, ChangeStateResponse, Transition(id, label)).success
seen["states"] = [state(), change(1), change(3), change(3), state()]
waits = wait_for("words about the mount", lambda: said("scans wait", 0))
time.sleep(7)
look()
seen["without_mount"] = taken[-1].message
seen["scans_without_mount"] = next(pair.value for pair in taken[-1].values if pair.key == "scans")
robot.is_mounted, began = True, time.monotonic()
first = wait_for("path", lambda: paths.take(N=10))[-1].poses
seen["first_scan_s"] = round(time.monotonic() - began, 2)
position = first[0].pose.position
seen["first_lidar"] = [position.x, position.y, position.z]
before = wait_for("grid with old walls", lambda: (lambda count: count if count and count > 50 and robot.drift > 0.9 else None)(old_walls()))
robot.drifts = False
stamped = lambda frame, x, y, z: t.PoseStamped(t.Header(t.Time(0, 0), frame), place(x, y, z))
nowhere, plan = t.Vector(math.nan, math.nan, math.nan), None
# From a metre to the left of the robot, towards the middle of its circle, where much is free.
beside = lambda x, y, yaw: (x - math.sin(yaw), y + math.cos(yaw))
for _ in range(20):
    places = [robot.now]
    plan = call("plan", GetPlanRequest, GetPlanResponse, stamped("base_link", 0.0, 1.0, 0.57), stamped("map", robot.drift, 0.0, 0.57), 0.1).plan
    places.append(robot.now)
    start = plan.poses[0].pose.position if plan.poses else nowhere
    if plan.poses:
        break
off = min(math.dist((start.x, start.y), beside(*place)) for place in places)
seen["plan"] = {"frame": plan.header.frame_id, "poses": len(plan.poses), "off_m": off}
asked = call("map", GetMapRequest, GetMapResponse, 0).map
seen["get_map"] = [asked.header.frame_id, asked.info.width * asked.info.height == len(asked.data), list(asked.data).count(100) > 50]
nonsense = call("plan", GetPlanRequest, GetPlanResponse, stamped("base_link", 0.0, 0.0, 0.6), stamped("nonsense", 4.0, 2.0, 0.6), 0.1)
seen["plan_from_nonsense"] = len(nonsense.plan.poses)
old_walls()
corrected, began = writer(f"{SPACE}/corrected", t.Path, USUAL), time.monotonic()
wait_for("subscriber", lambda: corrected.get_matched_subscriptions())
began = time.monotonic()
corrected.write(t.Path(header(time.time(), "odom"), list(robot.poses)))
after = wait_for("grid without old walls", lambda: (lambda count: "none" if count == 0 else None)(old_walls()))
seen["old_walls"] = {"before": before, "after": 0 if after == "none" else 1, "seconds": round(time.monotonic() - began, 2)}
robot.has_rival, since = True, len(taken)
seen["rival"] = wait_for("words about a rival", lambda: said("somebody else", since)).message
robot.has_rival, robot.is_silent, since = False, True, len(taken)
silence = wait_for("words about silence", lambda: said("nothing came on", since))
seen["silence"], seen["silence_level"] = silence.message, silence.level
# Nothing moves now: the grid that was kept up from changes is the whole one, and so is that of somebody who comes.
for _ in range(20):
    whole = call("map", GetMapRequest, GetMapResponse, 0).map
    time.sleep(1.5)
    if grid.is_of(whole):
        break
else:
    raise SystemExit("the grid that is kept up is not the whole one")
late = KeptGrid()
wait_for("grid for somebody who comes", lambda: late.take() and late.cells is not None and late.is_of(whole))
seen["grid_messages"] = [grid.wholes, grid.parts, late.wholes]
# Where the robot says that it is, in a map that it goes on in.
initial, spread = writer(f"{SPACE}/initialpose", t.PoseWithCovarianceStamped, USUAL), [0.25 if k in (0, 7) else 0.0 for k in range(36)]
wait_for("subscriber of initial poses", lambda: initial.get_matched_subscriptions())


def say(frame):
    x, y, yaw = robot.now
    initial.write(t.PoseWithCovarianceStamped(t.Header(t.Time(0, 0), frame), t.PoseWithCovariance(place(x - robot.drift, y, 0.0, yaw), spread)))
    initial.wait_for_acks(duration(seconds=PATIENCE))


say("map")
time.sleep(2)
saved = call("save", TriggerRequest, TriggerResponse, 0).success
shutil.copytree(folder / "map.vox", folder / "before.vox")
loaded = call("load", LoadMapRequest, LoadMapResponse, str(folder / "before.vox"))
seen["loaded"] = [saved, loaded.result, list(loaded.map.data).count(100) > 50]
wait_for("grid of the map that was loaded", lambda: grid.is_of(loaded.map))
time.sleep(1.5)
before = len(wait_for("path of the map that was loaded", lambda: [path.poses for path in paths.take(N=10) if path.poses])[-1])
say("nonsense")
say("map")
time.sleep(1)
robot.is_silent, told = False, time.monotonic()


def last():
    """The path, once it goes on. The robot drives, so that where it was a second ago says nothing on a busy machine: it says it again."""
    global told
    if time.monotonic() > told + 1.0:
        say("map")
        told = time.monotonic()
    return next((path.poses for path in reversed(paths.take(N=10)) if len(path.poses) > before), None)


at = wait_for("scan in the map that was loaded", last)[-1].pose.position
seen["loaded"].append(round(abs(math.hypot(at.x, at.y) - 1.5), 3))
seen["states"].append(change(0, "shutdown"))
(folder / "seen.tmp").write_text(json.dumps(seen))
(folder / "seen.tmp").rename(folder / "seen.json")
robot.is_done = True
