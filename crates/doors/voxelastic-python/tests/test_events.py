"""Scans as values: nothing that is handed in is ignored in silence."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import voxelastic as vx
from conftest import pose_at, room_scans, scan_at


@pytest.fixture(scope="module")
def swept() -> vx.Scan:
    """A scan with channels and the motion during the sweep."""
    rows, columns = 32, 360
    places = [pose_at(-0.5 + 0.5 * k / columns, 0, 0) for k in range(columns)]
    points = np.stack([scan_at(place)[:, k] for k, place in enumerate(places)], axis=1)
    times = np.tile(np.arange(columns) / columns * 0.1, rows)
    motion: list[tuple[float, vx.Pose]] = [(0.0, np.eye(4)), (0.1, ([0.5, 0, 0], [0, 0, 0, 1]))]
    scan = vx.Scan(points, places[0], node=1, time=2.5, intensity=np.arange(rows * columns) % 200, ring=np.repeat(np.arange(rows), columns), times=times, motion=motion)
    undistorted = scan.undistorted()
    assert undistorted is not None and undistorted.points[0, -1, 0] > scan.points[0, -1, 0] + 0.4
    return scan


def mapped(*scans: vx.Scan) -> vx.Map:
    mapper = vx.Mapper(voxel_size=0.1, max_range=20)
    for scan in scans:
        mapper.handle(scan)
    return mapper.finish()


def assert_same(one: vx.Map, other: vx.Map) -> None:
    meshes = one.mesh(), other.mesh()
    assert len(meshes[0]) > 1000
    np.testing.assert_array_equal(meshes[0].vertices, meshes[1].vertices)


@pytest.mark.parametrize("name", ["pose", "points", "node", "time", "times", "intensity", "anything"])
def test_attributes_cannot_be_set(swept: vx.Scan, name: str) -> None:
    with pytest.raises(AttributeError, match=rf"{name}: a scan does not change; `scan.replace\({name}=...\)`"):
        setattr(swept, name, np.eye(4))
    with pytest.raises(AttributeError):
        delattr(swept, name)


@pytest.mark.parametrize("name", ["pose", "points", "times", "ring", "intensity"])
def test_arrays_cannot_be_written_to(swept: vx.Scan, name: str) -> None:
    with pytest.raises(ValueError, match="read-only"):
        getattr(swept, name)[:] = 0


def test_what_is_replaced_is_mapped(swept: vx.Scan) -> None:
    shift = np.eye(4)
    shift[0, 3] = 5.0
    assert swept.pose is not None
    moved = mapped(swept.replace(pose=shift @ swept.pose))
    np.testing.assert_allclose(moved.submaps[0].pose, shift @ swept.pose, atol=1e-12)
    halved = swept.replace(points=np.where(swept.points[..., :1] > 0, swept.points, 0))
    assert len(mapped(halved).mesh()) < 0.8 * len(mapped(swept).mesh()) and halved.shape == swept.shape
    assert swept.replace(node=7, time=3.5).node == 7 and swept.replace(time=3.5).time == 3.5
    assert swept.replace(intensity=None).intensity is None
    with pytest.raises(vx.RefusedError, match="no usable return|too few"):
        mapped(swept.replace(points=np.zeros_like(swept.points)))


def test_what_is_not_replaced_stays_to_the_last_bit(swept: vx.Scan) -> None:
    """Also the motion during the sweep, without which the map would be another one."""
    same = swept.replace(node=swept.node)
    assert_same(mapped(swept), mapped(same))
    still = swept.replace(motion=None)
    assert mapped(still).mesh().vertices.shape != mapped(same).mesh().vertices.shape
    raw = swept.replace(pose=None)
    assert raw.pose is None and mapped(raw).submaps[0].nodes == [1]


def test_replacing_nonsense_is_refused(swept: vx.Scan) -> None:
    with pytest.raises(TypeError, match="replace: there is no colour; expected some of points, pose"):
        swept.replace(colour=1)
    with pytest.raises(ValueError, match=r"points: expected .*, as before, not 5; or with them intensity, ring, times, or None"):
        swept.replace(points=np.ones((5, 3)))
    with pytest.raises(ValueError, match="not a rigid transform"):
        swept.replace(pose=2 * np.eye(4))
    few = swept.replace(points=np.ones((5, 3)), intensity=None, ring=None, times=np.zeros(5))
    assert len(few) == 5 and few.times is not None and len(few.times) == 5


def test_a_scan_of_arrays_is_what_integrate_takes() -> None:
    by_arrays, numbered = (vx.Mapper(voxel_size=0.1, max_range=20) for _ in range(2))
    for k, (points, pose) in enumerate(room_scans(3)):
        strengths = np.arange(points.size // 3) % 200
        times = np.linspace(0, 0.1, points.size // 3)
        motion: list[tuple[float, vx.Pose]] = [(0.0, np.eye(4)), (0.1, pose_at(0.05, 0, 0.01))]
        first = by_arrays.integrate(points, pose, intensity=strengths, times=times, motion=motion)
        scan = vx.Scan(points, pose, intensity=strengths, times=times, motion=motion)
        assert scan.node is None and scan.time is None and scan.points.shape == points.shape and repr(scan).startswith("Scan(32 x 360 points, at ")
        second = numbered.handle(scan)
        assert second is not None and (first.node, first.returns) == (second.node, second.returns) == (k, first.returns)
    assert_same(by_arrays.finish(), numbered.finish())


def test_scans_of_arrays_without_poses_are_registered() -> None:
    mapper = vx.Mapper(voxel_size=0.1, max_range=20)
    reports = [mapper.handle(vx.Scan(scan_at(pose_at(-1 + 0.3 * k, 0, 0)), time=0.1 * k)) for k in range(4)]
    assert reports[-1] is not None
    np.testing.assert_allclose(reports[-1].pose[:3, 3], [0.9, 0, 0], atol=0.06)


def test_arrays_of_a_scan_are_copied() -> None:
    points, pose = room_scans(1)[0]
    whole = vx.Scan(points, pose)
    before = mapped(whole)
    points[:], pose[:] = 0, 0
    assert_same(before, mapped(whole))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"pose": np.eye(3)}, "pose: expected"),
        ({"node": -1}, "node: expected a whole number"),
        ({"time": float("nan")}, "time: expected seconds, not nan"),
        ({"intensity": [1.0]}, "intensity: expected an array of 4 numbers"),
        ({"motion": [(0.0, np.eye(4))]}, "pass them as `times`"),
    ],
)
def test_wrong_scans_are_refused(arguments: dict[str, Any], message: str) -> None:
    points: NDArray[np.float32] = np.ones((4, 3), np.float32)
    with pytest.raises(ValueError, match=message):
        vx.Scan(points, **arguments)
