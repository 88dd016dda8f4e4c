"""Mistakes in a call: an exception that says what was expected."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import voxelastic as vx
from conftest import Scan

IDENTITY = np.eye(4)
POINTS = np.ones((5, 3), np.float32)


@pytest.mark.parametrize(
    ("points", "error", "message"),
    [
        (np.ones((5, 2)), ValueError, r"points: expected an array of shape \(N, 3\), or .*, not \(5, 2\)"),
        (np.ones(3), ValueError, r"not \(3,\)"),
        (np.ones((2, 2, 2, 3)), ValueError, r"not \(2, 2, 2, 3\)"),
        ([[1, 2, 3], [4, 5]], ValueError, "points: expected an array"),
        (np.ones((5, 3), complex), TypeError, "complex128"),
        (np.array([["a", "b", "c"]]), TypeError, "not an array of type <U1"),
        (None, TypeError, "not an array of type object"),
        # All scans at once, 2 GB.
        (np.broadcast_to(np.float32(1), (180_000_000, 3)), ValueError, "expected one scan, at most 134,217,728 points, not 180,000,000"),
    ],
)
def test_wrong_points_are_refused(points: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        vx.Mapper().integrate(points, IDENTITY)


@pytest.mark.parametrize("pose", [IDENTITY, None], ids=["posed", "without pose"])
@pytest.mark.parametrize(
    ("points", "why"),
    [
        (np.ones((0, 3)), "it has no points"),
        (np.ones((0, 360, 3)), "it has no points"),
        (np.full((32, 360, 3), np.nan), "all of its 11520 points are zero or not finite"),
        (np.zeros((7, 3)), "all of its 7 points are zero or not finite"),
    ],
)
def test_scans_without_returns_are_refused_in_the_same_words(points: Any, why: str, pose: Any, scans: list[Scan]) -> None:
    """As the first scan, from which the sensor is recognised, and later."""
    mapper = vx.Mapper(voxel_size=0.1, max_range=20)
    for node in range(2):
        with pytest.raises(vx.RefusedError, match=f"^the scan of node {node} has no usable return: {why}$"):
            mapper.integrate(points, pose, node=node)
        with pytest.raises(vx.RefusedError, match=f"^the scan of node {node} has no usable return: {why}$"):
            mapper.handle(vx.Scan(points, pose, node=node))
        if node == 0:
            mapper.integrate(scans[0][0], None if pose is None else scans[0][1], node=5)


def test_scans_without_returns_are_found_nowhere(room: vx.Map) -> None:
    for points in (np.ones((0, 3)), np.full((32, 360, 3), np.nan)):
        assert vx.Odometry().register(points).problem == "too few returns"
        assert vx.Localiser(room).locate(points) is None


def test_too_few_returns_are_refused_without_flags_of_the_command() -> None:
    with pytest.raises(vx.RefusedError, match="too few to recognise the sensor .*: name it by the setting `sensor`$"):
        vx.Mapper().integrate(5 * POINTS, IDENTITY)


@pytest.mark.parametrize("argument", ["points", "pose", "intensity", "times", "ring", "colours"])
def test_masks_are_refused(argument: str) -> None:
    """numpy would drop them, and what is masked would be mapped."""
    arguments: dict[str, Any] = {"points": POINTS, "pose": IDENTITY, "intensity": np.ones(5), "times": np.ones(5), "ring": np.ones(5), "colours": np.ones((5, 3))}
    arguments[argument] = np.ma.masked_array(arguments[argument])
    for take in (vx.Mapper().integrate, vx.Scan):
        with pytest.raises(TypeError, match=rf"{argument}: a masked array; .* `{argument}.filled\(np.nan\)`"):
            take(**arguments)


def test_intensities_of_returns_are_finite(scans: list[Scan]) -> None:
    points, pose = scans[0][0].copy(), scans[0][1]
    points[3, 5] = np.nan
    strengths = np.ones((32, 360))
    strengths[3, 5] = np.nan
    assert vx.Mapper(voxel_size=0.1).integrate(points, pose, intensity=strengths).returns == 32 * 360 - 1
    for wrong in (np.inf, -np.inf, np.nan, 1e300):
        strengths[7, 7] = wrong
        with pytest.raises(ValueError, match="intensity: 1 of 11,520 numbers are not finite as float32"):
            vx.Mapper(voxel_size=0.1).integrate(points, pose, intensity=strengths)


def test_edges_and_corrections_of_nodes_that_never_come_are_said(scans: list[Scan]) -> None:
    """They may come before the scan does, so that they are not refused at once."""
    mapper = vx.Mapper(voxel_size=0.1, max_range=20)
    mapper.add_loop_edge(0, 1, IDENTITY)
    for points, pose in scans[:2]:
        mapper.integrate(points, pose)
    mapper.add_loop_edge(0, 77, IDENTITY)
    mapper.update_poses({55: IDENTITY})
    with pytest.warns(vx.RunWarning, match="1 corrected poses and 1 edges refer to nodes without a scan") as said:
        mapper.finish()
    assert [warning.message.code for warning in said if isinstance(warning.message, vx.RunWarning)] == ["unknown-nodes"]


MIRROR = np.diag([1.0, 1, -1, 1])
SHEAR = IDENTITY + np.eye(4, k=1)


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        (np.eye(3), r"pose: expected a 4 x 4 or 3 x 4 matrix, or .*, not \(3, 3\)"),
        (np.full((4, 4), np.nan), "pose: a number is not finite"),
        (MIRROR, "not a rigid transform"),
        (SHEAR, "not a rigid transform"),
        (2 * IDENTITY, "not a rigid transform"),
        (([0, 0, 0], [0, 0, 0, 2]), "the norm of the quaternion is 2.000"),
        (([0, 0, 0], [0, 0, 0]), r"not shapes \(3,\) and \(3,\)"),
        (([0, 0, np.inf], [0, 0, 0, 1]), "not finite"),
    ],
)
def test_wrong_poses_are_refused(pose: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        vx.Mapper().integrate(POINTS, pose)


@pytest.mark.parametrize(
    ("channels", "message"),
    [
        ({"intensity": [1, 2]}, r"intensity: expected an array of 5 numbers, one for each point, not one of shape \(2,\)"),
        ({"ring": [0, 1, 2, 3, -1]}, "ring: expected whole numbers from 0 to 65535"),
        ({"ring": [0, 1, 2, 3, 0.5]}, "ring: expected whole numbers"),
        ({"ring": [0, 1, 2, 3, 65536]}, "from 0 to 65535"),
        ({"colours": np.full((5, 3), 0.5)}, "colours: expected whole numbers from 0 to 255"),
        ({"colours": np.zeros((5, 4))}, r"colours: expected an array of 5 x 3"),
        ({"times": np.zeros(4)}, "times: expected an array of 5"),
        ({"intensity": [1, 2, 3, 4, np.inf]}, "intensity: 1 of 5 numbers are not finite"),
        ({"node": -1}, "node: expected a whole number, 0 or more, not -1"),
        ({"node": 1.5}, "not 1.5"),
        ({"node": 2**64}, "expected a whole number"),
        ({"motion": [(0.0, IDENTITY)]}, "pass them as `times`"),
        ({"motion": [(0.0, IDENTITY)], "times": np.zeros(5)}, "motion: expected two poses or more"),
        ({"motion": [(0.0, IDENTITY), (0.1, np.eye(3))], "times": np.zeros(5)}, r"motion\[1\]: expected a 4 x 4 or 3 x 4 matrix"),
    ],
)
def test_wrong_channels_are_refused(channels: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        vx.Mapper().integrate(POINTS, IDENTITY, **channels)


def test_wrong_corrections_are_refused(scans: list[Scan]) -> None:
    mapper = vx.Mapper(voxel_size=0.1, max_range=20)
    mapper.integrate(*scans[0])
    with pytest.raises(TypeError, match="a dictionary of poses by node, not list"):
        mapper.update_poses([IDENTITY])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"poses\[0\]: the matrix is not a rigid transform"):
        mapper.update_poses({0: MIRROR})
    with pytest.raises(ValueError, match="a node of poses"):
        mapper.update_poses({-1: IDENTITY})
    np.testing.assert_allclose(mapper.finish().submaps[0].pose, scans[0][1])


@pytest.mark.parametrize(
    ("points", "error"),
    [(np.ones(3), ValueError), (np.ones((3, 2)), ValueError), (np.ones((1, 3), bool), TypeError), ("text", TypeError), ([[1, 2, 3], [1]], ValueError)],
)
def test_wrong_queries_are_refused(room: vx.Map, points: Any, error: type[Exception]) -> None:
    with pytest.raises(error, match="points: expected an array of shape"):
        room.query(points)


@pytest.mark.parametrize("arguments", [{"lod": 4}, {"lod": -1}, {"min_weight": float("nan")}, {"surface": "red"}])
def test_wrong_meshes_are_refused(room: vx.Map, arguments: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"{next(iter(arguments))}: expected"):
        room.mesh(**arguments)
