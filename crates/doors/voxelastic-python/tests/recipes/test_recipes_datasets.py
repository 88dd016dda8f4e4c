"""The recipes of the book for data sets as they are downloaded: KITTI, nuScenes, Newer College. The data are a simulated walk in exactly their layouts; the maps are compared with the world."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recipe_bags import Bag, Fields
from recipe_files import floats, kitti_rows, pcd, xyz
from recipe_world import SMALL, Array, Walk, intensities, measured, quaternion, rigid, rotations, spinning, sweep, voxelastic

HDL32 = np.linspace(10.67, -30.67, 32)
OS1_64 = np.linspace(16.6, -16.6, 64)
WALK = Walk()


@pytest.fixture(scope="module")
def kitti(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The odometry benchmark: poses of the left camera, which looks along the sensor's x, in the frame of its first image."""
    dataset = tmp_path_factory.mktemp("kitti") / "dataset"
    sequence = dataset / "sequences" / "07"
    times, beams = 0.4 * np.arange(32), spinning(np.linspace(2, -24.8, 64), 360)
    # KITTI's own calibration of 04 to 12, to some digits.
    axes = np.array([[-0.00185774, -0.99996595, -0.00803998], [-0.00648147, 0.00805186, -0.99994661], [0.99997731, -0.00180553, -0.00649620]])
    t_camera_lidar = rigid([-0.00478440, -0.07337429, -0.33399681], axes)
    for k, time in enumerate(times):
        points = sweep(WALK.poses, time, beams, from_one_place=True, seed=k)
        floats(sequence / "velodyne" / f"{k:06d}.bin", [*points.T, intensities(points) / 255])
    lidar = np.linalg.inv(WALK.poses(0.0)) @ WALK.poses(times)
    camera = t_camera_lidar @ lidar @ np.linalg.inv(t_camera_lidar)
    projection = "7.070912000000e+02 0 6.018873000000e+02 0 0 7.070912000000e+02 1.831104000000e+02 0 0 0 1 0"
    rows = [f"P{k}: {projection}" for k in range(4)] + ["Tr: " + " ".join(f"{value:.12e}" for value in kitti_rows(t_camera_lidar[None])[0])]
    (sequence / "calib.txt").write_text("\n".join(rows) + "\n")
    (sequence / "times.txt").write_text("".join(f"{time:.6e}\n" for time in times))
    (dataset / "poses").mkdir()
    np.savetxt(dataset / "poses" / "07.txt", kitti_rows(camera), fmt="%.6e")
    return dataset


@pytest.mark.parametrize("opened", ["dataset", "sequence"])
def test_kitti(kitti: Path, opened: str, tmp_path: Path) -> None:
    data = kitti if opened == "dataset" else kitti / "sequences" / "07"
    said = voxelastic("map", data, "-o", tmp_path / "07.vox", *SMALL)
    found = measured(tmp_path / "07.vox", WALK.poses(0.0), up_to=1.2)
    print(f"KITTI: {found}")
    assert found.median < 0.01 and found.most < 0.04 and found.complete > 0.8, said


def token(*of: object) -> str:
    """A token of nuScenes: 32 hexadecimal digits."""
    import hashlib

    return hashlib.md5(repr(of).encode(), usedforsecurity=False).hexdigest()


