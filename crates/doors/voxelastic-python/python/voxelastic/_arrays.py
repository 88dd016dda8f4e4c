"""What users pass as arrays and poses, as the arrays that the native part takes. Copies are made only where the memory does not fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Real
from typing import TYPE_CHECKING, Any, Optional, Protocol, TypeAlias, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from . import _native

Points: TypeAlias = Union[ArrayLike, "SupportsDLPack", "PointCloud", "TensorPointCloud"]
"""Coordinates of points, metres: anything of which numpy makes an array of the shape that is asked for; an array of another package by DLPack; or a cloud of Open3D, whose
coordinates are taken and nothing else."""

Pose: TypeAlias = Union[ArrayLike, "RigidTransform", tuple[ArrayLike, Union[ArrayLike, "Rotation"]], tuple["Rotation", ArrayLike]]
"""A rigid transform: a 4 x 4 matrix or its first three rows, or a translation (x, y, z) in metres with a unit quaternion (x, y, z, w). A `Rotation` of scipy may stand for
the quaternion, before or after the translation, and a `RigidTransform` of scipy for all."""


class SupportsDLPack(Protocol):
    """An array of any package."""

    def __dlpack__(self) -> Any: ...


class PointCloud(Protocol):
    """A cloud as `open3d.geometry.PointCloud` is one."""

    @property
    def points(self) -> Any:
        """N x 3 coordinates, metres."""


class TensorPointCloud(Protocol):
    """A cloud as `open3d.t.geometry.PointCloud` is one."""

    @property
    def point(self) -> Any:
        """N x 3 coordinates, metres, as `positions`, and more."""


class Rotation(Protocol):
    """A rotation as `scipy.spatial.transform.Rotation` is one."""

    def as_quat(self) -> Any:
        """The quaternion (x, y, z, w)."""


class RigidTransform(Protocol):
    """A pose as `scipy.spatial.transform.RigidTransform` is one."""

    def as_matrix(self) -> Any:
        """The 4 x 4 matrix."""


_IDENTITY_ERROR = 1e-3
_MOST_POINTS = 1 << 27


def _numeric(value: Any, name: str, expected: str) -> NDArray[Any]:
    """`value` as an array of numbers."""
    try:
        array = np.asarray(here(value, name))
    except ValueError as error:
        raise ValueError(f"{name}: expected {expected}: {error}") from None
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{name}: expected {expected}, not an array of type {array.dtype}")
    return array


def here(value: Any, name: str) -> Any:
    """What numpy can make an array of: arrays of other packages by DLPack, where numpy does not know them. Masks are refused: numpy drops them."""
    if isinstance(value, np.ma.MaskedArray):
        raise TypeError(f"{name}: a masked array; fill it with what stands for a value that is missing, as `{name}.filled(np.nan)`")
    if isinstance(value, np.ndarray) or not hasattr(value, "__dlpack__") or hasattr(value, "__array__"):
        return value
    try:
        return np.from_dlpack(value)
    except (BufferError, RuntimeError) as error:
        raise TypeError(f"{name}: the array of type {type(value).__name__} cannot be read here; copy it to the memory of the processor first: {error}") from None


def _coordinates(value: Any, name: str) -> Any:
    """The coordinates of a cloud of Open3D: of `geometry.PointCloud` or `t.geometry.PointCloud`; anything else as it is."""
    if type(value).__module__.partition(".")[0] == "voxelastic":
        raise TypeError(f"{name}: expected an array, not a {type(value).__name__}; `Mapper.handle` takes scans, and its `points` are an array")
    if isinstance(value, np.ndarray | Sequence) or hasattr(value, "__array__"):
        return value
    attributes: Any = getattr(value, "point", None)
    if hasattr(attributes, "positions"):
        return attributes.positions.numpy()
    return getattr(value, "points", value)


def points(value: Any, name: str = "points") -> NDArray[Any]:
    """N x 3 coordinates, C-contiguous, float32 or float64 as they are."""
    expected = "an array of shape (N, 3)"
    array = _numeric(_coordinates(value, name), name, expected)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name}: expected {expected}, not {array.shape}")
    kind = np.float32 if array.dtype.kind == "f" and array.dtype.itemsize <= 4 else np.float64
    return np.ascontiguousarray(array, dtype=kind)


def doubles(value: Any, name: str) -> NDArray[np.float64]:
    """N x 3 coordinates, C-contiguous, float64."""
    return np.ascontiguousarray(points(value, name), dtype=np.float64)


def matrix(value: Any, name: str = "pose") -> NDArray[np.float64]:
    """The 4 x 4 matrix of a pose."""
    x, y, z, qx, qy, qz, qw = pose(value, name)
    n = 2 / (qx * qx + qy * qy + qz * qz + qw * qw)
    return np.array(
        [
            [1 - n * (qy * qy + qz * qz), n * (qx * qy - qz * qw), n * (qx * qz + qy * qw), x],
            [n * (qx * qy + qz * qw), 1 - n * (qx * qx + qz * qz), n * (qy * qz - qx * qw), y],
            [n * (qx * qz - qy * qw), n * (qy * qz + qx * qw), 1 - n * (qx * qx + qy * qy), z],
            [0, 0, 0, 1],
        ]
    )


def cloud(value: Any) -> tuple[NDArray[np.float32], int]:
    """The points of a scan as N x 3 coordinates, and the number of its rows."""
    expected = "an array of shape (N, 3), or (rows, columns, 3) for an organised cloud"
    array = _numeric(_coordinates(value, "points"), "points", expected)
    if array.ndim not in (2, 3) or array.shape[-1] != 3:
        raise ValueError(f"points: expected {expected}, not {array.shape}")
    if array.size > 3 * _MOST_POINTS:
        raise ValueError(f"points: expected one scan, at most {_MOST_POINTS:,} points, not {array.size // 3:,}; integrate scans one by one, each with its pose")
    rows = array.shape[0] if array.ndim == 3 and array.size else 1
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(array, dtype=np.float32).reshape(-1, 3), rows


def channel(value: Any, name: str, count: int, dtype: type[np.generic]) -> NDArray[Any]:
    """One number for each of `count` points."""
    expected = f"an array of {count} numbers, one for each point"
    array = _numeric(value, name, expected)
    if array.size != count or array.ndim > 2:
        raise ValueError(f"{name}: expected {expected}, not one of shape {array.shape}")
    return _exact(array.reshape(-1), name, dtype)


def _colours(value: Any, count: int) -> NDArray[np.uint8]:
    """Red, green and blue for each of `count` points."""
    expected = f"an array of {count} x 3 whole numbers from 0 to 255"
    array = _numeric(value, "colours", expected)
    if array.size != 3 * count or array.shape[-1] != 3:
        raise ValueError(f"colours: expected {expected}, not one of shape {array.shape}")
    return _exact(array.reshape(-1, 3), "colours", np.uint8)


def _intensity(value: Any, cloud: NDArray[np.float32]) -> NDArray[np.float32]:
    """The strength of each return of `cloud`; that of a beam without return is not looked at."""
    array: NDArray[np.float32] = channel(value, "intensity", len(cloud), np.float32)
    wrong = ~np.isfinite(array)
    if wrong.any():
        wrong &= np.isfinite(cloud).all(axis=1) & cloud.any(axis=1)
        if count := np.count_nonzero(wrong):
            raise ValueError(f"intensity: {count:,} of {len(array):,} numbers are not finite as float32; expected strengths of returns, 0 where one is not known")
    return array


def channels(
    cloud: NDArray[np.float32], *, intensity: Any, colours: Any, ring: Any, times: Any, motion: Any
) -> _native._Channels:
    """What the points of `cloud` have beside coordinates."""
    if motion is not None and times is None:
        raise ValueError("motion: a scan is undistorted by the times of its points; pass them as `times`")
    return (
        None if intensity is None else _intensity(intensity, cloud),
        None if colours is None else _colours(colours, len(cloud)),
        None if ring is None else channel(ring, "ring", len(cloud), np.uint16),
        None if times is None else channel(times, "times", len(cloud), np.float32),
        None if motion is None else _motion(motion),
    )


def _exact(array: NDArray[Any], name: str, dtype: type[np.generic]) -> NDArray[Any]:
    """`array` in another type; whole numbers must fit."""
    if np.issubdtype(dtype, np.integer) and array.dtype != dtype:
        limits = np.iinfo(dtype)  # type: ignore[type-var]
        whole = array.dtype.kind in "iu" or bool(np.all(np.mod(array, 1) == 0))
        if array.size and not (whole and array.min() >= limits.min and array.max() <= limits.max):
            raise ValueError(f"{name}: expected whole numbers from {limits.min} to {limits.max}")
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(array, dtype=dtype)


def pose(value: Any, name: str = "pose") -> NDArray[np.float64]:
    """x, y, z, qx, qy, qz, qw of a pose."""
    expected = "a 4 x 4 or 3 x 4 matrix, or a translation (x, y, z) and a quaternion (x, y, z, w)"
    if isinstance(value, tuple) and len(value) == 2:
        parts = sorted(value, key=_is_rotation) if sum(map(_is_rotation, value)) == 1 else value
        translation, quaternion = (_numeric(part.as_quat() if _is_rotation(part) else part, name, expected).astype(np.float64) for part in parts)
        if translation.shape != (3,) or quaternion.shape != (4,):
            raise ValueError(f"{name}: expected {expected}, not shapes {translation.shape} and {quaternion.shape}")
        numbers = np.concatenate([translation, quaternion])
        _check_finite(numbers, name)
        norm = float(np.linalg.norm(quaternion))
        if abs(norm - 1) > 1e-2:
            raise ValueError(f"{name}: the norm of the quaternion is {norm:.3f}, but must be 1; the order is x, y, z, w")
        return numbers
    if _is_rotation(value):
        raise TypeError(f"{name}: expected {expected}; a rotation alone does not say where: pass (translation, rotation)")
    matrix = _numeric(value.as_matrix() if hasattr(value, "as_matrix") else value, name, expected).astype(np.float64)
    if matrix.shape == (3, 4):
        matrix = np.vstack([matrix, [0.0, 0.0, 0.0, 1.0]])
    if matrix.shape != (4, 4):
        raise ValueError(f"{name}: expected {expected}, not {matrix.shape}")
    _check_finite(matrix, name)
    rotation = matrix[:3, :3]
    is_rotation = np.abs(rotation @ rotation.T - np.eye(3)).max() < _IDENTITY_ERROR and np.linalg.det(rotation) > 0
    if not is_rotation or np.abs(matrix[3] - [0, 0, 0, 1]).max() > _IDENTITY_ERROR:
        raise ValueError(f"{name}: the matrix is not a rigid transform: the upper left 3 x 3 must be a rotation and the last row 0, 0, 0, 1")
    return np.concatenate([matrix[:3, 3], _quaternion(rotation)])


def _is_rotation(value: Any) -> bool:
    """Whether it is a rotation as `scipy.spatial.transform.Rotation` is one; a `RigidTransform` there is more than that."""
    return hasattr(value, "as_quat") and not hasattr(value, "translation")


def _check_finite(numbers: NDArray[np.float64], name: str) -> None:
    if not np.isfinite(numbers).all():
        raise ValueError(f"{name}: a number is not finite")


def _quaternion(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """x, y, z, w of the rotation nearest to a matrix: the eigenvector of a symmetric matrix (Bar-Itzhack 2000)."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    symmetric = np.array(
        [
            [a - e - i, d + b, g + c, h - f],
            [d + b, e - a - i, h + f, c - g],
            [g + c, h + f, i - a - e, d - b],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    quaternion: NDArray[np.float64] = np.linalg.eigh(symmetric)[1][:, -1]
    return quaternion


def information(value: Any, name: str = "information") -> Optional[NDArray[np.float64]]:
    """The upper triangle, row by row, of a 6 x 6 information matrix."""
    if value is None:
        return None
    expected = "a symmetric array of shape (6, 6) without negative variances"
    matrix = _exact(_numeric(value, name, expected), name, np.float64)
    if matrix.shape != (6, 6):
        raise ValueError(f"{name}: expected {expected}, not {matrix.shape}")
    _check_finite(matrix, name)
    if not np.allclose(matrix, matrix.T, rtol=1e-6) or (np.diag(matrix) < 0).any():
        raise ValueError(f"{name}: expected {expected}")
    return np.ascontiguousarray(matrix[np.triu_indices(6)])


def _motion(value: Any) -> tuple[list[float], list[NDArray[np.float64]]]:
    """Times and poses of a motion."""
    if not isinstance(value, Sequence) or any(not isinstance(sample, Sequence) or len(sample) != 2 for sample in value):
        raise TypeError("motion: expected a list of pairs of a time in seconds and a pose")
    return [float(time) for time, _ in value], [pose(sample, f"motion[{k}]") for k, (_, sample) in enumerate(value)]


def node(value: Any, name: str = "node") -> int:
    """The number of a node."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not 0 <= int(value) < 2**64:
        raise ValueError(f"{name}: expected a whole number, 0 or more, not {value!r}")
    return int(value)


def time(value: Any, name: str = "time") -> float:
    """A time stamp, seconds."""
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(float(value)):
        raise ValueError(f"{name}: expected seconds, not {value!r}")
    return float(value)
