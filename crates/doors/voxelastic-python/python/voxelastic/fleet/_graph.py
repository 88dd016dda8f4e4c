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

    def parts(self) -> list[Track]:
        """Itself, or where odometry was lost the parts in between: how these lie to each other only closures can say."""
        linked = {frozenset(edge[:2]) for edge in self.odometry}
        parts: list[list[int]] = []
        for last, node in zip([None, *self.nodes], self.nodes):
            if last is None or frozenset((last, node)) not in linked:
                parts.append([])
            parts[-1].append(node)
        if len(parts) == 1:
            return [self]
        part_of = {node: k for k, part in enumerate(parts) for node in part}

        def inside(edges: list[Any], k: int) -> list[Any]:
            return [edge for edge in edges if part_of[edge[0]] == k and part_of[edge[1]] == k]

        return [
            Track(part, {n: self.poses[n] for n in part}, {n: self.path[n] for n in part}, inside(self.odometry, k), inside(self.loops, k))
            for k, part in enumerate(parts)
        ]


Part = tuple[int, int]
"""A session by its number, and a part of it by its place."""


def parted(tracks: dict[int, Track], closures: Iterable[Any]) -> tuple[dict[Part, Track], dict[tuple[Part, Part], list[Any]]]:
    """The parts of sessions between which odometry was lost, and the closures between two parts each, of different sessions or of one."""
    parts = {(number, k): part for number, track in tracks.items() for k, part in enumerate(track.parts())}
    part_of = {node: name for name, part in parts.items() for node in part.nodes}
    between: dict[tuple[Part, Part], list[Any]] = {}
    for edge in [*closures, *(edge for track in tracks.values() for edge in track.loops)]:
        a, b = part_of[edge[0]], part_of[edge[1]]
        if a != b:
            between.setdefault((a, b), []).append(edge)
    return parts, between


def join(tracks: dict[Part, Track], closures: dict[tuple[Part, Part], list[Any]]) -> tuple[dict[Part, Matrix], list[Any]]:
    """The frames of the parts that meet, in that of the first one of the largest group, which is that of most sessions and then of most nodes; and the
    closures that agree.

    Parts are joined one after the other, by the pair that most closures agree on.
    """
    agreed: dict[tuple[Part, Part], tuple[list[Any], Matrix]] = {}
    for (a, b), edges in sorted(closures.items()):
        if (found := consensus(tracks[a], tracks[b], edges)) is not None:
            agreed[a, b] = found
    best: tuple[dict[Part, Matrix], list[Any]] = ({}, [])

    def size(frames: dict[Part, Matrix]) -> tuple[int, int]:
        return len({number for number, _ in frames}), sum(len(tracks[part].nodes) for part in frames)

    left = sorted(tracks)
    while left:
        frames = {left[0]: np.eye(4)}
        while True:
            outgoing = [(-len(edges), a, b) for (a, b), (edges, _) in agreed.items() if (a in frames) != (b in frames)]
            if not outgoing:
                break
            _, a, b = min(outgoing)
            t_a_b = agreed[a, b][1]
            if a in frames:
                frames[b] = frames[a] @ t_a_b
            else:
                frames[a] = frames[b] @ np.linalg.inv(t_a_b)
        left = [part for part in left if part not in frames]
        if size(frames) > size(best[0]):
            best = (frames, [edge for (a, b), (edges, _) in sorted(agreed.items()) if a in frames and b in frames for edge in edges])
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
    """One graph of all sessions that meet: corrected poses of all their nodes, in the frame of the first of them. Where odometry was lost, what no closures hold has
    no pose.

    Args:
        tracks: Names of the tracks by the number of the session.
        closures: Names of the closures by the numbers of two sessions, `0-1`.
    """

    def work() -> Record:
        all_tracks = {int(number): Track.read(store, name) for number, name in sorted(tracks.items(), key=lambda item: int(item[0]))}
        proposed = [edge for _, name in sorted(closures.items()) for edge in json.loads(store.read(name))]
        parts, links = parted(all_tracks, proposed)
        frames, used = join(parts, links)
        nodes, start = [], []
        for part in sorted(frames):
            for node in parts[part].nodes:
                nodes.append(node)
                start.append(numbers(frames[part] @ parts[part].poses[node]))
        own = [tuple(edge) for part in sorted(frames) for edge in parts[part].odometry + parts[part].loops]
        between = [tuple(edge) for edge in used]
        fixed = nodes[:1]
        outvoted: list[Any] = []
        solved, is_converged = _solve(nodes, start, own + between, fixed)
        for _ in range(4):
            kept = [edge for edge in between if _error(solved, edge) <= OUTVOTED]
            if len(kept) == len(between):
                break
            outvoted += [edge for edge in between if edge not in kept]
            between = kept
            solved, is_converged = _solve(nodes, start, own + between, fixed)
        held = _held({part: parts[part] for part in frames}, between)
        solved = {node: solved[node] for part in held for node in parts[part].nodes}
        pairs = [(edge[0] // FIRST_NODES, edge[1] // FIRST_NODES) for edge in between if edge[0] in solved]
        pairs = [(a, b) for a, b in pairs if a != b]
        return {
            "nodes": store.keep("poses", json.dumps(solved).encode()),
            "joined": sorted({number for number, _ in held}),
            "lost": {str(number): len(track.parts()) - 1 for number, track in all_tracks.items() if len(track.parts()) > 1},
            "left_out": sorted({number for number, _ in held} & {number for number, _ in set(parts) - set(held)}),
            "closures": len(pairs),
            "outvoted": len(outvoted),
            "pairs": [[a, b, pairs.count((a, b))] for a, b in sorted(set(pairs))],
            "is_converged": is_converged,
        }

    return recorded(store, "optimise", task_key, work)


def _held(parts: dict[Part, Track], closures: list[Any]) -> list[Part]:
    """The parts that closures still hold, some of which may have been outvoted."""
    part_of = {node: name for name, part in parts.items() for node in part.nodes}
    links = [(part_of[edge[0]], part_of[edge[1]]) for edge in closures]
    held = set(sorted(parts)[:1])
    while more := {part for link in links if (link[0] in held) != (link[1] in held) for part in link} - held:
        held |= more
    return sorted(held)


def _solve(nodes: list[int], start: list[list[float]], edges: list[Any], fixed: list[int]) -> tuple[dict[int, list[float]], bool]:
    poses, is_converged = _native.optimise_graph(list(zip(nodes, start)), edges, fixed)
    return dict(zip(nodes, [list(pose) for pose in poses])), is_converged


def _error(solved: dict[int, list[float]], edge: Any) -> float:
    """How far a closure is off, in standard deviations."""
    now = np.linalg.inv(matrix(solved[edge[0]])) @ matrix(solved[edge[1]])
    off = np.linalg.inv(matrix(edge[2])) @ now
    angle = np.arccos(np.clip((np.trace(off[:3, :3]) - 1) / 2, -1, 1))
    return float(max(np.linalg.norm(off[:3, 3]) / SIGMA[0], angle / SIGMA[1]))
