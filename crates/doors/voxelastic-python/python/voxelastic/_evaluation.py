"""How far maps and trajectories are from the truth."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _arrays, _native
from ._map import Map
from ._mesh import Mesh
from ._simulation import Simulation

__all__ = ["TrajectoryErrors", "evaluate", "trajectory_errors"]


def evaluate(
    surface: Union[Map, Mesh, ArrayLike],
    truth: Union[Simulation, ArrayLike],
    *,
    align: bool | None = None,
    max_range: float = 60.0,
    spacing: float = 0.05,
    thresholds: Sequence[float] = (0.05, 0.1, 0.2, 0.5),
) -> dict[str, Any]:
    """How accurate and how complete a surface is.

    Args:
        surface: A map (its mesh), a mesh, or N x 3 points.
        truth: A simulation, whose world is known exactly, or M x 3 points of a survey.
        align: Align the surface to the truth first; by default to points, and not to a simulation, whose frame maps have.
        max_range: Of a simulation: completeness counts what the sensor can see so far from its route, metres.
        spacing: The truth is thinned to one point per cube of this edge, metres.
        thresholds: Distances of the F-scores, metres.

    Returns:
        What `voxelastic eval --json` has under `surface`: `accuracy` and `completeness` (from the surface to the truth, and back) with `median`, `mean`, `p95` and
        so on in metres, `accuracy_exact` for a simulation, `f_scores`, and the `alignment`.

    Raises:
        ValueError: Surface and truth do not overlap, or one is empty.
    """
    if isinstance(surface, Map):
        surface = surface.mesh()
    if isinstance(surface, Mesh):
        points, triangles = surface.vertices, surface.triangles
    else:
        points, triangles = np.ascontiguousarray(_arrays.points(surface, "surface"), dtype=np.float32), None
    world = truth if isinstance(truth, Simulation) else None
    true_points = world.surface(spacing, max_range=max_range) if world else np.ascontiguousarray(_arrays.points(truth, "truth"), dtype=np.float32)
    aligned = (world is None) if align is None else align
    inner = None if world is None else world._inner
    text = _native.compare_surfaces(points, triangles, true_points, inner, bool(aligned), float(spacing), [float(t) for t in thresholds], 2**62)
    found: dict[str, Any] = json.loads(text)
    return found


class TrajectoryErrors(NamedTuple):
    """Absolute errors of a trajectory."""

    translation: dict[str, float]
    """Statistics of the distances between positions, metres: `rmse`, `mean`, `median`, `max` and so on."""
    rotation: dict[str, float]
    """The same of the angles between orientations, degrees."""
    errors: NDArray[np.float64]
    """N distances between positions, metres."""
    path_length: float
    """Length of the true path, metres."""


def trajectory_errors(estimate: ArrayLike, truth: ArrayLike, *, fit: Literal["rigid", "first", "none"] = "rigid") -> TrajectoryErrors:
    """Absolute errors (ATE) of N poses.

    Args:
        estimate: N x 4 x 4 poses.
        truth: N x 4 x 4 true poses of the same moments.
        fit: How the estimate is aligned first: by the best rigid motion, by its first pose, or not at all.

    Raises:
        ValueError: An array has another shape, or there are fewer than three poses for a rigid fit.
    """
    if fit not in ("rigid", "first", "none"):
        raise ValueError(f'fit: expected "rigid", "first" or "none", not {fit!r}')
    lists = []
    for value, name in ((truth, "truth"), (estimate, "estimate")):
        array = np.asarray(value)
        if array.ndim != 3 or array.shape[1:] != (4, 4):
            raise ValueError(f"{name}: expected an array of shape (N, 4, 4), not {array.shape}")
        lists.append([_arrays.pose(pose, f"{name}[{k}]") for k, pose in enumerate(array)])
    if len(lists[0]) != len(lists[1]):
        raise ValueError(f"estimate: expected as many poses as truth, which are {len(lists[0])}, not {len(lists[1])}")
    text, errors = _native.trajectory_errors(lists[0], lists[1], fit)
    found = json.loads(text)
    return TrajectoryErrors(found["translation_m"], found["rotation_deg"], errors, found["path_m"])
