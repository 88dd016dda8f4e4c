"""A robot on wheels in a simulated mine that drives to goals by the costmaps of `voxelastic live --ros2`, over somebody else's DDS.

It knows nothing of the mine but what the node publishes: it plans on `global_costmap`, in which unknown cells are dear, and does not enter what `local_costmap` says that it would touch.

    pip install voxelastic cyclonedds
    voxelastic live --ros2 --local --domain 7 --node mapper --field both --every scan --voxel-size 0.05 --max-range 25 --step 0.2 --footprint-radius 0.4 --inflation-radius 1.2 -o mine.vox &
    python drive_to_goals.py 7 --goals 4 --patience 60 --json

It says of each goal how long it took, and how near the robot came to the walls of the mine, which it does not know.
"""

from __future__ import annotations

import argparse
import heapq
import json
import math
import sys
import time
from pathlib import Path

import numpy as np
import voxelastic as vx
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "ros2"))
import dds_types as t  # noqa: E402

RELIABLE = Policy.Reliability.Reliable(duration(seconds=1))
LATCHED = Qos(RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
USUAL = Qos(RELIABLE, Policy.Durability.Volatile, Policy.History.KeepLast(20))
TOUCHES, UNKNOWN_COST = 99, 30
LIDAR_M, BODY_M, RADIUS_M = 0.6, (0.2, 0.5, 0.8), 0.4
"""Heights of the lidar and of parts of the body above the floor, and the radius of the body."""
SPEED, TURN = 0.8, 1.0
STEP_S, SCAN_EVERY = 0.05, 4
DRIFT = 0.003
"""The odometry says so much more than was driven."""


class World:
    """What there is, and what a lidar sees of it."""

    def __init__(self, name: str) -> None:
        self.simulation = vx.Simulation(name)
        rows, columns = np.radians(np.linspace(-40, 20, 16)), np.linspace(-np.pi, np.pi, 512, endpoint=False)
        level = [np.outer(np.cos(rows), f(columns)) for f in (np.cos, np.sin)]
        self.rays = np.stack([*level, np.outer(np.sin(rows), np.ones(len(columns)))], -1).reshape(-1, 3)
        self.size = (len(rows), len(columns))

    def along(self, origin: np.ndarray, rays: np.ndarray, most: float, steps: int) -> np.ndarray:
        """How far it is along each ray; infinite where nothing is within `most` metres."""
        ranges, active = np.full(len(rays), 0.05), np.arange(len(rays))
        for _ in range(steps):
            near = self.simulation.distance(origin + rays[active] * ranges[active, None])
            ranges[active] += near
            active = active[(near > 0.005) & (ranges[active] < most)]
            if not len(active):
                break
        ranges[active] = np.inf
        return np.where(ranges < most, ranges, np.inf)

    def floor(self, x: float, y: float, above: float) -> float:
        return above - float(self.along(np.array([x, y, above]), np.array([[0.0, 0.0, -1.0]]), 10.0, 60)[0])

    def scan(self, position: np.ndarray, yaw: float) -> np.ndarray:
        c, s = math.cos(yaw), math.sin(yaw)
        ranges = self.along(position, self.rays @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]), 25.0, 40)
        ranges += np.random.default_rng(int(1e3 * ranges[np.isfinite(ranges)].sum())).normal(0.0, 0.01, len(ranges))
        return (self.rays * np.where(np.isfinite(ranges), ranges, 0.0)[:, None]).astype(np.float32)

    def clearance(self, x: float, y: float, floor: float) -> float:
        """From the body to what is beside it, metres; negative in a wall."""
        angles = np.linspace(-np.pi, np.pi, 16, endpoint=False)
        around = np.stack([np.cos(angles), np.sin(angles), np.zeros(16)], -1)
        return min(float(self.along(np.array([x, y, floor + height]), around, 5.0, 30).min()) for height in BODY_M) - RADIUS_M


