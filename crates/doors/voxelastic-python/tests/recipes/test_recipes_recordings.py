"""The recipes of the book for recordings: an Ouster's packets, a Livox, Autoware. The data are a simulated walk in exactly their layouts; the maps are compared with the world."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from recipe_bags import Bag, Fields
from recipe_files import xyz
from recipe_world import GRAVITY, SMALL, SWEEP_S, Array, Beams, Walk, intensities, measured, rigid, rosette, rotations, spinning, sweep, undistorted, voxelastic

BEGIN = 1_700_000_000.0
OUSTER_ROWS, OUSTER_COLUMNS, COLUMNS_OF_PACKET = 32, 512, 16
SECONDS = 10.0
WALK = Walk(rest=1.0)


def ouster_metadata() -> dict[str, object]:
    """The JSON of a sensor with 32 rows, in sections as firmware 3 writes it. Its beams are staggered."""
    return {
        "beam_intrinsics": {
            "beam_altitude_angles": np.round(np.linspace(16.6, -16.6, OUSTER_ROWS), 2).tolist(),
            "beam_azimuth_angles": np.tile([4.2, 1.4, -1.4, -4.2], OUSTER_ROWS // 4).tolist(),
            "lidar_origin_to_beam_origin_mm": 15.806,
            "beam_to_lidar_transform": [1, 0, 0, 15.806, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
        },
        "imu_intrinsics": {"imu_to_sensor_transform": [1, 0, 0, 6.253, 0, 1, 0, -11.775, 0, 0, 1, 7.645, 0, 0, 0, 1]},
        "lidar_intrinsics": {"lidar_to_sensor_transform": [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1]},
        "lidar_data_format": {
            "columns_per_frame": OUSTER_COLUMNS,
            "columns_per_packet": COLUMNS_OF_PACKET,
            "column_window": [0, OUSTER_COLUMNS - 1],
            "pixels_per_column": OUSTER_ROWS,
            "pixel_shift_by_row": np.tile([6, 2, -2, -6], OUSTER_ROWS // 4).tolist(),
            "udp_profile_lidar": "RNG19_RFL8_SIG16_NIR16",
            "udp_profile_imu": "LEGACY",
            "fps": 10,
        },
        "config_params": {"lidar_mode": f"{OUSTER_COLUMNS}x10", "udp_port_lidar": 7502, "udp_port_imu": 7503, "timestamp_mode": "TIME_FROM_INTERNAL_OSC"},
        "sensor_info": {"prod_line": "OS-1-32", "prod_sn": "122000000001", "status": "RUNNING", "initialization_id": 5431292, "build_rev": "v3.1.0"},
        "calibration_status": {},
    }


def ouster_beams(metadata: dict[str, dict[str, list[float]]]) -> tuple[Beams, Array]:
    """Beams in the sensor's frame, column by column, and the distance of each beam's origin from the axis: ranges count from the axis, along the beam."""
    intrinsics = metadata["beam_intrinsics"]
    altitude, offset = np.deg2rad(intrinsics["beam_altitude_angles"]), np.deg2rad(intrinsics["beam_azimuth_angles"])
    column, row = (index.ravel() for index in np.meshgrid(np.arange(OUSTER_COLUMNS), np.arange(OUSTER_ROWS), indexing="ij"))
    # Lidar coordinates: the encoder turns clockwise from the connector's side, x; the sensor's frame is turned by half a turn.
    encoder = 2 * np.pi * (1 - column / OUSTER_COLUMNS) + np.pi
    azimuth = encoder - offset[row]
    directions = np.stack([np.cos(azimuth) * np.cos(altitude[row]), np.sin(azimuth) * np.cos(altitude[row]), np.sin(altitude[row])], axis=1)
    arm = 0.015806
    origins = np.stack([arm * np.cos(encoder), arm * np.sin(encoder), np.full(len(encoder), 0.03618)], axis=1)
    return Beams(directions, SWEEP_S * column / OUSTER_COLUMNS, row, origins), np.full(len(row), arm)


def datagram(payload: bytes, port: int, number: int) -> list[bytes]:
    """Ethernet frames of a UDP datagram, in fragments of 1,480 bytes as they come over a usual network."""
    body = struct.pack(">HHHH", port, port, 8 + len(payload), 0) + payload
    frames = []
    for at in range(0, len(body), 1480):
        part = body[at : at + 1480]
        more = 0x2000 if at + 1480 < len(body) else 0
        head = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + len(part), number & 0xFFFF, more | at // 8, 64, 17, 0, bytes([169, 254, 1, 2]), bytes([169, 254, 1, 1]))
        frames.append(bytes(12) + b"\x08\x00" + head + part)
    return frames


@pytest.fixture(scope="module")
def ouster(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture of an OS1 with its inertial unit, whose clock counts from when it was switched on; the metadata beside it have the capture's name."""
    folder = tmp_path_factory.mktemp("ouster")
    metadata = ouster_metadata()
    (folder / "walk.json").write_text(json.dumps(metadata))
    beams, arm = ouster_beams(metadata)  # type: ignore[arg-type]
    switched_on, began = 731.25, 1_650_000_000.0
    packets: list[tuple[float, int, bytes]] = []
    t_sensor_imu = rigid([0.006253, -0.011775, 0.007645])
    samples = np.arange(0, SECONDS, 0.01)
    for time, rate, force in zip(samples, *WALK.imu(samples, t_sensor_imu), strict=True):
        stamps = struct.pack("<QQQ", *[round(1e9 * (switched_on + time))] * 3)
        packets.append((time, 7503, stamps + struct.pack("<6f", *(force / 9.80665), *np.rad2deg(rate))))
    for turn in range(int(SECONDS / SWEEP_S)):
        begin = SWEEP_S * turn
        points = sweep(WALK.poses, begin, beams, seed=turn)
        ranges = np.nan_to_num(1e3 * (np.linalg.norm(points - beams.origins, axis=1) + arm)).round().astype(np.uint32).reshape(OUSTER_COLUMNS, OUSTER_ROWS)
        strength = intensities(points).astype(np.uint8).reshape(OUSTER_COLUMNS, OUSTER_ROWS)
        for first in range(0, OUSTER_COLUMNS, COLUMNS_OF_PACKET):
            head = struct.pack("<HH", 1, turn & 0xFFFF) + (5431292).to_bytes(3, "little") + (122000000001).to_bytes(5, "little") + bytes(20)
            columns = []
            for column in range(first, first + COLUMNS_OF_PACKET):
                time = begin + SWEEP_S * column / OUSTER_COLUMNS
                pixels = np.zeros((OUSTER_ROWS, 12), np.uint8)
                pixels[:, :4] = ranges[column].astype("<u4").view(np.uint8).reshape(-1, 4)
                pixels[:, 4] = strength[column]
                columns.append(struct.pack("<QHH", round(1e9 * (switched_on + time)), column, 1) + pixels.tobytes())
            packets.append((begin + SWEEP_S * (first + COLUMNS_OF_PACKET) / OUSTER_COLUMNS, 7502, head + b"".join(columns) + bytes(32)))
    with open(folder / "walk.pcap", "wb") as file:
        file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1))
        for number, (time, port, payload) in enumerate(sorted(packets, key=lambda packet: packet[0])):
            for frame in datagram(payload, port, number):
                second, rest = divmod(round(1e6 * (began + time)), 10**6)
                file.write(struct.pack("<IIII", second, rest, len(frame), len(frame)) + frame)
    return folder / "walk.pcap"


