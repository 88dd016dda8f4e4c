"""Sessions joined to one map: which of them meet, and one graph for all."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _arrays, _native
from ._store import Store
from ._tasks import FIRST_NODES, Record, recorded

LEAST_CLOSURES = 2
"""Closures that must agree for two sessions to be joined: one alone may be of places that only look alike."""
AGREE_METRES, AGREE_SHARE = 3.0, 0.05
"""How far two closures may be apart: metres, and a share of the path between them, which the odometry drifts along."""
OUTVOTED = 6.0
"""A closure that is so many times its standard deviation off after optimisation does not count."""
SIGMA = (0.1, np.deg2rad(0.5))
"""Standard deviation of a closure for that, metres and radians."""

Matrix = NDArray[np.float64]


def matrix(numbers: Iterable[float]) -> Matrix:
    """A pose x, y, z, qx, qy, qz, qw as a 4 x 4 matrix."""
    values = np.asarray(list(numbers), dtype=np.float64)
    return _arrays.matrix((values[:3], values[3:]))


def numbers(pose: Matrix) -> list[float]:
    """A 4 x 4 matrix as x, y, z, qx, qy, qz, qw."""
    return [float(c) for c in _arrays.pose(pose)]


@dataclass
class Track:
    """The nodes of a session in its own frame."""

    nodes: list[int]
    poses: dict[int, Matrix]
    path: dict[int, float]
    odometry: list[Any]
    loops: list[Any]

    @classmethod
    def read(cls, store: Store, name: str) -> Track:
        """Reads what `split` wrote."""
        stored = json.loads(store.read(name))
        nodes = [node for node, _, _ in stored["nodes"]]
        poses = {node: matrix(pose) for node, _, pose in stored["nodes"]}
        steps = [0.0] + [float(np.linalg.norm(poses[b][:3, 3] - poses[a][:3, 3])) for a, b in zip(nodes, nodes[1:])]
        return cls(nodes, poses, dict(zip(nodes, np.cumsum(steps))), stored["odometry"], stored["loops"])


def join(tracks: dict[int, Track], closures: dict[tuple[int, int], list[Any]]) -> tuple[dict[int, Matrix], list[tuple[int, int, list[Any]]]]:
    """The frames of the sessions that meet, by number, in that of the first one of the largest group; and for each pair that was joined the closures that agree.

    Sessions are joined one after the other, by the pair that most closures agree on.
    """
    agreed: dict[tuple[int, int], tuple[list[Any], Matrix]] = {}
    for (a, b), edges in sorted(closures.items()):
        if (found := consensus(tracks[a], tracks[b], edges)) is not None:
            agreed[a, b] = found
    best: tuple[dict[int, Matrix], list[tuple[int, int, list[Any]]]] = ({}, [])
    left = sorted(tracks)
    while left:
        frames, used = {left[0]: np.eye(4)}, []
        while True:
            outgoing = [(len(edges), -a, -b) for (a, b), (edges, _) in agreed.items() if (a in frames) != (b in frames)]
            if not outgoing:
                break
            _, a, b = max(outgoing)
            a, b = -a, -b
            t_a_b = agreed[a, b][1]
            if a in frames:
                frames[b] = frames[a] @ t_a_b
            else:
                frames[a] = frames[b] @ np.linalg.inv(t_a_b)
        used = [(a, b, edges) for (a, b), (edges, _) in sorted(agreed.items()) if a in frames and b in frames]
        left = [number for number in left if number not in frames]
        if len(frames) > len(best[0]):
            best = (frames, used)
    return best


def consensus(a: Track, b: Track, edges: list[Any]) -> tuple[list[Any], Matrix] | None:
    """The most closures between two sessions that agree, and the frame of the second in the first by their middle one; none if too few do."""
    claims = [(edge, a.poses[edge[0]] @ matrix(edge[2]) @ np.linalg.inv(b.poses[edge[1]])) for edge in edges]

    def agree(one: tuple[Any, Matrix], other: tuple[Any, Matrix]) -> bool:
        # What the second says of the first's place in the other session.
        place = b.poses[one[0][1]][:, 3]
        apart = float(np.linalg.norm((one[1] @ place)[:3] - (other[1] @ place)[:3]))
        path = max(abs(a.path[one[0][0]] - a.path[other[0][0]]), abs(b.path[one[0][1]] - b.path[other[0][1]]))
        return apart <= AGREE_METRES + AGREE_SHARE * path

    def is_elsewhere(one: tuple[Any, Matrix], other: tuple[Any, Matrix]) -> bool:
        return bool(one[0][1] != other[0][1])

    supporters = [[other for other in claims if agree(one, other)] for one in claims]
    supported = [all_ for one, all_ in zip(claims, supporters) if sum(is_elsewhere(one, other) for other in all_) + 1 >= LEAST_CLOSURES]
    if not supported:
        return None
    most = max(supported, key=len)
    chosen = claims[supporters.index(most)]
    return [edge for edge, _ in most], chosen[1]


def optimise(store: Store, task_key: str, tracks: dict[str, str], closures: dict[str, str]) -> Record:
    """One graph of all sessions that meet: corrected poses of all their nodes, in the frame of the first of them.

    Args:
        tracks: Names of the tracks by the number of the session.
        closures: Names of the closures by the numbers of two sessions, `0-1`.
    """

    def work() -> Record:
        all_tracks = {int(number): Track.read(store, name) for number, name in sorted(tracks.items(), key=lambda item: int(item[0]))}
        proposed = {tuple(int(n) for n in pair.split("-")): json.loads(store.read(name)) for pair, name in closures.items()}
        frames, used = join(all_tracks, {(a, b): edges for (a, b), edges in proposed.items()})
        joined = sorted(frames)
        nodes, start = [], []
        for number in joined:
            for node in all_tracks[number].nodes:
                nodes.append(node)
                start.append(numbers(frames[number] @ all_tracks[number].poses[node]))
        own = [tuple(edge) for number in joined for edge in all_tracks[number].odometry + all_tracks[number].loops]
        between = [tuple(edge) for _, _, edges in used for edge in edges]
        fixed = [all_tracks[joined[0]].nodes[0]] if joined else []
        outvoted: list[Any] = []
        solved, is_converged = _solve(nodes, start, own + between, fixed)
        for _ in range(4):
            kept = [edge for edge in between if _error(solved, edge) <= OUTVOTED]
            if len(kept) == len(between):
                break
            outvoted += [edge for edge in between if edge not in kept]
            between = kept
            solved, is_converged = _solve(nodes, start, own + between, fixed)
        pairs = [(edge[0] // FIRST_NODES, edge[1] // FIRST_NODES) for edge in between]
        return {
            "nodes": store.keep("poses", json.dumps(solved).encode()),
            "joined": joined,
            "closures": len(between),
            "outvoted": len(outvoted),
            "pairs": [[a, b, pairs.count((a, b))] for a, b in sorted(set(pairs))],
            "is_converged": is_converged,
        }

    return recorded(store, "optimise", task_key, work)


def _solve(nodes: list[int], start: list[list[float]], edges: list[Any], fixed: list[int]) -> tuple[dict[int, list[float]], bool]:
    poses, is_converged = _native.optimise_graph(list(zip(nodes, start)), edges, fixed)
    return dict(zip(nodes, [list(pose) for pose in poses])), is_converged


def _error(solved: dict[int, list[float]], edge: Any) -> float:
    """How far a closure is off, in standard deviations."""
    now = np.linalg.inv(matrix(solved[edge[0]])) @ matrix(solved[edge[1]])
    off = np.linalg.inv(matrix(edge[2])) @ now
    angle = np.arccos(np.clip((np.trace(off[:3, :3]) - 1) / 2, -1, 1))
    return float(max(np.linalg.norm(off[:3, 3]) / SIGMA[0], angle / SIGMA[1]))
