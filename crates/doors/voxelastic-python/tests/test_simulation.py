"""Simulated scans, and errors against the world."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import voxelastic as vx


@pytest.fixture(scope="module")
def sphere() -> vx.Simulation:
    return vx.Simulation("sphere", scans=3, columns=64, noise=0)


def test_scans_lie_on_the_surfaces_of_the_world(sphere: vx.Simulation) -> None:
    assert len(sphere) == 3 and "sphere" in vx.Simulation.worlds() and repr(sphere) == "Simulation('sphere', 3 scans)"
    for k, scan in enumerate(sphere):
        assert scan.node == k and scan.time == sphere.times[k] and scan.pose is not None and np.allclose(scan.pose, sphere.true_poses[k])
        points = scan.points.reshape(-1, 3)
        points = points[np.isfinite(points).all(axis=1) & (points != 0).any(axis=1)]
        in_map = points @ scan.pose[:3, :3].T + scan.pose[:3, 3]
        assert len(points) > 100 and np.abs(sphere.distance(in_map)).max() < 1e-3
    assert np.array_equal(sphere[-1].points, sphere[2].points, equal_nan=True)
    with pytest.raises(IndexError, match="3 scans"):
        sphere[3]
    surface = sphere.surface(0.5)
    assert surface.shape[1] == 3 and np.abs(sphere.distance(surface)).max() < 1e-3


def test_events_and_the_folder_are_those_of_a_slam_system(tmp_path: Path) -> None:
    drive = vx.Simulation("room", scans=30, spacing=2.0, columns=64)
    events = list(drive.events())
    kinds = [type(event).__name__ for event in events]
    assert kinds.count("Scan") == 30 and kinds.count("Edge") > 29 and kinds.count("PoseUpdate") == kinds.count("Edge") - 29
    assert np.allclose(drive.odometry_poses[0], drive.true_poses[0]) and not np.allclose(drive.odometry_poses[-1], drive.true_poses[-1])
    data = drive.write(tmp_path / "room")
    assert data.scan_count == 30 and data.has_poses
    assert np.array_equal(next(iter(data)).points, drive[0].points, equal_nan=True)
    with pytest.raises(vx.FileError):
        drive.write(tmp_path / "room")


def test_a_map_is_measured_against_the_world() -> None:
    drive = vx.Simulation("room", scans=10, spacing=0.5, columns=256, max_range=30)
    mapper = vx.Mapper(voxel_size=0.05)
    for scan in drive:
        mapper.handle(scan)
    map = mapper.finish()
    found = vx.evaluate(map, drive, max_range=20)
    assert found["accuracy_exact"]["median"] < 0.01 and found["completeness"]["median"] < 0.03 and found["alignment"] is None
    mesh = map.mesh()
    assert vx.evaluate(mesh, drive, max_range=20)["accuracy_exact"] == found["accuracy_exact"]
    # A survey of the same room that lies elsewhere is aligned.
    survey = drive.surface(0.05, max_range=20) + np.array([0.2, -0.1, 0.05], dtype=np.float32)
    aligned = vx.evaluate(mesh, survey)
    assert aligned["alignment"] is not None and aligned["accuracy"]["median"] < 0.05
    assert vx.evaluate(mesh, survey, align=False)["accuracy"]["median"] > aligned["accuracy"]["median"]
    # Distances to the mesh, of the world's surface and of what is beside it.
    points = np.array([[0, 0, 1e3], [np.nan, 0, 0]])
    assert mesh.distance(points, up_to=5)[0] == np.inf and np.isnan(mesh.distance(points)[1])
    assert np.median(mesh.distance(drive.surface(0.2, max_range=5))) < 0.03
    with pytest.raises(ValueError):
        vx.evaluate(np.zeros((0, 3)), drive)


def test_blocks_hold_the_distances_that_queries_interpolate() -> None:
    drive = vx.Simulation("plane", scans=3, columns=128, noise=0)
    mapper = vx.Mapper(voxel_size=0.1)
    for scan in drive:
        mapper.handle(scan)
    map = mapper.finish()
    submap = map.submaps[0]
    blocks = map.blocks(submap.id)
    assert {part.distance.shape[1:] for part in blocks} <= {(e, e, e) for e in (8, 4, 2, 1)} and len(blocks) > 1
    for part in blocks:
        edge = part.distance.shape[1]
        assert part.distance.shape == part.weight.shape == (len(part.coordinates), edge, edge, edge) and part.voxel_size == pytest.approx(0.8 / edge)
        assert np.array_equal(np.isnan(part.distance), part.weight == 0)
        block, z, y, x = (index[0] for index in np.nonzero(part.weight))
        centre = part.coordinates[block] * 0.1 + (np.array([x, y, z]) + 0.5) * part.voxel_size
        at = submap.pose[:3, :3] @ centre + submap.pose[:3, 3]
        assert map.query([at]).distance[0] == pytest.approx(part.distance[block, z, y, x], abs=0.05)
    with pytest.raises(ValueError, match="none with number 99"):
        map.blocks(99)


def test_trajectories_are_compared_after_a_fit() -> None:
    drive = vx.Simulation("room", scans=20, spacing=1.0, columns=64)
    truth = drive.true_poses
    moved = np.linalg.inv(truth[3]) @ truth
    assert vx.trajectory_errors(moved, truth).translation["max"] < 1e-6
    assert vx.trajectory_errors(moved, truth, fit="first").translation["max"] < 1e-6
    raw = vx.trajectory_errors(moved, truth, fit="none")
    assert raw.translation["max"] > 0.5 and len(raw.errors) == 20 and raw.errors.max() == pytest.approx(raw.translation["max"])
    drift = vx.trajectory_errors(drive.odometry_poses, truth)
    assert 0 < drift.translation["rmse"] < 1 and drift.path_length == pytest.approx(np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1).sum())
    with pytest.raises(ValueError, match="as many"):
        vx.trajectory_errors(moved[:5], truth)
    with pytest.raises(ValueError, match="shape"):
        vx.trajectory_errors(np.eye(4), truth)


def test_impossible_simulations_are_refused() -> None:
    with pytest.raises(ValueError, match="moon"):
        vx.Simulation("moon")
    with pytest.raises(ValueError, match="spacing"):
        vx.Simulation("room", spacing=-1)
    with pytest.raises(ValueError, match="sensor"):
        vx.Simulation("room", sensor="eyes")
