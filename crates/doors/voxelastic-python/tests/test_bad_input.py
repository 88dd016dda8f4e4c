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
        (np.ones((0, 3)), ValueError, "the cloud is empty"),
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
