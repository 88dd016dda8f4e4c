"""A robot on Cyclone DDS or Zenoh, `robots.py PLACE FOLDER`, PLACE as networks.py says: in the namespace robot1 it drives in circles through a room (x -4..8, y -3..5, z -0.6..2.4) with odometry
that drifts, and asks the node /robot1/mapper. What it saw is in FOLDER/seen.json then."""
import json
import math
import shutil
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float32, int64, sequence, uint8, uint64

import dds_types as t
import lidar
import networks
import old_walls

SPACE = "robot1"


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


network, folder = networks.join(sys.argv[1]), Path(sys.argv[2])
call = lambda name, *arguments: network.call(f"{SPACE}/mapper/{name}", *arguments)
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
        points, odometry = network.writer(f"{SPACE}/points", t.PointCloud2, "sensor"), network.writer(f"{SPACE}/odom", t.Odometry)
        transforms, fixed = network.writer(f"{SPACE}/tf", t.TFMessage), network.writer(f"{SPACE}/tf_static", t.TFMessage, "latched")
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


class KeptGrid:
    """A grid that is kept up from what changes in it, as Nav2's static layer does."""

    def __init__(self):
        self.readers = [network.reader("map", t.OccupancyGrid, "latched"), network.reader("map_updates", t.OccupancyGridUpdate)]
        self.info, self.cells, self.frame, self.wholes, self.parts = None, None, None, 0, 0

    def take(self):
        """Whether something has come."""
        messages = [sent for topic in self.readers for sent in topic.take()]
        for _, message in sorted(messages, key=lambda sent: sent[0]):
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


diagnostics, grid = network.reader("diagnostics", t.Diagnostics), KeptGrid()
paths, tiles = network.reader(f"{SPACE}/mapper/path", t.Path, "latched"), network.reader(f"{SPACE}/mapper/surface", t.MarkerArray)
taken = []


def look():
    for _, message in diagnostics.take():
        taken.extend(status for status in message.status if status.name == f"{SPACE}/mapper")


def wait_for(what, find):
    """What it finds, once it does."""
    until = time.monotonic() + networks.PATIENCE
    while time.monotonic() < until:
        look()
        found = find()
        if found:
            return found
        time.sleep(0.05)
    raise SystemExit(f"no {what() if callable(what) else what}; the last of the node: {taken[-1:]}")


def said(words, since):
    return next((status for status in taken[since:] if words in status.message), None)


def in_grid():
    """Occupied cells well inside the room, of the grid as it is; none if nothing came."""
    if not grid.take() or grid.cells is None:
        return None
    seen["grid_frame"] = grid.frame
    return old_walls.of_cells(grid.cells, grid.info)


seen, robot = {}, Robot()
state = lambda: (lambda answer: [answer.state.id, answer.state.label])(call("get_state", GetStateRequest, GetStateResponse, 0))
change = lambda id, label="": call("change_state", ChangeStateRequest, ChangeStateResponse, Transition(id, label)).success
# Before there is a robot: lifecycle managers start their nodes in any order.
seen["states"] = [state(), change(1)]
robot.start()
seen["states"] += [change(3), change(3), state()]
waits = wait_for("words about the mount", lambda: said("scans wait", 0))
time.sleep(7)
look()
seen["without_mount"] = taken[-1].message
seen["scans_without_mount"] = next(pair.value for pair in taken[-1].values if pair.key == "scans")
robot.is_mounted, began = True, time.monotonic()
first = wait_for("path", paths.take)[-1][1].poses
seen["first_scan_s"] = round(time.monotonic() - began, 2)
position = first[0].pose.position
seen["first_lidar"] = [position.x, position.y, position.z]
before = wait_for("grid with old walls", lambda: (lambda count: count if count and count > 50 and robot.drift > 0.9 else None)(in_grid()))
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
in_grid()
corrected, surface = network.writer(f"{SPACE}/corrected", t.Path), old_walls.Surface()
# What was sent before the correction, and is read after it, does not count.
sent_from = 0
last_of = lambda topic, count: lambda: (lambda came: count(came[-1][1]) if came else None)([sent for sent in topic.take() if sent[0] >= sent_from])
costmap, octomap = network.reader(f"{SPACE}/mapper/local_costmap", t.OccupancyGrid, "latched"), network.reader(f"{SPACE}/mapper/octomap", t.Octomap, "latched")
looks = {
    "grid": in_grid,
    "local_costmap": last_of(costmap, old_walls.of_grid),
    "octomap": last_of(octomap, old_walls.of_octomap),
    "surface": lambda: (lambda came: surface.take([message for _, message in came]) if came else None)(tiles.take()),
}
walls, gone = {"grid": before}, {}


def walls_of_all():
    walls.update({name: count for name, find in looks.items() if (count := find()) is not None})
    return len(walls) == len(looks) and min(walls.values()) > 0


wait_for(lambda: f"old walls in all topics but in {walls}", walls_of_all)
wait_for("subscriber", corrected.is_heard)
before, began, sent_from = {**walls, "grid": before}, time.monotonic(), time.time_ns()
corrected.write(t.Path(header(time.time(), "odom"), list(robot.poses)))


def are_gone():
    """What a topic shows first of what is right counts: it is not asked whether it stays so."""
    for name in looks.keys() - gone.keys():
        if looks[name]() == 0:
            gone[name] = round(time.monotonic() - began, 2)
    return len(gone) == len(looks)


wait_for(lambda: f"map without old walls but in {gone}", are_gone)
seen["old_walls"] = {"before": before, "gone_s": gone}
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
initial, spread = network.writer(f"{SPACE}/initialpose", t.PoseWithCovarianceStamped), [0.25 if k in (0, 7) else 0.0 for k in range(36)]
wait_for("subscriber of initial poses", initial.is_heard)


def say(frame):
    x, y, yaw = robot.now
    initial.write(t.PoseWithCovarianceStamped(t.Header(t.Time(0, 0), frame), t.PoseWithCovariance(place(x - robot.drift, y, 0.0, yaw), spread)))
    initial.wait()


say("map")
time.sleep(2)
saved = call("save", TriggerRequest, TriggerResponse, 0).success
shutil.copytree(folder / "map.vox", folder / "before.vox")
loaded = call("load", LoadMapRequest, LoadMapResponse, str(folder / "before.vox"))
seen["loaded"] = [saved, loaded.result, list(loaded.map.data).count(100) > 50]
wait_for("grid of the map that was loaded", lambda: grid.is_of(loaded.map))
time.sleep(1.5)
before = len(wait_for("path of the map that was loaded", lambda: [path.poses for _, path in paths.take() if path.poses])[-1])
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
    return next((path.poses for _, path in reversed(paths.take()) if len(path.poses) > before), None)


at = wait_for("scan in the map that was loaded", last)[-1].pose.position
seen["loaded"].append(round(abs(math.hypot(at.x, at.y) - 1.5), 3))
seen["states"].append(change(0, "shutdown"))
(folder / "seen.tmp").write_text(json.dumps(seen))
(folder / "seen.tmp").rename(folder / "seen.json")
robot.is_done = True
