"""A robot on Cyclone DDS that drives along a room and steers by the costmaps of the node /mapper, `costmaps.py DOMAIN FOLDER`. For some seconds somebody stands beside its way. What it saw is in
FOLDER/seen.json then."""
import json
import math
import sys
import time
from pathlib import Path

import numpy
import dds_types as t
import lidar
import networks

RAYS, ROOM, PERSON = lidar.rays(64, 512), ((-6.0, -3.0, -0.6), (8.0, 3.0, 2.4)), ((1.8, 1.0, -0.6), (2.2, 1.4, 1.2))
SPEED, COMES, GOES, ENDS = 0.3, 7.0, 11.0, 18.0
RADIUS, REACH, SCALING, SIZE = 0.25, 0.7, 3.0, 5.0

network, folder = networks.join(sys.argv[1]), Path(sys.argv[2])
header = lambda s, frame: t.Header(t.Time(int(s), int(s % 1 * 1e9)), frame)
place = lambda x, z: t.Pose(t.Vector(x, 0.0, z), t.Quaternion(0.0, 0.0, 0.0, 1.0))

fixed, transforms = network.writer("tf_static", t.TFMessage, "latched"), network.writer("tf", t.TFMessage)
points, odometry = network.writer("points", t.PointCloud2), network.writer("odom", t.Odometry)
local = network.reader("mapper/local_costmap", t.OccupancyGrid, "latched")
whole = {name: network.reader(f"mapper/{name}", t.OccupancyGrid, "latched") for name in ("grid", "global_costmap")}
diagnostics, marks = network.reader("diagnostics", t.Diagnostics), []
fields, zero = [t.PointField(name, 4 * k, 7, 1) for k, name in enumerate("xyz")], t.Vector(0.0, 0.0, 0.0)
fixed.write(t.TFMessage([t.TransformStamped(header(0, "base_link"), "lidar", place(0.2, 0.4))]))

# The node may take long to start: scans come before, the drive begins with the first costmap.
begin, start, k, came, last = time.time(), None, 0, [], {}
# The whole map may take long on a busy machine: the robot waits for it.
while start is None or time.time() < start + ENDS or len(last) < len(whole):
    now = time.time()
    if now > begin + 120:
        raise SystemExit(f"of {['local_costmap', *whole]} came only {['local_costmap'] * bool(came) + list(last)}")
    driven = 0.0 if start is None else min(now - start, ENDS)
    x = -3.0 + SPEED * driven
    odometry.write(t.Odometry(header(now, "odom"), "base_link", t.PoseWithCovariance(place(x, 0.0), [0.0] * 36), t.TwistWithCovariance(zero, zero, [0.0] * 36)))
    transforms.write(t.TFMessage([t.TransformStamped(header(now, "odom"), "base_link", place(x, 0.0))]))
    if k % 4 == 0:
        data = lidar.scan(RAYS, ROOM, x + 0.2, 0.0, 0.0, [PERSON] if COMES < driven < GOES else []).tobytes()
        points.write(t.PointCloud2(header(now, "lidar"), 64, 512, fields, False, 12, 12 * 512, data, True))
    for _, message in local.take():
        if not came:
            start = now
        came.append((time.time(), message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec, message))
    for _, message in diagnostics.take():
        mapped = next((int(pair.value) for status in message.status for pair in status.values if pair.key == "scans"), None)
        if came and mapped is not None:
            marks.append((mapped, len(came)))
    for name, topic in whole.items():
        for _, message in topic.take():
            last[name] = message
    k += 1
    time.sleep(max(0.0, begin + 0.025 * k - time.time()))


def cells(message):
    info = message.info
    costs = numpy.array(message.data, numpy.int8).reshape(info.height, info.width)
    centres = lambda corner, count: corner + (numpy.arange(count) + 0.5) * info.resolution
    return costs, *numpy.meshgrid(centres(info.origin.position.x, info.width), centres(info.origin.position.y, info.height))


def inflated(costs, edge):
    """By looking at each obstacle from each cell."""
    rows, columns = numpy.nonzero(costs == 100)
    y, x = numpy.mgrid[: costs.shape[0], : costs.shape[1]]
    distance = numpy.full(costs.shape, math.inf)
    for row, column in zip(rows, columns):
        numpy.minimum(distance, edge * numpy.hypot(y - row, x - column), distance)
    falls = numpy.round(98 * numpy.exp(-SCALING * (distance - RADIUS)))
    return numpy.where(distance == 0, 100, numpy.where(distance <= RADIUS, 99, numpy.where(distance <= REACH, falls, 0)))


seen = {"frame": came[-1][2].header.frame_id, "size": [came[-1][2].info.width, came[-1][2].info.height], "resolution": came[-1][2].info.resolution}
age = sorted(at - stamp for at, stamp, _ in came)
gaps = sorted(b[1] - a[1] for a, b in zip(came, came[1:]))
seen["age_ms"] = [round(1e3 * age[int(q * len(age))]) for q in (0.5, 0.9)]
seen["gap_ms"] = [round(1e3 * gaps[int(q * len(gaps))]) for q in (0.5, 0.9)]
seen["off_centre_m"], seen["wrong_costs"], seen["too_high"], seen["false_obstacles"], seen["unknown_under"] = 0.0, 0, 0.0, 0, 0
noticed = gone = None
for _, stamp, message in came:
    driven, (costs, x, y) = min(max(0.0, stamp - start), ENDS), cells(message)
    robot = -3.0 + SPEED * driven
    seen["off_centre_m"] = max(seen["off_centre_m"], abs(x.mean() - robot), abs(y.mean()))
    # Obstacles beyond the ends of the window cost, too.
    inner = (abs(x - x.mean()) < SIZE / 2 - REACH - 0.1) & (abs(y - y.mean()) < SIZE / 2 - REACH - 0.1)
    right = inflated(costs, message.info.resolution)
    seen["wrong_costs"] += int((inner & (costs >= 0) & (costs < right - 1)).sum())
    seen["too_high"] = max(seen["too_high"], float((inner & (costs > right + 1)).mean()))
    person = numpy.hypot(x - 2.0, y - 1.2) < 0.45
    free = (abs(y) < 2.7) & (x > -5.7) & (x < 7.7) & ~person
    seen["false_obstacles"] += int((free & (costs == 100)).sum())
    is_there = bool((person & (costs == 100)).any())
    if is_there and noticed is None:
        noticed = driven - COMES
    if driven > GOES and not is_there and gone is None:
        gone = driven - GOES
    seen["unknown_under"] += int(((numpy.hypot(x - robot, y) < RADIUS - 0.1) & (costs < 0)).sum())
seen["noticed_s"], seen["gone_s"] = noticed, gone
# Scans that were mapped between the first and the last word of the node about them, and costmaps that came meanwhile.
seen["mapped"], seen["count"] = (after - before for before, after in zip(marks[0], marks[-1]))
grid, costs = (cells(last[name])[0] for name in ("grid", "global_costmap"))
seen["same_obstacles"] = bool(grid.shape == costs.shape and ((grid == 100) == (costs == 100)).mean() > 0.999)
seen["global"] = [int((costs == value).sum()) for value in (0, 99, 100)]
numpy.savez(folder / "costmaps.npz", local=cells(came[len(came) // 2][2])[0], whole=costs, grid=grid)
(folder / "seen.tmp").write_text(json.dumps(seen))
(folder / "seen.tmp").rename(folder / "seen.json")