def test_ouster(ouster: Path, tmp_path: Path) -> None:
    said = voxelastic("map", ouster, "--every", "0.4m", "-o", tmp_path / "walk.vox", *SMALL)
    found = measured(tmp_path / "walk.vox", WALK.poses(0.0), fit=True)
    print(f"Ouster: {found}")
    assert found.median < 0.015 and found.most < 0.06 and found.complete > 0.8, said


def test_ouster_without_its_metadata(ouster: Path, tmp_path: Path) -> None:
    (tmp_path / "walk.pcap").symlink_to(ouster)
    said = voxelastic("map", tmp_path / "walk.pcap", "-o", tmp_path / "walk.vox", fails=True)
    assert ".json" in said


LIVOX: Fields = (
    *(("x", 0, "f4"), ("y", 4, "f4"), ("z", 8, "f4"), ("intensity", 12, "f4"), ("tag", 16, "u1"), ("line", 17, "u1")),
    ("timestamp", 18, "f8"),
)
"""Points of livox_ros_driver2 in a `PointCloud2`, 26 bytes: times in nanoseconds since 1970, as a float of 64 bits."""


def livox_bag(path: Path, ros: int, *, as_point_cloud2: bool = False) -> Path:
    """A Mid-360 and its inertial unit, which counts acceleration in g; both are in the frame livox_frame, as the driver says."""
    bag = Bag(ros=ros, livox="livox_ros_driver" if ros == 1 else "livox_ros_driver2")
    for turn in range(int(SECONDS / SWEEP_S)):
        begin, beams = SWEEP_S * turn, rosette(2500, turn)
        stamp, points = BEGIN + begin, sweep(WALK.poses, begin, beams, seed=turn)
        if as_point_cloud2:
            columns = xyz(points) | {"intensity": intensities(points), "line": beams.rings, "timestamp": np.round(1e9 * (stamp + beams.times))}
            cloud = bag.cloud(stamp, "livox_frame", LIVOX, 26, columns)
        else:
            cloud = bag.livox_cloud(stamp, "livox_frame", points, beams.times, beams.rings)
        bag.add("/livox/lidar", BEGIN + begin + SWEEP_S, cloud)
    times = np.arange(0, SECONDS, 0.005)
    # The unit is beside the lidar's origin, but no frame says so.
    for time, rate, force in zip(times, *WALK.imu(times, rigid([0.011, 0.02329, -0.04412])), strict=True):
        bag.add("/livox/imu", BEGIN + time, bag.imu(BEGIN + time, "livox_frame", rate, force / GRAVITY))
    return bag.save(path)


