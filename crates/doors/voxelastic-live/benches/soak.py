"""An hour of a robot: whether `voxelastic live` drops a scan, grows, or becomes slow.

    soak.py VOXELASTIC FOLDER [MINUTES] [FLAGS...]     the command (built with the feature ros2), where to work, 60 minutes, more flags for `live`

A simulated robot drives round after round through a room. Its clouds (OS1-64, 10 Hz) and odometry (50 Hz) go over Zenoh on the loopback interface, as rmw_zenoh
sends them, and every scan is mapped; this program also listens to all that is published. A row of the table for each minute:

    sent      scans so far
    latency   from a scan's sending to the transform that is published when it is in the map, over both ways: median, 99 %, most, milliseconds
    missing   scans of the minute for which no transform came
    left out  scans that were left out so far, as the node says
    rss, map  resident memory of the process, and of the map in it, megabytes
    cpu       of one core, per cent; the load of the machine stands beside it

Needs Python with numpy and eclipse-zenoh. It ends with an error if a scan was dropped.
"""
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import urllib.request
from pathlib import Path

import numpy
import zenoh

PERIOD = 0.1
POSES = 5
TYPES = {
    "points": "sensor_msgs::msg::dds_::PointCloud2_/RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
    "odom": "nav_msgs::msg::dds_::Odometry_/RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
}
LISTENED = ["tf", "diagnostics"] + ["voxelastic/" + name for name in ("surface", "surface_points", "octomap", "grid", "grid_updates", "path", "submaps")]


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Cdr:
    """A message, little-endian."""

    def __init__(self):
        self.body = bytearray()

    def put(self, form, *values):
        for value in values:
            size = struct.calcsize(form)
            self.body += bytes(-len(self.body) % size) + struct.pack("<" + form, value)
        return self

    def text(self, text):
        self.put("I", len(text) + 1)
        self.body += text.encode() + b"\0"
        return self

    def header(self, stamp, frame):
        return self.put("I", stamp // 10**9, stamp % 10**9).text(frame)

    def finish(self, more=b""):
        return bytes([0, 1, 0, 0]) + bytes(self.body) + more


def cloud(stamp, points):
    message = Cdr().header(stamp, "lidar").put("I", 1, len(points) // 12, 3)
    for k, name in enumerate("xyz"):
        message.text(name).put("I", 4 * k).put("B", 7).put("I", 1)
    return message.put("B", 0).put("I", 12, len(points), len(points)).finish(points + b"\1")


def odometry(stamp, pose):
    return Cdr().header(stamp, "odom").text("lidar").put("d", *pose, *[0.0] * (36 + 6 + 36)).finish()


def read_points(file):
    """The points of a PCD file, x y z as float32."""
    data = file.read_bytes()
    head, _, body = data.partition(b"DATA binary\n")
    lines = dict(line.split(" ", 1) for line in head.decode().splitlines() if line and not line.startswith("#"))
    names, sizes, kinds = (lines[key].split() for key in ("FIELDS", "SIZE", "TYPE"))
    kind = {"F4": "f4", "F8": "f8", "U1": "u1", "U2": "u2", "U4": "u4", "I4": "i4"}
    dtype = numpy.dtype([(f"{name}{k}", "<" + kind[t + s]) for k, (name, s, t) in enumerate(zip(names, sizes, kinds))])
    table = numpy.frombuffer(body, dtype, int(lines["POINTS"]))
    points = numpy.stack([table[f"{name}{names.index(name)}"] for name in "xyz"], axis=1).astype("<f4")
    return points[numpy.isfinite(points).all(axis=1)].tobytes()


class Latencies:
    """When scans were sent, and when the first transform with their time stamp came."""

    def __init__(self):
        self.lock, self.sent, self.took = threading.Lock(), {}, []

    def scan(self, stamp):
        with self.lock:
            self.sent[stamp] = time.monotonic()

    def transform(self, sample):
        now, data = time.monotonic(), bytes(sample.payload)
        seconds, nanoseconds = struct.unpack_from("<II", data, 8)
        # The time that has passed since the scan is added to its stamp; without news it is published again after a tenth of a second.
        with self.lock:
            near = [s for s in self.sent if -1_000_000 < seconds * 10**9 + nanoseconds - s < 60_000_000]
            for stamp in near:
                self.took.append(1e3 * (now - self.sent.pop(stamp)))

    def minute(self):
        """Latencies since it was asked last, and the number of scans without one that are older than ten seconds."""
        with self.lock:
            took, self.took = self.took, []
            late = [s for s, at in self.sent.items() if time.monotonic() - at > 10.0]
            for stamp in late:
                del self.sent[stamp]
            return took, len(late)


def status_mb(pid, key):
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1.024e-3 for line in lines if line.startswith(key + ":"))


def cpu_seconds(pid):
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(") ", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main():
    command, folder = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
    minutes, flags = float(sys.argv[3]) if len(sys.argv) > 3 else 60.0, sys.argv[4:]
    folder.mkdir(parents=True, exist_ok=True)
    subprocess.run([command, "-q", "simulate", "room", "--laps", "1", "--rate", "10", "-o", folder / "room"], check=True)
    scans = [read_points(file) for file in sorted((folder / "room/scans").glob("*.pcd"))]
    poses = numpy.loadtxt(folder / "room/groundtruth.tum")[:, 1:8]
    print(f"{len(scans)} scans a round, {sum(map(len, scans)) // len(scans) // 12} points on average", flush=True)

    port, page, config = free_port(), free_port(), zenoh.Config()
    usual = {"mode": '"peer"', "scouting/multicast/enabled": "false", "timestamping/enabled": "true", "listen/endpoints": f'["tcp/127.0.0.1:{port}"]'}
    for key, value in usual.items():
        config.insert_json5(key, value)
    environment = {**os.environ, "ZENOH_CONFIG_OVERRIDE": f'connect/endpoints=["tcp/127.0.0.1:{port}"]'}
    session, latencies, heard = zenoh.open(config), Latencies(), dict.fromkeys(LISTENED, 0)
    held, publishers = [], {}
    for k, (name, kind) in enumerate(TYPES.items()):
        held.append(session.liveliness().declare_token(f"@ros2_lv/0/{session.zid()}/0/{k}/MP/%/%/robot/%{name}/{kind}/::,10:,:,:,,"))
        publishers[name] = session.declare_publisher(f"0/{name}/{kind}", congestion_control=zenoh.CongestionControl.BLOCK)
    for name in LISTENED:

        def listen(sample, name=name):
            heard[name] += len(sample.payload)
            if name == "tf":
                latencies.transform(sample)

        held.append(session.declare_subscriber(f"0/{name}/**", listen))

    sequence = [0]

    def send(name, message):
        sequence[0] += 1
        attachment = sequence[0].to_bytes(8, "little") + time.time_ns().to_bytes(8, "little") + bytes([16]) + bytes(16)
        publishers[name].put(message, attachment=attachment)

    arguments = ["live", "--ros2=zenoh", f"--view=127.0.0.1:{page}", "--every", "scan", "--json", "-o", folder / "soak.vox", "--overwrite", "--restart"]
    with open(folder / "soak.log", "w") as log, open(folder / "soak.json", "w") as out:
        node = subprocess.Popen([command, "-q", *arguments, *flags], env=environment, stdout=out, stderr=log)
        health = lambda: json.load(urllib.request.urlopen(f"http://127.0.0.1:{page}/health", timeout=10))
        # It looks which topics there are for some seconds, and offers the page after that.
        while True:
            try:
                health()
                break
            except OSError:
                assert node.poll() is None, (folder / "soak.log").read_text()
                time.sleep(0.2)
        time.sleep(2.0)
        print("minute     sent  median    99 %     most  missing  left out      rss     peak      map  cpu %  load", flush=True)
        begin, first = time.monotonic(), time.time_ns()
        sent, behind, missing, cpu, row = 0, 0.0, 0, cpu_seconds(node.pid), 1
        while time.monotonic() - begin < 60.0 * minutes:
            for k in range(POSES):
                due = begin + PERIOD * (sent + (k + 1) / POSES)
                time.sleep(max(0.0, due - time.monotonic()))
                behind = max(behind, time.monotonic() - due)
                # A scan and the last pose before it have the same time stamp.
                stamp = first + int((sent + (k + 1) / POSES) * PERIOD * 1e9)
                at = sent - 1 if sent and k + 1 < POSES else sent
                send("odom", odometry(stamp, poses[at % len(poses)]))
            latencies.scan(stamp)
            send("points", cloud(stamp, scans[sent % len(scans)]))
            sent += 1
            if time.monotonic() - begin >= 60.0 * row:
                took, late = latencies.minute()
                missing, used, state = missing + late, cpu_seconds(node.pid), health()
                median, most = (numpy.quantile(took, q) if took else numpy.nan for q in (0.5, 1.0))
                slow = numpy.quantile(took, 0.99) if took else numpy.nan
                rss, peak = status_mb(node.pid, "VmRSS"), status_mb(node.pid, "VmHWM")
                print(
                    f"{row:6d} {sent:8d} {median:7.1f} {slow:7.1f} {most:8.1f} {late:8d} {state['scans_left_out']:9d} "
                    f"{rss:8.1f} {peak:8.1f} {state['map_mb']:8.1f} {(used - cpu) / 0.6:6.1f} {os.getloadavg()[0]:5.1f}",
                    flush=True,
                )
                cpu, row = used, row + 1
        time.sleep(15.0)
        missing += latencies.minute()[1]
        node.send_signal(signal.SIGINT)
        code = node.wait(timeout=600)
    summary = json.loads((folder / "soak.json").read_text())
    keys = ["scans", "scans_came", "scans_left_out", "scans_skipped", "messages_lost", "submaps", "delay_ms", "delay_p99_ms", "shown_ms", "shown_p99_ms"]
    print({key: summary[key] for key in keys + ["checkpoints", "peak_rss_mb", "map_mb"]})
    print(f"exit code {code}; {sent} scans sent, at most {1e3 * behind:.0f} ms late; without a transform: {missing}; bytes heard: {heard}")
    session.close()
    is_whole = summary["scans"] == sent and summary["scans_left_out"] == summary["messages_lost"] == 0 and code == 0
    sys.exit(0 if is_whole else 1)


main()
