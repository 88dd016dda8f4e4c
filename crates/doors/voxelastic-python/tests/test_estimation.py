"""Poses from scans alone: odometry, mapping without poses, localisation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import voxelastic as vx


@pytest.fixture(scope="module")
def drive() -> vx.Simulation:
    """A short walk through a furnished room."""
    return vx.Simulation("room", scans=12, spacing=0.3, columns=256, max_range=30)


def distances(poses: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Between positions, in the frame of the first pose."""
    relative = np.linalg.inv(truth[0]) @ truth
    return np.asarray(np.linalg.norm(poses[:, :3, 3] - relative[:, :3, 3], axis=1))


def test_odometry_finds_the_poses(drive: vx.Simulation) -> None:
    tracker = vx.Odometry()
    reports = [tracker.register(scan.points, time=scan.time) for scan in drive]
    assert [report.status for report in reports] == ["first"] + 11 * ["registered"]
    assert {report.piece for report in reports} == {0} and all(report.problem is None for report in reports)
    assert distances(np.array([report.pose for report in reports]), drive.true_poses).max() < 0.05
    information = reports[-1].information
    assert np.allclose(information, information.T) and np.linalg.eigvalsh(information).min() > 0
    # Errors grow along the way, and are as large as is said: within three standard deviations.
    sigma = np.array([np.sqrt(np.trace(report.covariance[:3, :3])) for report in reports])
    assert sigma[0] < sigma[-1] < 0.1
    errors = distances(np.array([report.pose for report in reports]), drive.true_poses)
    assert (errors[1:] < 3 * sigma[1:]).all()
    failed = tracker.register(np.zeros((5, 3)))
    assert failed.status == "failed" and failed.problem == "too few returns"


def test_a_folder_without_poses_has_a_trajectory_and_a_map(drive: vx.Simulation, tmp_path: Path) -> None:
    drive.write(tmp_path / "drive")
    data = vx.Dataset.open(tmp_path / "drive", slam=True)
    assert not data.has_poses and data.scan_count == 12 and next(iter(data)).pose is None
    assert "by odometry" in str(data) and "at" not in repr(next(iter(data)))
    seen: list[int] = []
    path = vx.odometry(tmp_path / "drive", progress=seen.append)
    assert len(seen) == len(path.times) == 12 and set(path.pieces) == {0}
    assert distances(path.poses, drive.true_poses).max() < 0.05
    path.save(tmp_path / "poses.tum")
    path.save(tmp_path / "poses.txt")
    rows = np.loadtxt(tmp_path / "poses.tum")
    assert rows.shape == (12, 8) and np.allclose(rows[:, 1:4], path.poses[:, :3, 3], atol=1e-8)
    assert np.allclose(np.loadtxt(tmp_path / "poses.txt").reshape(-1, 3, 4), path.poses[:, :3], atol=1e-8)

    replayed = vx.Mapper(voxel_size=0.1)
    assert replayed.replay(data) == 12
    handled = vx.Mapper(voxel_size=0.1)
    for event in data.events():
        handled.handle(event)
    direct = vx.Mapper(voxel_size=0.1)
    reports = [direct.integrate(scan.points, node=scan.node, time=scan.time) for scan in data]
    assert distances(np.array([report.pose for report in reports]), drive.true_poses).max() < 0.05
    meshes = [mapper.finish().mesh() for mapper in (replayed, handled, direct)]
    assert len(meshes[0]) > 1000
    assert all(np.array_equal(meshes[0].vertices, mesh.vertices) for mesh in meshes)


def test_scans_that_are_left_out_are_registered_all_the_same(drive: vx.Simulation, tmp_path: Path) -> None:
    drive.write(tmp_path / "drive")
    mapper = vx.Mapper(voxel_size=0.1)
    reports = [mapper.handle(event) for event in vx.Dataset.open(tmp_path / "drive", slam=True, every="1m").events()]
    taken = [report for report in reports if report is not None]
    assert len(reports) == 12 and 3 <= len(taken) <= 5
    assert distances(np.array([report.pose for report in taken]), drive.true_poses[[report.node for report in taken]]).max() < 0.05


def test_a_mapper_takes_scans_with_poses_or_without(drive: vx.Simulation) -> None:
    scan = drive[0]
    assert scan.pose is not None
    mapper = vx.Mapper(voxel_size=0.1)
    mapper.integrate(scan.points)
    with pytest.raises(vx.RefusedError, match="without poses, and this one has one"):
        mapper.integrate(scan.points, scan.pose)
    mapper = vx.Mapper(voxel_size=0.1)
    report = mapper.integrate(scan.points, scan.pose)
    assert np.allclose(report.pose, scan.pose)
    with pytest.raises(vx.RefusedError, match="with poses, and this one has none"):
        mapper.integrate(scan.points)
    mapper = vx.Mapper(voxel_size=0.1)
    with pytest.raises(vx.RefusedError, match="no usable return: all of its 50 points are zero or not finite"):
        mapper.integrate(np.zeros((50, 3)))


