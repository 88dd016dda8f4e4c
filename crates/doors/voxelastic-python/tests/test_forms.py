"""Arrays, clouds and poses of other packages."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import voxelastic as vx
from conftest import pose_at, room_scans, scan_at


class Elsewhere:
    """An array that numpy does not know, with DLPack."""

    def __init__(self, array: NDArray[Any]) -> None:
        self.array = array

    def __dlpack__(self, **options: Any) -> Any:
        return self.array.__dlpack__(**options)

    def __dlpack_device__(self) -> Any:
        return self.array.__dlpack_device__()


class OnGraphicsCard(Elsewhere):
    def __dlpack__(self, **_: Any) -> Any:
        raise BufferError("cannot be exported from the device")


def legacy(points: NDArray[Any]) -> Any:
    """As a cloud of `open3d.geometry`."""
    return SimpleNamespace(points=points.reshape(-1, 3).tolist(), colors=[])


def tensors(points: NDArray[Any]) -> Any:
    """As a cloud of `open3d.t.geometry`."""
    return SimpleNamespace(point=SimpleNamespace(positions=SimpleNamespace(numpy=lambda: points.reshape(-1, 3))))


FORMS = [Elsewhere, legacy, tensors]


@pytest.mark.parametrize("form", FORMS)
def test_points_of_other_packages_are_points(form: Any, room: vx.Map) -> None:
    points, pose = room_scans(1)[0]
    flat, places = points.reshape(-1, 3), np.array([[3.98, 0.0, 0.0], [0.0, 0.0, 0.0]])
    meshes = []
    for cloud in (flat, form(flat)):
        mapper = vx.Mapper(voxel_size=0.1, max_range=20)
        mapper.integrate(cloud, pose)
        meshes.append(mapper.finish().mesh())
        assert vx.Odometry().register(cloud).status == "first"
    assert len(meshes[0]) > 1000
    np.testing.assert_array_equal(meshes[0].vertices, meshes[1].vertices)
    np.testing.assert_array_equal(room.distance(form(places)), room.distance(places))
    np.testing.assert_array_equal(room.mesh().distance(form(places)), room.mesh().distance(places))


def test_dlpack_is_taken_wherever_arrays_are(scans: list[tuple[NDArray[np.float32], NDArray[np.float64]]], room: vx.Map) -> None:
    points, pose = scans[0]
    times = np.zeros(points.size // 3, np.float32)
    given = {"intensity": times + 3, "times": times, "ring": np.repeat(np.arange(32, dtype=np.uint16), 360), "colours": np.ones((len(times), 3), np.uint8)}
    scan = vx.Scan(Elsewhere(points), Elsewhere(pose), **{name: Elsewhere(values) for name, values in given.items()})  # type: ignore[arg-type]
    np.testing.assert_array_equal(scan.points, points)
    np.testing.assert_allclose(scan.pose, pose, atol=1e-12)  # type: ignore[arg-type]
    for name, values in given.items():
        np.testing.assert_array_equal(getattr(scan, name), values)
    beams = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    np.testing.assert_array_equal(room.ray_cast(Elsewhere(np.zeros((1, 3))), Elsewhere(beams)).distance, room.ray_cast(np.zeros(3), beams).distance)


def test_arrays_on_a_graphics_card_are_refused() -> None:
    with pytest.raises(TypeError, match="points: the array of type OnGraphicsCard cannot be read here; copy it to the memory of the processor first"):
        vx.Mapper().integrate(OnGraphicsCard(np.ones((5, 3))), np.eye(4))


def test_a_scan_is_no_array() -> None:
    """Its pose would be dropped."""
    with pytest.raises(TypeError, match="points: expected an array, not a Scan; `Mapper.handle` takes scans"):
        vx.Mapper().integrate(vx.Scan(np.ones((5, 3)), np.eye(4)), np.eye(4))


def test_open3d_clouds_are_points() -> None:
    open3d = pytest.importorskip("open3d")
    points = scan_at(pose_at(0.4, -0.2, 2.5)).reshape(-1, 3)
    of_tensors = open3d.t.geometry.PointCloud(open3d.core.Tensor(points))
    for cloud in (of_tensors, of_tensors.to_legacy(), of_tensors.point.positions):
        np.testing.assert_array_equal(vx.Scan(cloud).points, points)


class Turned:
    """As a `scipy.spatial.transform.Rotation`."""

    def __init__(self, yaw: float) -> None:
        self.yaw = yaw

    def as_quat(self) -> list[float]:
        return [0.0, 0.0, float(np.sin(self.yaw / 2)), float(np.cos(self.yaw / 2))]

    def as_matrix(self) -> NDArray[np.float64]:
        return pose_at(0, 0, self.yaw)[:3, :3]


class Placed(Turned):
    """As a `scipy.spatial.transform.RigidTransform`."""

    translation = np.array([0.4, -0.2, 0.1])

    def as_matrix(self) -> NDArray[np.float64]:
        return pose_at(0.4, -0.2, self.yaw)


def pose_of(pose: Any) -> Any:
    return vx.Scan(np.ones((5, 3)), pose).pose


def test_rotations_stand_for_quaternions() -> None:
    expected, at = pose_at(0.4, -0.2, 2.5), [0.4, -0.2, 0.1]
    for pose in ((at, Turned(2.5)), (Turned(2.5), at), (np.array(at), Turned(2.5)), Placed(2.5)):
        np.testing.assert_allclose(pose_of(pose), expected, atol=1e-12)
    with pytest.raises(TypeError, match=r"pose: .*; a rotation alone does not say where: pass \(translation, rotation\)"):
        pose_of(Turned(2.5))
    with pytest.raises(ValueError, match="pose: expected"):
        pose_of((Turned(1), Turned(2)))


def test_rotations_of_scipy_are_poses() -> None:
    transform = pytest.importorskip("scipy.spatial.transform")
    rotation, at = transform.Rotation.from_euler("xyz", [0.1, -0.2, 2.5]), [0.4, -0.2, 0.1]
    expected = np.eye(4)
    expected[:3, :3], expected[:3, 3] = rotation.as_matrix(), at
    poses = [(at, rotation), (rotation, at)]
    if hasattr(transform, "RigidTransform"):
        poses.append(transform.RigidTransform.from_components(at, rotation))
    for pose in poses:
        np.testing.assert_allclose(pose_of(pose), expected, atol=1e-12)
