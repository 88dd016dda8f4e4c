"""One map of many sessions."""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .. import _native
from .._settings import Settings
from ._graph import Track, consensus, matrix, optimise
from ._report import FleetReport, SessionReport
from ._runner import Runner, Task
from ._store import Store, StoreError
from ._tasks import FIRST_NODES, FIRST_SUBMAPS, MAP, SUBMAPS_OF_PIECE, TILES, Record, assemble, close, finish_tiles, integrate, key, probe, split, tiles

STATE = "fleet.json"
HELD = (0.02, np.deg2rad(0.1))
"""A submap that a later run would move by less, metres and radians, stays: what is made of it need not be made again."""
UNITS = {0.3048: "feet", 0.0254: "inches", 0.01: "centimetres", 0.001: "millimetres", 1000.0: "kilometres"}
"""Units that sessions are tried in that meet no other, by their length in metres."""


@dataclass(frozen=True)
class Session:
    """A recording or a folder, at a path or URL."""

    url: str
    """The path, or a URL that fsspec knows, such as `s3://drives/monday`."""
    scale: float = 1.0
    """What its lengths are multiplied by: for one in other units than metres."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of the fsspec file system of the URL."""
    open: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of `Dataset.open`."""


@dataclass
class _Split:
    """A session that could be split."""

    session: Record
    record: Record


def map(  # noqa: A001
    sessions: Iterable[str | os.PathLike[str] | Session],
    store: str | os.PathLike[str] | Store,
    client: Any = None,
    *,
    settings: Settings | None = None,
    tile_level: int = 3,
    title: str = "map",
    progress: Callable[[str, int, int], object] | None = None,
) -> FleetReport:
    """Makes one map of many sessions. Each may have a frame of its own, and none needs poses.

    Sessions are cut into pieces that make a submap each; places that two sessions share join them; one graph corrects all poses; then the surface is fused region
    by region, as tiles. Arrays go through the store. What a run has done, later runs find there: one that was killed goes on, a new session or corrected poses
    cost what depends on them. The result does not depend on the number of workers.

    Args:
        sessions: Recordings and folders, as paths, URLs, or `Session`s. The map has the frame of the first one of those that meet. Later runs may add some at the end.
        store: A folder, a URL that fsspec knows, or a `Store`. It gets `map.vox` (the map), `tiles` (3D Tiles and a page), `fleet.json` and `fleet.html` (the report).
        client: A `distributed.Client`; none to do everything in this process.
        settings: Settings of the mapper.
        tile_level: Size of the regions: cubes with edges of 128 voxels, doubled so many times. A task holds the submaps that reach into one region.
        title: Name of the map in the page.
        progress: Called with the name of the stage, how many of its tasks are done, and how many there are.

    Returns:
        What became of each session, and what it took. Sessions that cannot be used are named there; the others are mapped.

    Raises:
        ValueError: No session can be used.
        StoreError: The store cannot be written.
        ManifestError: Another fleet writes to the store.
    """
    fleet = _Fleet(Store(os.fspath(store)) if not isinstance(store, Store) else store, Runner(client, progress), settings or Settings(), tile_level, title)
    return fleet.map([session if isinstance(session, Session) else Session(os.fspath(session)) for session in sessions])


class _Fleet:
    def __init__(self, store: Store, runner: Runner, settings: Settings, tile_level: int, title: str) -> None:
        self.store, self.runner, self.settings, self.tile_level, self.title = store, runner, settings, tile_level, title
        self.state_hash = store.hash(STATE)
        self.state: Record = store.read_json(STATE) or {}
        self.report = FleetReport(str(store.url), title)

    def map(self, sessions: Sequence[Session]) -> FleetReport:
        if not sessions:
            raise ValueError("sessions: there is none")
        numbered = self._numbered(sessions)
        splits = self._split(numbered)
        closures = self._close(splits)
        solved = self._optimise(splits, closures)
        self._name_others(splits, solved)
        # The map is in the frame of the first session of those that meet.
        self.origin = next((list(one.record["origin"]) for one in splits if one.session["number"] in solved["joined"]), [0.0, 0.0, 0.0])
        self.report.origin_m = self.origin
        nodes = json.loads(self.store.read(solved["nodes"]))
        submaps = self._integrate(self._held(splits, nodes))
        poses = self._settled({str(submap["id"]): nodes[str(submap["root"])] for submap in submaps})
        manifest = self._assemble(submaps, poses)
        files = self._tiles(submaps, poses)
        self._save(numbered, solved, poses, manifest, files)
        return self.report

    def _numbered(self, sessions: Sequence[Session]) -> list[Record]:
        """The sessions with numbers that they keep in later runs."""
        known: dict[str, int] = self.state.get("numbers", {})
        records: list[Record] = []
        for session in sessions:
            name = session.url if session.scale == 1.0 else f"{session.url} x {session.scale}"
            known.setdefault(name, len(known))
            record = {"url": session.url, "options": dict(session.options), "open": dict(session.open), "scale": session.scale}
            records.append(record | {"number": known[name], "name": name})
            self.report.sessions.append(SessionReport(name, known[name]))
        if len({record["number"] for record in records}) != len(records):
            raise ValueError("sessions: one comes twice")
        self.state["numbers"] = known
        return records

    def _one(self, stage: str, task: Task) -> Record:
        """A task that nothing goes on without."""
        (record,) = self.runner.run(stage, [task])
        if "problem" in record:
            raise OSError(f"{self.store.url}: {stage}: {record['problem']}")
        return record

    def _refuse(self, number: int, state: str, problem: str) -> None:
        session = next(session for session in self.report.sessions if session.number == number)
        session.state, session.problem = state, problem

    def _split(self, sessions: Sequence[Record]) -> list[_Split]:
        probed = self.runner.run("probe", [Task(key("probe-session", session), probe, (self.store, session)) for session in sessions])
        readable = []
        _raise_if_of_store(probed)
        for session, record in zip(sessions, probed):
            if "problem" in record:
                self._refuse(session["number"], "unreadable", record["problem"])
            else:
                readable.append((session, record))
        if not readable:
            raise ValueError(f"no session can be read: {self.report.sessions[0].problem}")
        # Places are compared in voxels of one size. A map that grows keeps that of its beginning.
        self.voxel = self.state.setdefault("place_voxel", readable[0][1]["voxel"] * readable[0][0]["scale"])
        self.probed = {session["number"]: record for session, record in readable}
        records = self.runner.run("split", [self._split_task(session) for session, _ in readable])
        splits = []
        _raise_if_of_store(records)
        for (session, _), record in zip(readable, records):
            if "problem" in record:
                self._refuse(session["number"], "unreadable", record["problem"])
                continue
            report = next(r for r in self.report.sessions if r.number == session["number"])
            report.scans, report.pieces, report.skipped = record["nodes"], len(record["pieces"]), record["skipped"]
            splits.append(_Split(session, record))
        if not splits:
            raise ValueError(f"no session can be used: {self.report.sessions[0].problem}")
        return splits

    def _split_task(self, session: Record) -> Task:
        files = self.probed[session["number"]]["fingerprint"]
        metres = 0.95 * self.settings.lambda_odom
        task_key = key("split", files, session["open"], session["scale"], session["number"], metres, self.voxel)
        return Task(task_key, split, (self.store, session, task_key, metres, self.voxel))

    def _close(self, splits: Sequence[_Split]) -> dict[str, str]:
        """Names of the closures between each two sessions that have any."""
        pairs = list(itertools.combinations(splits, 2))
        records = self.runner.run("close", [self._close_task(a, b) for a, b in pairs])
        found = {}
        for (a, b), record in zip(pairs, records):
            if "problem" in record:
                raise OSError(f"{self.store.url}: closures of {a.session['name']} and {b.session['name']}: {record['problem']}")
            self.report.tried += record["tried"]
            if record["accepted"]:
                found[f"{a.session['number']}-{b.session['number']}"] = record["closures"]
        return found

    def _close_task(self, a: _Split, b: _Split) -> Task:
        sides = [{name: one.record[name] for name in ("places", "descriptors")} for one in (a, b)]
        task_key = key("close", sides)
        return Task(task_key, close, (self.store, task_key, *sides))

    def _held(self, splits: Sequence[_Split], nodes: Record) -> list[tuple[_Split, int]]:
        """The pieces that have poses, each with its number in its session. Says which have none, of sessions that others are joined with."""
        held = []
        for one in splits:
            session = next(session for session in self.report.sessions if session.number == one.session["number"])
            node = one.session["number"] * FIRST_NODES
            for number, piece in enumerate(one.record["pieces"]):
                if str(node) in nodes:
                    held.append((one, number))
                elif session.state == "joined in part":
                    session.pieces_left_out += 1
                    session.scans_left_out += piece["scans"]
                # A piece ends where odometry is lost.
                node += piece["scans"]
            if session.pieces_left_out:
                session.problem = (
                    f"its odometry was lost {_times(session.lost)}; {session.pieces_left_out} of its {session.pieces} pieces ({session.scans_left_out} of "
                    f"{session.scans} scans) are not in the map, since no two closures hold them: give it poses, or scans that are nearer to each other"
                )
        return held

    def _integrate(self, pieces: Sequence[tuple[_Split, int]]) -> list[Record]:
        """The submaps, each with the name of the manifest that has it, by number."""
        settings = self.settings.as_text()
        tasks, sources = [], []
        for one, number in pieces:
            piece = one.record["pieces"][number]
            first, origin = one.session["number"] * FIRST_SUBMAPS + number * SUBMAPS_OF_PIECE, one.record["origin"]
            task_key = key("integrate", piece["name"], first, settings, origin)
            tasks.append(Task(task_key, integrate, (self.store, task_key, piece["name"], first, settings, origin)))
            sources.append(one.session)
        submaps = []
        for session, record in zip(sources, self.runner.run("integrate", tasks)):
            if "problem" in record:
                self._refuse(session["number"], "incomplete", record["problem"])
                continue
            submaps += [submap | {"manifest": record["manifest"]} for submap in record["submaps"] if submap["root"] is not None]
        return submaps

    def _optimise(self, splits: Sequence[_Split], closures: dict[str, str]) -> Record:
        tracks = {str(one.session["number"]): str(one.record["track"]) for one in splits}
        task_key = key("optimise", "parts", sorted(tracks.items()), sorted(closures.items()))
        return self._one("optimise", Task(task_key, optimise, (self.store, task_key, tracks, closures)))

    def _name_others(self, splits: Sequence[_Split], solved: Record) -> None:
        """Says why sessions are not in the map: in another scale, or nowhere near the others."""
        joined = [one for one in splits if one.session["number"] in solved["joined"]]
        for session in self.report.sessions:
            if session.number in solved["joined"]:
                session.lost = solved["lost"].get(str(session.number), 0)
                session.state = session.state or ("joined in part" if session.number in solved["left_out"] else "joined")
        for one in splits:
            number = one.session["number"]
            if number in solved["joined"]:
                continue
            unit = self._unit(one, joined)
            if unit is None:
                self._refuse(number, "meets no other", "no two places of it were found in the sessions that are joined")
            else:
                problem = f"its lengths times {unit} fit those of the others: it seems to be in {UNITS[unit]}; give it as Session(url, scale={unit})"
                self._refuse(number, "in another scale", problem)

    def _unit(self, one: _Split, joined: Sequence[_Split]) -> float | None:
        """The unit in which a session meets another one."""
        reach = [self.probed[side.session["number"]]["reach"] * side.session["scale"] for side in (one, joined[0])]
        for unit in UNITS:
            # Only if its scans would then reach about as far as those of the others.
            if not 0.4 < unit * reach[0] / reach[1] < 2.5:
                continue
            session = one.session | {"scale": one.session["scale"] * unit}
            task = self._split_task(session)
            (record,) = self.runner.run("split", [task])
            if "problem" in record:
                continue
            rescaled = _Split(session, record)
            for other, found in zip(joined, self.runner.run("close", [self._close_task(other, rescaled) for other in joined])):
                if found.get("accepted", 0) == 0:
                    continue
                edges = json.loads(self.store.read(found["closures"]))
                tracks = [Track.read(self.store, side.record["track"]) for side in (other, rescaled)]
                if consensus(tracks[0], tracks[1], edges) is not None:
                    return unit
        return None

    def _settled(self, poses: dict[str, list[float]]) -> dict[str, list[float]]:
        """The new poses, but the old ones of submaps that hardly moved."""
        before = self.state.get("poses", {})
        settled = {}
        for number, pose in poses.items():
            old = before.get(number)
            if old is not None:
                off = np.linalg.inv(matrix(old)) @ matrix(pose)
                angle = np.arccos(np.clip((np.trace(off[:3, :3]) - 1) / 2, -1, 1))
                if np.linalg.norm(off[:3, 3]) <= HELD[0] and angle <= HELD[1]:
                    settled[number] = old
                    continue
                self.report.moved += 1
            settled[number] = pose
        self.report.submaps = len(settled)
        return settled

    def _assemble(self, submaps: Sequence[Record], poses: dict[str, list[float]]) -> str:
        manifests = sorted({submap["manifest"] for submap in submaps if str(submap["id"]) in poses})
        task_key = key("assemble", manifests, sorted(poses.items()), self.origin)
        settled = self.store.keep("poses", json.dumps(poses).encode())
        record = self._one("assemble", Task(task_key, assemble, (self.store, task_key, manifests, settled, self.origin)))
        return str(record["manifest"])

    def _tiles(self, submaps: Sequence[Record], poses: dict[str, list[float]]) -> list[str]:
        """Makes the tiles of all regions. Returns the names of their files."""
        voxel = float(self.settings.voxel_size)
        regions: dict[tuple[int, ...], list[Record]] = {}
        heights = [np.inf, -np.inf]
        for submap in submaps:
            pose = poses.get(str(submap["id"]))
            if pose is None:
                continue
            t_map_submap = matrix(pose)
            corners = np.array(list(itertools.product(*zip(submap["low"], submap["high"]))))
            corners = corners @ t_map_submap[:3, :3].T + t_map_submap[:3, 3]
            heights = [min(heights[0], t_map_submap[2, 3] + submap["heights"][0]), max(heights[1], t_map_submap[2, 3] + submap["heights"][1])]
            cells = _native.cells_of_box(corners.min(axis=0).tolist(), corners.max(axis=0).tolist(), voxel, self.tile_level)
            for coordinates in cells:
                regions.setdefault(tuple(coordinates), []).append(submap)
        if not regions:
            return []
        heights = [float(np.floor(heights[0])), float(np.ceil(heights[1]))]
        # Colours are those of the first map that lacks nothing, or all tiles would have to be made again.
        is_whole = all(session.state != "incomplete" for session in self.report.sessions)
        heights = self.state.setdefault("heights", heights) if is_whole else self.state.get("heights", heights)
        tasks = []
        for cell, inside in sorted(regions.items(), key=lambda item: _morton(item[0])):
            region = {
                "level": self.tile_level,
                "cell": list(cell),
                "heights": heights,
                "poses": {str(submap["id"]): poses[str(submap["id"])] for submap in inside},
                "manifests": sorted({submap["manifest"] for submap in inside}),
            }
            task_key = key("tiles", region, [submap["file"] for submap in inside])
            tasks.append(Task(task_key, tiles, (self.store, task_key, region)))
        records = self.runner.run("tiles", tasks)
        self.report.regions_failed = [record["problem"] for record in records if "problem" in record]
        parts = [record["part"] for record in records if record.get("part")]
        if not parts:
            return []
        task_key = key("finish-tiles", parts, voxel, self.title, self.origin)
        upper = self._one("finish", Task(task_key, finish_tiles, (self.store, task_key, parts, voxel, self.title, self.origin)))
        return sorted({name for record in [*records, upper] for name in record.get("files", [])})

    def _save(self, sessions: Sequence[Record], solved: Record, poses: dict[str, list[float]], manifest: str, files: list[str]) -> None:
        """Replaces what readers begin with, and removes tiles that are no longer needed."""
        report = self.report
        report.closures, report.outvoted, report.pairs = solved["closures"], solved["outvoted"], solved["pairs"]
        report.node_poses, report.tiles = solved["nodes"], len(files)
        report.stages = list(self.runner.stages.values())
        old = self.state.get("files", [])
        self.state |= {"format": "voxelastic fleet", "version": 1, "poses": poses, "files": files, "report": report.as_json()}
        self.store.write(f"{MAP}/manifest.json", self.store.read(manifest))
        self.store.write("fleet.html", report.html().encode())
        self.store.replace(STATE, json.dumps(self.state, sort_keys=True, indent=1).encode(), self.state_hash)
        for name in sorted(set(old) - set(files)):
            self.store.remove(f"{TILES}/content/{name}")


def _raise_if_of_store(records: Iterable[Record]) -> None:
    """A store that cannot be written is no fault of the sessions."""
    for record in records:
        if record.get("is_of_store"):
            raise StoreError(record["problem"].removeprefix("StoreError: "))


def _times(number: int) -> str:
    return "once" if number == 1 else f"{number} times"


def _morton(cell: tuple[int, ...]) -> int:
    """Place of a cell in the order in which tiles are joined."""
    return sum((c >> bit & 1) << (3 * bit + axis) for axis, c in enumerate(cell) for bit in range(21))