# Odometry that is off by a sixth of its path does not fit the scans, and that is said.
@pytest.mark.filterwarnings("ignore:the poses do not fit:voxelastic.RunWarning")
def test_loop_edges_that_are_given_correct_the_poses() -> None:
    drive = vx.Simulation("room", scans=30, spacing=2.0, columns=128, max_range=30, drift=5.0)
    maps = []
    for optimise in (False, True):
        mapper = vx.Mapper(voxel_size=0.2, optimise=optimise, loops=False, lambda_odom=5)
        for event in drive.events():
            if not isinstance(event, vx.PoseUpdate):
                mapper.handle(event)
        maps.append(mapper)
    assert moves_of(maps[0]) == 0 and moves_of(maps[1]) > 0


def moves_of(mapper: vx.Mapper) -> int:
    """Submaps that corrections have moved."""
    return int(repr(mapper).split(" moves")[0].split()[-1])


# Odometry that is off by a sixth of its path does not fit the scans, and that is said.
@pytest.mark.filterwarnings("ignore:the poses do not fit:voxelastic.RunWarning")
def test_the_information_of_edges_is_what_they_weigh() -> None:
    drive = vx.Simulation("room", scans=30, spacing=2.0, columns=128, max_range=30, drift=5.0)
    moves = []
    for information in (None, 1e-12 * np.eye(6)):
        mapper = vx.Mapper(voxel_size=0.2, optimise=True, loops=False, lambda_odom=5)
        for event in drive.events():
            if isinstance(event, vx.Edge) and event.closes_loop:
                mapper.add_loop_edge(event.first, event.second, event.pose, information=information)
            elif not isinstance(event, vx.PoseUpdate):
                mapper.handle(event)
        moves.append(moves_of(mapper))
    assert moves[0] > 3 * moves[1], moves
    for wrong in (np.eye(3), -np.eye(6), np.arange(36.0).reshape(6, 6), np.full((6, 6), np.nan)):
        with pytest.raises(ValueError, match="information"):
            mapper.add_loop_edge(0, 9, np.eye(4), information=wrong)


def test_scans_are_found_in_a_map(drive: vx.Simulation) -> None:
    mapper = vx.Mapper(voxel_size=0.05)
    for scan in list(drive)[::2]:
        mapper.handle(scan)
    localiser = vx.Localiser(mapper.finish())
    for scan in list(drive)[1::2]:
        found = localiser.locate(scan.points)
        assert found is not None and found.is_certain and found.overlap > 0.5 and scan.pose is not None
        assert np.linalg.norm(found.pose[:3, 3] - scan.pose[:3, 3]) < 0.1
        near = localiser.locate(scan.points, guess=scan.pose[:3, 3], within=5)
        assert near is not None and np.linalg.norm(near.pose[:3, 3] - scan.pose[:3, 3]) < 0.1
        assert 0 < found.spread < 0.1 and found.information is not None and found.covariance is not None
        np.testing.assert_allclose(found.covariance @ found.information, np.eye(6), atol=1e-5)
        # The error is not ten times what is expected.
        assert 1e-4 < np.sqrt(np.trace(found.covariance[:3, :3])) < 0.2
        others = found.alternatives
        assert all(np.linalg.norm(other.pose[:3, 3] - found.pose[:3, 3]) > 0.1 or not np.allclose(other.pose, found.pose, atol=0.1) for other in others)
        assert all(other.information is None and other.covariance is None and other.alternatives == [] for other in others)
    assert localiser.locate(drive[0].points, guess=[1000, 0, 0], within=2) is None
    assert localiser.locate(np.zeros((10, 3))) is None
    with pytest.raises(ValueError, match="within"):
        localiser.locate(drive[0].points, guess=[0, 0, 0], within=-1)
    with pytest.raises(ValueError, match="no surfaces"):
        vx.Localiser(vx.Mapper().finish())


def test_impossible_settings_of_the_odometry_are_refused() -> None:
    with pytest.raises(ValueError, match="voxel_size"):
        vx.Odometry(voxel_size=-1)
    with pytest.raises(ValueError, match="max_range"):
        vx.Odometry(max_range=float("nan"))
