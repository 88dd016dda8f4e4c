"""Scans in, a map out."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np
import pytest

import voxelastic as vx
from conftest import Scan, pose_at, room_scans, scan_at, with_box


def test_a_scan_is_reported_and_counted(scans: list[Scan]) -> None:
    mapper = vx.Mapper(voxel_size=0.1, max_range=20)
    reports = [mapper.integrate(points, pose) for points, pose in scans]
    assert [report.node for report in reports] == list(range(8))
    assert reports[0].assignment == "new" and {report.assignment for report in reports[1:]} == {"continue"}
    assert all(report.submap == 0 and report.returns == 32 * 360 for report in reports)
    assert repr(mapper).startswith("Mapper(8 scans, 1 submaps, 0 fusions, 0 moves of submaps, voxels of 0.1 m, sensor: ")
    assert mapper.settings == vx.Settings(voxel_size=0.1, max_range=20)


def as_is(points: np.ndarray) -> np.ndarray:
    return points


def strided(points: np.ndarray) -> np.ndarray:
    wide = np.zeros((*points.shape[:-1], 7), points.dtype)
    wide[..., ::2][..., :3] = points
    return wide[..., :5:2]


@pytest.mark.parametrize(
    "form",
    [
        as_is,
        strided,
        lambda points: points.astype(np.float64),
        lambda points: points.astype(">f4"),
        lambda points: np.asfortranarray(points),
        lambda points: points[::-1].copy()[::-1],
        lambda points: points[:, ::-1].copy()[:, ::-1],
        lambda points: np.frombuffer(points.tobytes(), np.float32).reshape(points.shape),
        lambda points: points.tolist(),
    ],
    ids=["float32", "strided", "float64", "big-endian", "column-major", "negative rows", "negative columns", "read-only", "lists"],
)
def test_every_form_of_the_same_points_gives_the_same_map(form: Callable[[np.ndarray], object]) -> None:
    points, pose = room_scans(1)[0]
    meshes = []
    for cloud in (points, form(points)):
        mapper = vx.Mapper(voxel_size=0.1, max_range=20)
        mapper.integrate(cloud, pose)  # type: ignore[arg-type]
        meshes.append(mapper.finish().mesh())
    assert len(meshes[0]) > 1000
    np.testing.assert_array_equal(meshes[0].vertices, meshes[1].vertices)


def test_rings_say_what_rows_say() -> None:
    points, pose = room_scans(1)[0]
    rings = np.repeat(np.arange(32), 360)
    maps = []
    for cloud, ring in ((points, None), (points.reshape(-1, 3), rings)):
        mapper = vx.Mapper(voxel_size=0.1, max_range=20)
        assert mapper.integrate(cloud, pose, ring=ring).returns == 32 * 360
        maps.append(mapper.finish())
    assert abs(len(maps[0].mesh()) / len(maps[1].mesh()) - 1) < 0.05


def test_a_translation_with_a_quaternion_is_a_pose_too() -> None:
    points, _ = room_scans(1)[0]
    pose = pose_at(0.4, -0.2, 2.5)
    points = scan_at(pose)
    meshes = []
    for form in (pose, (pose[:3, 3], [0, 0, np.sin(1.25), np.cos(1.25)])):
        mapper = vx.Mapper(voxel_size=0.1, max_range=20)
        mapper.integrate(points, form)
        meshes.append(mapper.finish().mesh())
    np.testing.assert_allclose(meshes[0].vertices, meshes[1].vertices, atol=1e-4)


def test_intensity_and_colours_arrive_in_the_mesh(scans: list[Scan]) -> None:
    mapper = vx.Mapper(voxel_size=0.1, max_range=20)
    for points, pose in scans:
        count = points.size // 3
        # Floor and ceiling are told apart by brightness and colour.
        is_low = (points[..., 2] < 0).reshape(-1)
        colours = np.where(is_low[:, None], [250, 10, 10], [10, 10, 250])
        mapper.integrate(points, pose, intensity=np.where(is_low, 200.0, 20.0), colours=colours)
        assert count == len(colours)
    mesh = mapper.finish().mesh()
    assert mesh.intensity is not None and mesh.colours is not None and len(mesh.intensity) == len(mesh.colours) == len(mesh.vertices)
    floor, ceiling = mesh.vertices[:, 2] < -1.4, mesh.vertices[:, 2] > 1.4
    assert np.median(mesh.intensity[floor]) > np.median(mesh.intensity[ceiling])
    assert (np.median(mesh.colours[floor], axis=0) == [250, 10, 10]).all() and (np.median(mesh.colours[ceiling], axis=0) == [10, 10, 250]).all()


def test_a_moving_sensor_is_undistorted() -> None:
    """Each column is measured from another place; with times and motion the walls are straight again."""
    speed, sweep = 10.0, 0.1
    times = np.broadcast_to(np.arange(360) / 360 * sweep, (32, 360)).reshape(-1)
    points = np.stack([scan_at(pose_at(-0.5 + speed * t, 0, 0))[:, k] for k, t in enumerate(np.arange(360) / 360 * sweep)], axis=1)
    motion: list[tuple[float, vx.Pose]] = [(t, ([speed * t, 0, 0], [0, 0, 0, 1])) for t in np.linspace(0, sweep, 5)]
    errors = []
    for known in (None, motion):
        mapper = vx.Mapper(voxel_size=0.05, max_range=20)
        mapper.integrate(points, pose_at(-0.5, 0, 0), times=times, motion=known)
        vertices = mapper.finish().mesh().vertices
        walls = np.abs(vertices[np.abs(vertices[:, 2]) < 0.9][:, :2])
        errors.append(np.mean(np.abs(walls - [4, 3]).min(axis=1)))
    assert errors[1] < 0.005 and errors[0] > 0.05, errors


def test_corrections_and_loops_move_and_join_submaps(scans: list[Scan]) -> None:
    mapper = vx.Mapper(voxel_size=0.1, max_range=20, lambda_odom=0.5, min_overlap=1.0)
    for points, pose in scans:
        mapper.integrate(points, pose)
    before = mapper.snapshot()
    assert len(before.submaps) > 2
    shift = np.eye(4)
    shift[0, 3] = 5.0
    mapper.update_poses({node: shift @ pose for node, (_, pose) in enumerate(scans)})
    after = mapper.snapshot()
    for was, now in zip(before.submaps, after.submaps, strict=True):
        np.testing.assert_allclose(now.pose, shift @ was.pose, atol=1e-9)
        assert was.nodes == now.nodes
    np.testing.assert_allclose(before.submaps[0].pose, scans[0][1], atol=1e-9, err_msg="a snapshot does not change")
    mapper.add_odometry_edge(0, 1, np.linalg.inv(scans[0][1]) @ scans[1][1])
    mapper.add_loop_edge(0, 7, np.linalg.inv(scans[0][1]) @ scans[7][1])
    assert len(mapper.finish().submaps) < len(after.submaps)


def test_points_on_what_moves_are_offered() -> None:
    keeping, removing = (vx.Mapper(voxel_size=0.1, max_range=20, dynamic=dynamic) for dynamic in ("keep", "remove"))
    found = []
    for number, (points, pose) in enumerate(room_scans(12)):
        # It goes through the room from the seventh scan on, 1.4 m in front of a wall.
        low = np.array([1.5, -2.0 + 0.4 * number, -1.0])
        cloud = with_box(points, pose, low, low + [0.6, 0.6, 1.6]) if number > 6 else points
        for mapper in (keeping, removing):
            mapper.integrate(cloud, pose)
        moving = removing.moving_points()
        assert moving.dtype == np.float32 and moving.shape[1:] == (3,)
        assert np.all((moving > low - 0.05) & (moving < low + [0.65, 0.65, 1.65]))
        found.append(len(moving))
        assert len(keeping.moving_points()) == 0
    assert max(found[:7]) == 0 and min(found[8:]) > 50, found


def test_refused_events_leave_the_mapper_usable(scans: list[Scan]) -> None:
    mapper = vx.Mapper(voxel_size=0.1, max_range=20)
    points, pose = scans[0]
    mapper.integrate(points, pose)
    with pytest.raises(vx.RefusedError, match="node 0 has a scan already"):
        mapper.integrate(points, pose, node=0)
    with pytest.raises(vx.RefusedError, match="no usable return"):
        mapper.integrate(np.full((32, 360, 3), np.nan), pose)
    with pytest.raises(vx.RefusedError, match="to itself"):
        mapper.add_loop_edge(3, 3, pose)
    assert mapper.integrate(*scans[1]).node == 1
    assert mapper.finish().submaps[0].nodes == [0, 1]


def test_a_finished_mapper_says_so(scans: list[Scan]) -> None:
    mapper = vx.Mapper(voxel_size=0.1, max_range=20)
    mapper.integrate(*scans[0])
    mapper.finish()
    for use in (mapper.finish, mapper.snapshot, lambda: mapper.integrate(*scans[1])):
        with pytest.raises(RuntimeError, match="finished"):
            use()
    assert repr(mapper) == "Mapper(finished)"


def test_threads_take_turns(scans: list[Scan], make_map: Callable[..., vx.Map]) -> None:
    mapper = vx.Mapper(voxel_size=0.1, max_range=20)
    failures: list[BaseException] = []

    def work(first: int) -> None:
        try:
            for node in range(first, 8, 4):
                mapper.integrate(*scans[node], node=node)
                mapper.snapshot().mesh()
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=work, args=(first,)) for first in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert not failures and not any(thread.is_alive() for thread in threads)
    assert sorted(mapper.finish().submaps[0].nodes) == list(range(8))


def test_settings_are_the_same_for_any_number_of_threads(make_map: Callable[..., vx.Map]) -> None:
    one, two = make_map(threads=1), make_map(threads=2)
    np.testing.assert_array_equal(one.mesh().vertices, two.mesh().vertices)