class Costmap:
    """The last of a topic, with its updates."""

    def __init__(self, participant: DomainParticipant, name: str) -> None:
        whole, parts = Topic(participant, f"rt/{name}", t.OccupancyGrid), Topic(participant, f"rt/{name}_updates", t.OccupancyGridUpdate)
        self.readers = DataReader(participant, whole, qos=LATCHED), DataReader(participant, parts, qos=USUAL)
        self.costs: np.ndarray | None = None

    def take(self) -> None:
        messages = [message for reader in self.readers for message in reader.take(N=50) if hasattr(message, "header")]
        for message in sorted(messages, key=lambda message: message.sample_info.source_timestamp):
            if isinstance(message, t.OccupancyGrid):
                self.info = message.info
                self.costs = np.array(message.data, np.int8).reshape(message.info.height, message.info.width)
            elif self.costs is not None:
                part = slice(message.y, message.y + message.height), slice(message.x, message.x + message.width)
                self.costs[part] = np.array(message.data, np.int8).reshape(message.height, message.width)

    def cell(self, x: float, y: float) -> tuple[int, int]:
        origin, edge = self.info.origin.position, self.info.resolution
        return int((y - origin.y) // edge), int((x - origin.x) // edge)

    def at(self, x: float, y: float) -> int:
        """The cost there; -1 where it is not known."""
        row, column = self.cell(x, y)
        inside = self.costs is not None and 0 <= row < self.costs.shape[0] and 0 <= column < self.costs.shape[1]
        return int(self.costs[row, column]) if inside and self.costs is not None else -1


def plan(costmap: Costmap, start: tuple[float, float], goal: tuple[float, float]) -> list[tuple[float, float]]:
    """The cheapest way over cells of 10 cm, as Nav2's NavFn has it; empty if there is none. Beyond the costmap nothing is known."""
    each = max(1, round(0.1 / costmap.info.resolution))
    edge, margin = each * costmap.info.resolution, 60
    costs = np.where(costmap.costs < 0, UNKNOWN_COST, costmap.costs)  # type: ignore[operator]
    costs = np.pad(costs, [(0, -size % each) for size in costs.shape], constant_values=UNKNOWN_COST)
    costs = costs.reshape(costs.shape[0] // each, each, costs.shape[1] // each, each).max((1, 3))
    price = 1.0 + 0.1 * np.pad(costs, margin, constant_values=UNKNOWN_COST)
    cell_of = lambda place: tuple(int(v) for v in np.clip(np.array(costmap.cell(*place)) // each + margin, 0, np.subtract(price.shape, 1)))  # noqa: E731
    first, last = cell_of(start), cell_of(goal)
    price[price >= 1.0 + 0.1 * TOUCHES] = np.inf
    best, came, queue = {first: 0.0}, {}, [(0.0, 0.0, first)]
    while queue:
        _, spent, (row, column) = heapq.heappop(queue)
        if (row, column) == last:
            break
        if spent > best[row, column]:
            continue
        for dr, dc in ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
            r, c = row + dr, column + dc
            if not (0 <= r < price.shape[0] and 0 <= c < price.shape[1]):
                continue
            now = spent + math.hypot(dr, dc) * float(price[r, c])
            if now < best.get((r, c), math.inf):
                best[r, c], came[r, c] = now, (row, column)
                heapq.heappush(queue, (now + math.hypot(last[0] - r, last[1] - c), now, (r, c)))
    cell, way = last, []
    while cell in came:
        way.append(cell)
        cell = came[cell]
    origin = costmap.info.origin.position
    return [(origin.x + (c - margin + 0.5) * edge, origin.y + (r - margin + 0.5) * edge) for r, c in reversed(way)]


def steer(local: Costmap, at: tuple[float, float, float], way: list[tuple[float, float]]) -> tuple[float, float]:
    """Speed and turn along the way; none into what the robot would touch."""
    x, y, yaw = at
    nearest = min(range(len(way)), key=lambda k: math.dist(way[k], (x, y)))
    ahead = next((place for place in way[nearest:] if math.dist(place, (x, y)) > 0.8), way[-1])
    error = (math.atan2(ahead[1] - y, ahead[0] - x) - yaw + math.pi) % (2 * math.pi) - math.pi
    speed, turn = SPEED * max(0.0, math.cos(error)) ** 2, max(-TURN, min(TURN, 2.0 * error))
    # Of turns near the wanted one, the first whose arc is free; else back, or about.
    for forward, change in ((speed, 0.0), (speed, 0.3), (speed, -0.3), (speed, 0.6), (speed, -0.6), (-0.3, -turn)):
        px, py, p_yaw = x, y, yaw
        costs = []
        for _ in range(10):
            p_yaw += 0.1 * (turn + change)
            px, py = px + 0.1 * forward * math.cos(p_yaw), py + 0.1 * forward * math.sin(p_yaw)
            costs.append(local.at(px, py))
        # Who stands where it touches something may leave.
        if max(costs) < TOUCHES or (local.at(x, y) >= TOUCHES > costs[-1] and max(costs) <= TOUCHES):
            return forward, turn + change
    return 0.0, TURN


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("domain", type=int)
    parser.add_argument("--world", default="mine")
    parser.add_argument("--goals", type=int, default=3)
    parser.add_argument("--patience", type=float, default=240.0, help="seconds for each goal")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    world, participant = World(arguments.world), DomainParticipant(arguments.domain)
    writer = lambda name, kind, qos: DataWriter(participant, Topic(participant, f"rt/{name}", kind), qos=qos)  # noqa: E731
    header = lambda s, frame: t.Header(t.Time(int(s), int(s % 1 * 1e9)), frame)  # noqa: E731
    pose = lambda x, y, z, yaw: t.Pose(t.Vector(x, y, z), t.Quaternion(0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)))  # noqa: E731
    fixed, moving = writer("tf_static", t.TFMessage, LATCHED), writer("tf", t.TFMessage, USUAL)
    points, odometry = writer("points", t.PointCloud2, USUAL), writer("odom", t.Odometry, USUAL)
    fields, still = [t.PointField(name, 4 * k, 7, 1) for k, name in enumerate("xyz")], t.TwistWithCovariance(t.Vector(0.0, 0.0, 0.0), t.Vector(0.0, 0.0, 0.0), [0.0] * 36)
    fixed.write(t.TFMessage([t.TransformStamped(header(0, "base_link"), "lidar", pose(0.0, 0.0, LIDAR_M, 0.0))]))
    local, whole = Costmap(participant, "mapper/local_costmap"), Costmap(participant, "mapper/global_costmap")

    route = world.simulation.true_poses[:, :3, 3]
    x, y = route[0, :2]
    yaw = math.atan2(*(route[3] - route[0])[1::-1])
    begin = time.time()
    # The map is in the frame of the odometry, which begins where the robot is and is longer than what was driven.
    origin, driven = np.array([x, y]), np.array([0.0, 0.0])
    z0 = world.floor(x, y, route[0, 2])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(route, axis=0), axis=1))])
    stops = [route[np.searchsorted(length, 14.0 * (k + 1))] for k in range(arguments.goals)]
    goals, way, reached, clearance, k = [tuple((stop[:2] - origin) * (1 + DRIFT)) for stop in stops], [], [], math.inf, 0
    since, planned = None, 0.0
    while goals:
        now = time.time()
        local.take()
        whole.take()
        if since is None and local.costs is not None and whole.costs is not None:
            since = now
        place = (driven[0], driven[1], yaw)
        speed = turn = 0.0
        if since is not None:
            if now - since > arguments.patience:
                break
            if now - planned > 2.0:
                way, planned = plan(whole, (driven[0], driven[1]), goals[0]), now
            speed, turn = steer(local, place, way) if way else (0.0, 0.5 * TURN)
        yaw += STEP_S * turn
        step = STEP_S * speed * np.array([math.cos(yaw), math.sin(yaw)])
        (x, y), driven = (x, y) + step, driven + (1 + DRIFT) * step
        z = world.floor(x, y, z0 + 1.0)
        z0 = z
        clearance = min(clearance, world.clearance(x, y, z))
        base = pose(driven[0], driven[1], z, yaw)
        odometry.write(t.Odometry(header(now, "odom"), "base_link", t.PoseWithCovariance(base, [0.0] * 36), still))
        moving.write(t.TFMessage([t.TransformStamped(header(now, "odom"), "base_link", base)]))
        if k % SCAN_EVERY == 0:
            data = world.scan(np.array([x, y, z + LIDAR_M]), yaw)
            rows, columns = world.size
            points.write(t.PointCloud2(header(now, "lidar"), rows, columns, fields, False, 12, 12 * columns, data.tobytes(), True))
        if since is not None and math.dist(driven, goals[0]) < 0.5:
            reached.append({"goal": [round(float(v), 2) for v in goals.pop(0)], "seconds": round(now - since, 1), "off_m": round(float(np.linalg.norm((x, y) - stops[len(reached)][:2])), 2)})
            since, way, planned = now, [], 0.0
        k += 1
        time.sleep(max(0.0, begin + STEP_S * k - time.time()))
    found = {"reached": reached, "missed": len(goals), "driven_m": round(float(np.linalg.norm(driven)), 1), "least_clearance_m": round(clearance, 3)}
    print(json.dumps(found) if arguments.json else found)
    sys.exit(1 if goals or clearance < 0.0 else 0)


if __name__ == "__main__":
    main()