def nuscenes_scene(root: Path, tables: dict[str, list[Any]], scene: int, log: str, begin_us: int, walk: Walk, offset: Array) -> None:
    """A scene of 20 sweeps a second, each tenth a keyframe. Poses are those of the car in the frame of the city; the sensor's x points to the right, its y ahead."""
    t_car_lidar = rigid([0.943713, 0.0, 0.3], rotations(0, 0, -np.pi / 2))
    beams = spinning(HDL32, 240, forward="y")
    calibrated, count = token("calibrated", log), 120
    tables["log"].append({"token": token("log", log), "logfile": log, "vehicle": log[:4], "date_captured": "2018-07-24", "location": "singapore-onenorth"})
    tables["calibrated_sensor"].append(
        {
            "token": calibrated,
            "sensor_token": token("LIDAR_TOP"),
            "translation": t_car_lidar[:3, 3].tolist(),
            "rotation": np.roll(quaternion(t_car_lidar[:3, :3]), 1).tolist(),
            "camera_intrinsic": [],
        }
    )
    data = [token("sample_data", log, scene, k) for k in range(count)]
    samples = [token("sample", log, scene, k) for k in range(0, count, 10)]
    tables["scene"].append(
        {"token": token("scene", scene), "log_token": token("log", log), "nbr_samples": len(samples), "first_sample_token": samples[0]}
        | {"last_sample_token": samples[-1], "name": f"scene-{scene:04d}", "description": ""}
    )
    for k in range(count):
        time, stamp = 0.05 * k, begin_us + 50_000 * k
        is_key = k % 10 == 0
        name = f"{'samples' if is_key else 'sweeps'}/LIDAR_TOP/{log}__LIDAR_TOP__{stamp}.pcd.bin"
        # Ahead of the sensor is its y.
        lidar = turned(walk, time)
        points = sweep(lambda times, lidar=lidar: np.broadcast_to(lidar, (len(times), 4, 4)), time, beams, from_one_place=True, seed=k)  # type: ignore[misc]
        floats(root / name, [*points.T, intensities(points).round(), beams.rings])
        car = offset @ lidar @ np.linalg.inv(t_car_lidar)
        tables["ego_pose"].append(
            {"token": data[k], "timestamp": stamp, "rotation": np.roll(quaternion(car[:3, :3]), 1).tolist(), "translation": car[:3, 3].tolist()}
        )
        tables["sample_data"].append(
            {"token": data[k], "sample_token": samples[k // 10], "ego_pose_token": data[k], "calibrated_sensor_token": calibrated, "timestamp": stamp}
            | {"fileformat": "pcd", "is_key_frame": is_key, "height": 0, "width": 0, "filename": name}
            | {"prev": data[k - 1] if k else "", "next": data[k + 1] if k + 1 < count else ""}
        )
        if is_key:
            j = k // 10
            around = {"prev": samples[j - 1] if j else "", "next": samples[j + 1] if j + 1 < len(samples) else ""}
            tables["sample"].append({"token": samples[j], "timestamp": stamp, "scene_token": token("scene", scene)} | around)


def turned(walk: Walk, time: float) -> Array:
    """The pose of a sensor whose y points ahead."""
    return walk.poses(time) @ rigid(np.zeros(3), rotations(0, 0, -np.pi / 2))


CITY = rigid([411.3, 1180.9, 0.0], rotations(0, 0, 0.7))
TABLES = ("log", "scene", "sample", "sample_data", "ego_pose", "calibrated_sensor", "sensor")


def nuscenes_root(root: Path, scenes: int) -> Path:
    tables: dict[str, list[Any]] = {name: [] for name in TABLES}
    tables["sensor"].append({"token": token("LIDAR_TOP"), "channel": "LIDAR_TOP", "modality": "lidar"})
    for number in range(scenes):
        log = ("n015-2018-07-24-11-22-45+0800", "n008-2018-08-01-15-16-36-0400")[number]
        begin = (1_532_402_927_647_951, 1_533_151_603_547_590)[number]
        # The second scene is elsewhere in the city.
        nuscenes_scene(root, tables, (61, 103)[number], log, begin, WALK, CITY if number == 0 else rigid([800.0, 300.0, 0.0]) @ CITY)
    for name, rows in tables.items():
        path = root / "v1.0-mini" / f"{name}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(rows, indent=0))
    return root


@pytest.fixture(scope="module")
def nuscenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return nuscenes_root(tmp_path_factory.mktemp("nuscenes") / "nuscenes", 1)


def book_program(page: str) -> str:
    """The program on a page of the book."""
    import re

    book = Path(__file__).resolve().parents[5] / "docs" / "src" / "recipes"
    (program,) = re.findall(r"^```python\n(.*?)^```", (book / page).read_text(encoding="utf-8"), re.M | re.S)
    return str(program)


def test_nuscenes_with_its_poses(nuscenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The program of the page writes the poses of a scene, and where the sensor is on the car."""
    monkeypatch.chdir(nuscenes.parent)
    exec(compile(book_program("nuscenes.md"), "nuscenes.md", "exec"), {})
    mount = Path("scene-0061", "lidar.txt").read_text()
    said = voxelastic("map", "scene-0061", "--t-base-lidar", mount, "--every", "0.4m", "-o", tmp_path / "scene.vox", *SMALL)
    assert "poses agree with the scans" in said
    found = measured(tmp_path / "scene.vox", np.linalg.inv(CITY))
    print(f"nuScenes, its poses: {found}")
    assert found.median < 0.01 and found.most < 0.04 and found.complete > 0.6, said


def test_nuscenes_without_poses(nuscenes: Path, tmp_path: Path) -> None:
    said = voxelastic("map", nuscenes, "--every", "0.4m", "-o", tmp_path / "scene.vox", *SMALL)
    found = measured(tmp_path / "scene.vox", turned(WALK, 0.0), fit=True)
    print(f"nuScenes, estimated poses: {found}")
    assert found.median < 0.015 and found.most < 0.06 and found.complete > 0.6, said


def test_nuscenes_with_clouds_of_two_drives(tmp_path: Path) -> None:
    root = nuscenes_root(tmp_path / "nuscenes", 2)
    said = voxelastic("check", root, fails=True)
    assert "between two scans there are 9 days" in said and "a folder of each drive" in said
    said = voxelastic("map", root, "--every", "0.4m", "-o", tmp_path / "scene.vox", *SMALL)
    assert "they are of several drives" in said


OUSTER_2020: Fields = (
    *(("x", 0, "f4"), ("y", 0, "f4"), ("z", 0, "f4"), ("intensity", 0, "f4"), ("t", 0, "u4")),
    *(("reflectivity", 0, "u2"), ("ring", 0, "u1"), ("noise", 0, "u2"), ("range", 0, "u4")),
)
"""Points of ouster_ros in 2020."""
T_CAMERA_LIDAR = rigid([-0.084, -0.025, 0.05], rotations(0, 0, 2 * np.arctan2(0.924, 0.383)))


@pytest.fixture(scope="module")
def newer_college(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sequence of 2020: clouds of all beams, column by column, with times of points; the ground truth is of the left camera, at the times of the clouds."""
    sequence = tmp_path_factory.mktemp("newer-college") / "01_short_experiment"
    beams = spinning(OS1_64, 128, by_column=True)
    lines = ["#sec,nsec,x,y,z,qx,qy,qz,qw"]
    for k in range(100):
        nanoseconds = 1_583_836_591_182_590_976 + 100_000_256 * k
        second, rest = divmod(nanoseconds, 10**9)
        time = (nanoseconds - 1_583_836_591_182_590_976) * 1e-9
        points = np.nan_to_num(sweep(WALK.poses, time, beams, seed=k))
        ranges = np.round(1e3 * np.linalg.norm(points, axis=1))
        columns = xyz(points) | {"intensity": intensities(points), "t": np.round(1e9 * beams.times), "ring": beams.rings, "range": ranges}
        pcd(sequence / "raw_format" / "ouster_scan" / f"cloud_{second}_{rest}.pcd", OUSTER_2020, columns)
        pose = WALK.poses(time) @ np.linalg.inv(T_CAMERA_LIDAR)
        lines.append(",".join([str(second), str(rest), *(f"{value:.6f}" for value in (*pose[:3, 3], *quaternion(pose[:3, :3])))]))
    (sequence / "ground_truth").mkdir()
    (sequence / "ground_truth" / "registered_poses.csv").write_text("\n".join(lines) + "\n")
    return sequence


def test_newer_college(newer_college: Path, tmp_path: Path) -> None:
    said = voxelastic("map", newer_college, "--every", "0.4s", "-o", tmp_path / "short.vox", *SMALL)
    found = measured(tmp_path / "short.vox")
    print(f"Newer College: {found}")
    assert found.median < 0.01 and found.most < 0.04 and found.complete > 0.8, said


OUSTER_2021: Fields = (
    *(("x", 0, "f4"), ("y", 4, "f4"), ("z", 8, "f4"), ("intensity", 16, "f4"), ("t", 20, "u4"), ("reflectivity", 24, "u2")),
    *(("ring", 26, "u1"), ("ambient", 28, "u2"), ("range", 32, "u4")),
)
"""Points of ouster_ros in memory, 48 bytes."""


def test_newer_college_of_2021(tmp_path: Path) -> None:
    """A bag with organised clouds, and a trajectory beside it."""
    bag, beams = Bag(ros=1), spinning(np.linspace(45, -45, 64), 128)
    lines = ["#sec,nsec,x,y,z,qx,qy,qz,qw"]
    for k in range(100):
        second, rest = divmod(1_625_135_858_000_000_000 + 100_000_256 * k, 10**9)
        time = 0.100000256 * k
        points = np.nan_to_num(sweep(WALK.poses, time, beams, seed=k))
        columns = xyz(points) | {"intensity": intensities(points), "t": np.round(1e9 * beams.times), "ring": beams.rings}
        stamp = second + 1e-9 * rest
        bag.add("/os_cloud_node/points", stamp + 0.1, bag.cloud(stamp, "os_sensor", OUSTER_2021, 48, columns, rows=64))
        pose = WALK.poses(time)
        lines.append(",".join([str(second), str(rest), *(f"{value:.6f}" for value in (*pose[:3, 3], *quaternion(pose[:3, :3])))]))
    (tmp_path / "gt-nc-quad-easy.csv").write_text("\n".join(lines) + "\n")
    bag.save(tmp_path / "quad-easy.bag")
    words = ("map", tmp_path / "quad-easy.bag", "--poses", tmp_path / "gt-nc-quad-easy.csv", "--every", "0.4s")
    said = voxelastic(*words, "-o", tmp_path / "quad.vox", *SMALL)
    found = measured(tmp_path / "quad.vox")
    print(f"Newer College, 2021: {found}")
    assert found.median < 0.01 and found.most < 0.04 and found.complete > 0.8, said
