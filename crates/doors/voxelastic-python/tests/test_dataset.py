"""Folders and recordings, as the command reads them."""

from __future__ import annotations

import pickle
import subprocess
import sysconfig
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import voxelastic as vx

COMMAND = Path(sysconfig.get_path("scripts")) / "voxelastic"


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated walk through a room, with odometry, a pose graph and corrections."""
    folder = tmp_path_factory.mktemp("data") / "drive"
    subprocess.run([COMMAND, "simulate", "room", "-o", folder, "--scans", "12", "--sensor", "vlp-16", "-q"], check=True, timeout=120)
    return folder


def test_a_folder_gives_its_scans(drive: Path) -> None:
    dataset = vx.Dataset.open(drive)
    assert dataset.scan_count == len(dataset) == 12 and dataset.path == drive and repr(dataset) == f"Dataset({str(drive)!r}, 12 scans)"
    assert "poses.tum" in str(dataset)
    scans = list(dataset)
    assert [scan.node for scan in scans] == list(range(12)) == [scan.node for scan in dataset], "as often as one likes"
    assert (np.diff([scan.time for scan in scans]) > 0).all()
    scan = scans[3]
    rows, columns = scan.shape
    assert rows == 16 and scan.points.shape == (16, columns, 3) and len(scan) == 16 * columns and scan.points.dtype == np.float32
    for values, dtype in ((scan.intensity, np.float32), (scan.ring, np.uint16), (scan.times, np.float32)):
        assert values is not None and values.shape == (16 * columns,) and values.dtype == dtype
    assert scan.colours is None and scan.pose is not None
    np.testing.assert_allclose(scan.pose[:3, 3], np.loadtxt(drive / "poses.tum")[3, 1:4], atol=1e-9)
    assert repr(scan).startswith(f"Scan(node 3, 16 x {columns} points, at ")
    assert not any(array.flags.writeable for array in (scan.points, scan.intensity, scan.ring, scan.times, scan.pose) if array is not None)


def test_scans_are_found_by_number(drive: Path, tmp_path: Path) -> None:
    dataset = vx.Dataset.open(drive)
    all_scans = list(dataset)
    assert dataset[np.int64(5)].node == 5  # type: ignore[call-overload]
    for number in (3, 4, 11, 0, -1, -12):
        scan = dataset[number]
        np.testing.assert_array_equal(scan.points, all_scans[number].points)
        np.testing.assert_array_equal(scan.pose, all_scans[number].pose)
        assert (scan.node, scan.time) == (all_scans[number].node, all_scans[number].time)
    assert [scan.node for scan in dataset[2:9:3]] == [2, 5, 8] and [scan.node for scan in dataset[-2:]] == [10, 11]
    assert [scan.node for scan in dataset[::-1]] == list(range(11, -1, -1)) and dataset[20:] == []
    for number in (12, -13):
        with pytest.raises(IndexError, match=f"there are 12 scans, and none with number {number}"):
            dataset[number]
    with pytest.raises(TypeError):
        dataset["3"]  # type: ignore[call-overload]
    dataset.close()
    with pytest.raises(ValueError, match="closed"):
        dataset[0]
    simulate = "simulate room -o room --bag --sensor vlp-16 --columns 180 --scans 4 --rate 5 -q"
    subprocess.run([COMMAND, *simulate.split()], cwd=tmp_path, check=True, timeout=120)
    recording = vx.Dataset.open(tmp_path / "room" / "recording.mcap", every="scan")
    assert recording[2].time == list(recording)[2].time
    with pytest.raises(IndexError, match="none with number 4"):
        recording[4]
    if recording.scan_count is None:
        with pytest.raises(TypeError, match="does not say how many"):
            recording[-1]
    else:
        assert recording[-1].time == recording[3].time


def test_events_make_the_map_that_the_command_makes(drive: Path, tmp_path: Path) -> None:
    """By events and by replay, bit for bit."""
    subprocess.run([COMMAND, "map", drive, "-o", tmp_path / "command.vox", "--voxel-size", "0.1", "--lambda-odom", "3", "-q"], check=True, timeout=300)
    by_event, by_replay = (vx.Mapper(voxel_size=0.1, lambda_odom=3) for _ in range(2))
    dataset = vx.Dataset.open(drive)
    kinds = set()
    for event in dataset.events():
        kinds.add(type(event).__name__ if not isinstance(event, vx.Edge) else f"closes_loop={event.closes_loop}")
        by_event.handle(event)
    assert kinds >= {"Scan", "closes_loop=False"}
    steps: list[int] = []
    assert by_replay.replay(dataset, progress=steps.append) == 12 == sum(steps)
    by_event.finish().save(tmp_path / "event.vox")
    by_replay.finish().save(tmp_path / "replay.vox")
    files = [sorted(file.name for file in (tmp_path / f"{name}.vox").glob("submap-*")) for name in ("command", "event", "replay")]
    assert files[0] == files[1] == files[2] != []


# Odometry that is off by a sixth of its path does not fit the scans, and that is said.
@pytest.mark.filterwarnings("ignore:the poses do not fit:voxelastic.RunWarning")
def test_events_with_corrections_make_the_map_of_a_replay(tmp_path: Path) -> None:
    """Poses go through matrices for users to read, and keep their last bits all the same."""
    drive = vx.Simulation("room", scans=30, spacing=2.0, columns=128, max_range=30, drift=5.0)
    dataset = drive.write(tmp_path / "drive")
    by_event, by_replay = (vx.Mapper(voxel_size=0.2, lambda_odom=5) for _ in range(2))
    kinds = set()
    for event in dataset.events():
        kinds.add(f"closes_loop={event.closes_loop}" if isinstance(event, vx.Edge) else type(event).__name__)
        by_event.handle(event)
        if not isinstance(event, vx.Scan):
            assert repr(pickle.loads(pickle.dumps(event))).startswith(type(event).__name__)
    by_replay.replay(dataset, progress=False)
    assert kinds >= {"Scan", "closes_loop=False", "closes_loop=True", "PoseUpdate"}
    by_event.finish().save(tmp_path / "event.vox")
    by_replay.finish().save(tmp_path / "replay.vox")
    files = [sorted(file.name for file in (tmp_path / f"{name}.vox").glob("submap-*")) for name in ("event", "replay")]
    assert files[0] == files[1] != []


def test_intervals_are_those_of_the_command(drive: Path) -> None:
    assert [scan.node for scan in vx.Dataset.open(drive, every=5)] == [0, 5, 10]
    assert len(list(vx.Dataset.open(drive, every="1000m"))) == 1
    with pytest.raises(ValueError, match="every: .*none of: scan"):
        vx.Dataset.open(drive, every="often")


def test_scans_that_cannot_be_read_are_skipped_with_a_warning(drive: Path, tmp_path: Path) -> None:
    damaged = tmp_path / "damaged"
    damaged.mkdir()
    for file in ("poses.tum", "graph.g2o"):
        (damaged / file).write_bytes((drive / file).read_bytes())
    (damaged / "scans").mkdir()
    for scan in sorted((drive / "scans").iterdir()):
        (damaged / "scans" / scan.name).write_bytes(scan.read_bytes()[:-100] if scan.name == "000004.pcd" else scan.read_bytes())
    with pytest.warns(UserWarning, match=r"scan skipped: .*000004\.pcd"):
        assert [scan.node for scan in vx.Dataset.open(damaged)] == [node for node in range(12) if node != 4]
    with pytest.warns(UserWarning, match=r"000004\.pcd"):
        assert vx.Mapper(voxel_size=0.1).replay(vx.Dataset.open(damaged)) == 11
    numbered = vx.Dataset.open(damaged)
    assert numbered[5].node == 5
    with pytest.raises(vx.FileError, match=r"000004\.pcd"):
        numbered[4]
    assert numbered[-1].node == 11
    with pytest.raises(vx.FileError, match=r"000004\.pcd"):
        list(vx.Dataset.open(damaged, strict=True))
    with pytest.raises(vx.RefusedError, match=r"000004\.pcd"):
        vx.Mapper(voxel_size=0.1).replay(vx.Dataset.open(damaged), strict=True)


def test_two_sensors_of_a_recording_are_mapped_together(tmp_path: Path) -> None:
    simulate = "simulate room -o room --bag --sensor vlp-16 --second-lidar vlp-16 --columns 180 --scans 8 --rate 5 -q"
    subprocess.run([COMMAND, *simulate.split()], cwd=tmp_path, check=True, timeout=120)
    topics, poses = ["/points", "/points_2"], tmp_path / "room" / "groundtruth.tum"
    of_topics = [vx.Dataset.open(tmp_path / "room" / "recording.mcap", poses=poses, every="scan", cloud_topic=topic) for topic in (topics[0], topics)]
    counts = []
    for dataset in (*of_topics, pickle.loads(pickle.dumps(of_topics[1]))):
        mapper = vx.Mapper(voxel_size=0.1, max_range=20)
        counts.append((mapper.replay(dataset), len(mapper.finish().mesh())))
    assert counts[0][0] == 8 and counts[1][0] == 16 and counts[1][1] > 1.1 * counts[0][1] and counts[1] == counts[2]
    second = (np.array([-0.6, 0, -0.3]), np.array([-0.3420201433, 0, 0.9396926208, 0]))
    lidars: list[vx.Pose] = [np.eye(4), second]
    given = vx.Dataset.open(tmp_path / "room" / "recording.mcap", poses=poses, every="scan", cloud_topic=topics, t_base_lidar=lidars)
    mapper = vx.Mapper(voxel_size=0.1, max_range=20)
    assert mapper.replay(given) == 16 and abs(len(mapper.finish().mesh()) - counts[1][1]) < 0.01 * counts[1][1]


def test_folders_of_two_sensors_are_mapped_together(tmp_path: Path) -> None:
    for name, sensor in (("front", "vlp-16"), ("rear", "os1-32")):
        simulate = f"simulate room --drift 0 --scans 8 --columns 180 -q -o {name} --sensor {sensor}"
        subprocess.run([COMMAND, *simulate.split()], cwd=tmp_path, check=True, timeout=120)
        for file in ("poses.tum", "graph.g2o"):
            (tmp_path / name / file).unlink()
    # The poses of the second folder become those of a base that is half a metre beside its lidar, and turned.
    mounts = [np.eye(4), np.array([[0.28, -0.96, 0, 0.1], [0.96, 0.28, 0, 0.5], [0, 0, 1, -0.2], [0, 0, 0, 1.0]])]
    poses = np.loadtxt(tmp_path / "rear" / "groundtruth.tum")
    for row in poses:
        # The lidar's quaternion times the inverse of the mount's.
        x, y, z, w = row[4:]
        row[4:] = [0.8 * x - 0.6 * y, 0.8 * y + 0.6 * x, 0.8 * z - 0.6 * w, 0.8 * w + 0.6 * z]
        row[1:4] -= _rotation(*row[4:]) @ mounts[1][:3, 3]
    np.savetxt(tmp_path / "rear" / "groundtruth.tum", poses, fmt="%.12g")
    front, rear = tmp_path / "front", tmp_path / "rear"
    alone = vx.Dataset.open(front, poses="groundtruth")
    together = vx.Dataset.open(front, poses="groundtruth", also=rear, t_base_lidar=mounts)
    sizes = []
    for dataset, count in ((alone, 8), (together, 16), (pickle.loads(pickle.dumps(together)), 16)):
        mapper = vx.Mapper(voxel_size=0.1, max_range=20)
        assert dataset.scan_count == count and mapper.replay(dataset) == count
        sizes.append(len(mapper.finish().mesh()))
    assert sizes[1] > 1.1 * sizes[0] and sizes[1] == sizes[2]
    # What the second sensor sees lies on what the first one does.
    mapper = vx.Mapper(voxel_size=0.1, max_range=20)
    mapper.replay(alone)
    surface = mapper.finish().mesh()
    for scan in list(vx.Dataset.open(front, poses="groundtruth", also=[str(rear)], t_base_lidar=mounts))[1::2]:
        assert scan.pose is not None
        points = scan.points[np.isfinite(scan.points).all(axis=-1)].astype(np.float64) @ scan.pose[:3, :3].T + scan.pose[:3, 3]
        assert np.median(surface.distance(points)) < 0.05
    with pytest.raises(ValueError, match="list of 2 poses, one for each folder, not 3"):
        vx.Dataset.open(front, also=rear, t_base_lidar=[np.eye(4)] * 3)
    with pytest.raises(vx.FileError, match="nowhere"):
        vx.Dataset.open(front, poses="groundtruth", also=[tmp_path / "nowhere"])
    with pytest.raises(vx.FileError, match="where its sensor is beside the first is not known"):
        vx.Dataset.open(front, also=rear, slam=True)


def _rotation(x: float, y: float, z: float, w: float) -> NDArray[np.float64]:
    """The matrix of a quaternion."""
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_what_cannot_be_opened_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="nothing: there is nothing of this name"):
        vx.Dataset.open(tmp_path / "nothing")
    with pytest.raises(vx.FileError, match=tmp_path.name):
        vx.Dataset.open(tmp_path)
    with pytest.raises(ValueError, match="time_tolerance"):
        vx.Dataset.open(tmp_path, time_tolerance=-1)
    with pytest.raises(ValueError, match="t_base_lidar"):
        vx.Dataset.open(tmp_path, t_base_lidar=np.eye(3))
    with pytest.raises(ValueError, match="list of 2 poses, one for each topic of clouds, not 3"):
        vx.Dataset.open(tmp_path, cloud_topic=["/a", "/b"], t_base_lidar=[np.eye(4)] * 3)
    with pytest.raises(ValueError, match=r"t_base_lidar\[1\]"):
        vx.Dataset.open(tmp_path, cloud_topic=["/a", "/b"], t_base_lidar=[np.eye(4), np.eye(3)])
    with pytest.raises(TypeError, match="Dataset"):
        vx.Dataset()
    with pytest.raises(TypeError, match="event: expected a Scan"):
        vx.Mapper().handle("scan")  # type: ignore[arg-type]
