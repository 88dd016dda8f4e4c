"""Clouds and trajectories as files, as SLAM systems and data sets leave them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from recipe_bags import Fields, records
from recipe_world import Array, quaternion


def pcd(path: Path, fields: Fields, columns: dict[str, Any], *, height: int = 1) -> None:
    """A binary PCD file as PCL writes it: the fields one after the other, without the padding that they have in memory."""
    packed, step = [], 0
    for name, _, kind in fields:
        packed.append((name, step, kind))
        step += int(kind[1])
    count = len(columns["x"])
    lines = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS " + " ".join(name for name, _, _ in packed),
        "SIZE " + " ".join(kind[1] for _, _, kind in packed),
        "TYPE " + " ".join(kind[0].upper() for _, _, kind in packed),
        "COUNT " + " ".join("1" for _ in packed),
        f"WIDTH {count // height}",
        f"HEIGHT {height}",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {count}",
        "DATA binary",
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(("\n".join(lines) + "\n").encode() + records(packed, step, columns).tobytes())


def xyz(points: Array) -> dict[str, Any]:
    """Columns of the coordinates of N points."""
    return {"x": points[:, 0], "y": points[:, 1], "z": points[:, 2]}


XYZI: Fields = (("x", 0, "f4"), ("y", 4, "f4"), ("z", 8, "f4"), ("intensity", 12, "f4"))


def floats(path: Path, columns: Iterable[ArrayLike]) -> None:
    """Records of 32-bit floats without a header. Points without return are left out."""
    table = np.column_stack([np.asarray(column) for column in columns]).astype("<f4")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(table[np.isfinite(table).all(axis=1)].tobytes())


def kitti_rows(poses: Array) -> Array:
    """N x 12: the first three rows of each pose."""
    return poses[:, :3, :].reshape(len(poses), 12)


def tum_rows(times: Array, poses: Array) -> Array:
    """N x 8: time, position, quaternion."""
    return np.array([[time, *pose[:3, 3], *quaternion(pose[:3, :3])] for time, pose in zip(times, poses, strict=True)])


def matrix(pose: Array) -> str:
    """Four lines, as Eigen prints a matrix."""
    return "\n".join(" ".join(f"{value:11.6g}" for value in row) for row in pose)