@pytest.mark.parametrize("name", ["walk.bag", "walk_mcap", "walk_of_point_clouds"])
def test_livox(name: str, tmp_path: Path) -> None:
    bag = livox_bag(tmp_path / name, 1 if name == "walk.bag" else 2, as_point_cloud2=name == "walk_of_point_clouds")
    said = voxelastic("map", bag, "--every", "0.4m", "-o", tmp_path / "walk.vox", *SMALL)
    found = measured(tmp_path / "walk.vox", WALK.poses(0.0), fit=True)
    print(f"Livox, {name}: {found}")
    assert "imu: /livox/imu" in said
    assert found.median < 0.015 and found.most < 0.06 and found.complete > 0.8, said


XYZIRCAEDT: Fields = (
    *(("x", 0, "f4"), ("y", 4, "f4"), ("z", 8, "f4"), ("intensity", 12, "u1"), ("return_type", 13, "u1"), ("channel", 14, "u2")),
    *(("azimuth", 16, "f4"), ("elevation", 20, "f4"), ("distance", 24, "f4"), ("time_stamp", 28, "u4")),
)
"""Points of Nebula, 32 bytes: times in nanoseconds after the stamp."""
XYZIRC: Fields = XYZIRCAEDT[:6]
"""Points of Autoware's filters, 16 bytes, without times."""
T_BASE_LIDAR = rigid([0.9, 0.0, 1.1], rotations(0, 0.02, 1.575))


@pytest.fixture(scope="module")
def autoware(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a car with Autoware records: clouds of the sensor, and those of all sensors in the frame base_link without times; poses of base_link at 50 Hz, twice."""
    bag, beams = Bag(ros=2), spinning(np.linspace(15, -25, 32), 240, by_column=True)
    walk = Walk()
    bag.add("/tf_static", BEGIN - 1, bag.transform(BEGIN - 1, "base_link", "sensor_kit_base_link", rigid([0.9, 0, 1.1])))
    bag.add("/tf_static", BEGIN - 1, bag.transform(BEGIN - 1, "sensor_kit_base_link", "velodyne_top", rigid([0, 0, 0], T_BASE_LIDAR[:3, :3])))
    for turn in range(120):
        begin = SWEEP_S * turn
        stamp = BEGIN + begin
        points = sweep(walk.poses, begin, beams, seed=turn)
        columns = xyz(points) | {"intensity": intensities(points).astype(np.uint8), "return_type": np.full(len(points), 3), "channel": beams.rings}
        columns |= {"azimuth": np.arctan2(points[:, 0], points[:, 1]), "distance": np.linalg.norm(points, axis=1)}
        columns |= {"elevation": np.arcsin(beams.directions[:, 2]), "time_stamp": np.round(1e9 * beams.times)}
        bag.add("/sensing/lidar/top/pointcloud_raw_ex", stamp + 0.11, bag.cloud(stamp, "velodyne_top", XYZIRCAEDT, 32, columns))
        level = undistorted(points, walk.poses, begin, beams, begin) @ T_BASE_LIDAR[:3, :3].T + T_BASE_LIDAR[:3, 3]
        columns |= xyz(level)
        bag.add("/sensing/lidar/concatenated/pointcloud", stamp + 0.15, bag.cloud(stamp, "base_link", XYZIRC, 16, columns))
    for time in np.arange(0, 12.1, 0.02):
        base = walk.poses(time) @ np.linalg.inv(T_BASE_LIDAR)
        bag.add("/localization/kinematic_state", BEGIN + time + 0.01, bag.odometry(BEGIN + time, "map", "base_link", base))
        bag.add("/tf", BEGIN + time + 0.01, bag.transform(BEGIN + time, "map", "base_link", base))
    return bag.save(tmp_path_factory.mktemp("autoware") / "rosbag2_2026_11_29-12_00_00")


@pytest.mark.parametrize("topic", [None, "/sensing/lidar/top/pointcloud_raw_ex"])
def test_autoware(autoware: Path, topic: str | None, tmp_path: Path) -> None:
    chosen = ("--cloud-topic", topic) if topic else ()
    said = voxelastic("map", autoware, *chosen, "--every", "0.4s", "-o", tmp_path / "drive.vox", *SMALL)
    found = measured(tmp_path / "drive.vox")
    print(f"Autoware, {topic}: {found}")
    assert found.median < 0.01 and found.most < 0.04 and found.complete > 0.8, said


def test_autoware_with_the_clouds_of_all_sensors(autoware: Path, tmp_path: Path) -> None:
    """They are in the frame of the car: rays begin there, a metre below the sensor."""
    chosen = ("--cloud-topic", "/sensing/lidar/concatenated/pointcloud")
    said = voxelastic("map", autoware, *chosen, "--every", "0.4s", "-o", tmp_path / "drive.vox", *SMALL)
    found = measured(tmp_path / "drive.vox")
    print(f"Autoware, all sensors: {found}")
    assert found.median < 0.02, said
