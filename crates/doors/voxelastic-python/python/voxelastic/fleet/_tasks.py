"""The tasks of a fleet: functions that run on workers, take and return names and small records, and read and write the store.

Each task has a key: a hash of its function and of all that it depends on. What it returns is a record in the store under that key, written last, so that a
task that was done is not done again, by whomever."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from .. import _native
from .._dataset import Dataset
from .._map import Map
from .._mapper import Mapper
from .._settings import Settings
from ._store import Store, StoreError, at_hand, digest, fingerprint
from ._worker import Usage, threads

VERSION = 2
"""Of what tasks write; another one makes everything anew."""
FIRST_NODES = 1 << 32
"""Nodes of a session are numbered from its number times this."""
FIRST_SUBMAPS = 1 << 16
SUBMAPS_OF_PIECE = 1 << 3
MOST_ALIKE = 8
"""Places of one session that are compared with a place of another."""
MAP = "map.vox"
TILES = "tiles"

Record = dict[str, Any]


def key(task: str, *inputs: object) -> str:
    """The key of a task."""
    return digest(VERSION, task, *inputs)


def recorded(store: Store, task: str, task_key: str, work: Callable[[], Record]) -> Record:
    """The record of a task: what it returned before, or what `work` returns."""
    name = f"records/{task}-{task_key}.json"
    record: Record | None = store.read_json(name)
    if record is not None:
        return record | {"is_new": False}
    _native.use_threads(threads())
    usage = Usage()
    record = work() | usage.record()
    store.write_json(name, record)
    return record | {"is_new": True}


def probe(store: Store, session: Record) -> Record:
    """What a session is: a hash of its files, the voxels in which its places would be compared, and how far its first scan reaches. A session that cannot be read is a record, too."""
    try:
        files = fingerprint(session["url"], session["options"])

        def work() -> Record:
            with tempfile.TemporaryDirectory() as folder, at_hand(session["url"], session["options"], Path(folder)) as path:
                dataset = Dataset.open(path, **session["open"])
                splitter = _native.Splitter(0, 0.0, 1.0, None)
                # Two scans: the first piece ends with the first one.
                piece = splitter.next(dataset._native().events())
                if piece is None or (voxel := splitter.track()[5]) <= 0:
                    raise ValueError("it has no scan with a return")
                ranges = np.linalg.norm(_native.unpack_scans(piece[0])[0].points(), axis=1)
                reach = float(np.median(ranges[np.isfinite(ranges) & (ranges > 0)]))
                return {"fingerprint": files, "voxel": voxel, "reach": reach, "has_poses": dataset.has_poses}

        return recorded(store, "probe", key("probe", files, session["open"]), work)
    except Exception as error:  # Whatever is wrong with one session, the others go on.
        return _refused(error)


def _refused(error: Exception) -> Record:
    """What is wrong with a session, or with the store."""
    return {"problem": f"{type(error).__name__}: {error}", "is_of_store": isinstance(error, StoreError)}


def split(store: Store, session: Record, task_key: str, metres: float, voxel: float) -> Record:
    """Cuts a session into pieces of some metres of path, with poses from the session or, where it has none, by odometry; and finds its places and the
    closures within it."""

    def work() -> Record:
        with tempfile.TemporaryDirectory() as folder, at_hand(session["url"], session["options"], Path(folder)) as path:
            dataset = Dataset.open(path, **session["open"])
            splitter = _native.Splitter(session["number"] * FIRST_NODES, metres, session["scale"], voxel)
            events = dataset._native().events()
            pieces: list[Record] = []
            while (piece := splitter.next(events)) is not None:
                content, scans = piece
                pieces.append({"name": store.keep("pieces", content), "scans": scans})
            nodes, odometry, loops, places, descriptors, _, problems, origin = splitter.track()
        if not pieces:
            raise ValueError(f"no scan can be used: {'; '.join(problems[:3]) or 'there is none'}")
        return {
            "pieces": pieces,
            "places": store.keep("places", places),
            "descriptors": store.keep("descriptors", descriptors),
            "track": store.keep("tracks", json.dumps({"nodes": nodes, "odometry": odometry, "loops": loops}).encode()),
            "origin": origin,
            "nodes": len(nodes),
            "loops": len(loops),
            "skipped": len(problems),
            "problems": problems[:5],
        }

    try:
        return recorded(store, "split", task_key, work)
    except Exception as error:
        return _refused(error)


def integrate(store: Store, task_key: str, piece: str, first_submap: int, settings: dict[str, str], origin: list[float]) -> Record:
    """Maps a piece, whose poses count from `origin`: its submaps as files of the map."""

    def work() -> Record:
        mapper = Mapper(Settings.from_text(settings), loops=False)
        for scan in _native.unpack_scans(store.read(piece)):
            mapper._inner.integrate_scan(scan, *scan.stamp()[:2])
        made = mapper.finish()
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "part.vox"
            made._inner.renumbered(first_submap, origin).save(path)
            manifest = (path / "manifest.json").read_text()
            for file in sorted(path.glob("*.vxs")):
                store.write(f"{MAP}/{file.name}", file.read_bytes())
        return {"manifest": store.keep("parts", manifest.encode()), "submaps": [_submap(made, k, first_submap + k, manifest) for k in range(len(made.submaps))]}

    return recorded(store, "integrate", task_key, work)


def _submap(made: Map, k: int, number: int, manifest: str) -> Record:
    """What has to be known of a submap: where its surface is, in its own frame."""
    submap = made.submaps[k]
    entry = next(entry for entry in json.loads(manifest)["submaps"] if entry["id"] == number)
    t_submap_map = np.linalg.inv(submap.pose)
    points = made.mesh(unfused=True).vertices if len(made.submaps) == 1 else np.concatenate([b.coordinates for b in made.blocks(submap.id)]) * made.voxel_size
    if len(made.submaps) == 1:
        points = points @ t_submap_map[:3, :3].T + t_submap_map[:3, 3]
    if len(points) == 0:
        points = np.zeros((1, 3))
    low, high = points.min(axis=0) - 1.0, points.max(axis=0) + 1.0
    heights = np.quantile(points[:, 2], [0.01, 0.99])
    return {
        "id": number,
        "file": entry["file"],
        "bytes": entry["bytes"],
        "root": entry["scans"][0]["node"] if entry["scans"] else None,
        "low": [round(float(c), 3) for c in low],
        "high": [round(float(c), 3) for c in high],
        "heights": [round(float(c), 3) for c in heights],
    }


def close(store: Store, task_key: str, first: Record, second: Record) -> Record:
    """Closures between two sessions: places that look alike, registered to each other and judged."""

    def work() -> Record:
        pairs = _native.alike_places(store.read(first["descriptors"]), store.read(second["descriptors"]), MOST_ALIKE)
        tried = _native.verify_places(store.read(first["places"]), store.read(second["places"]), pairs) if pairs else []
        edges = [edge for edge, verdict, _, _ in tried if verdict == "accepted"]
        verdicts = [verdict for _, verdict, _, _ in tried]
        return {
            "closures": store.keep("closures", json.dumps(edges).encode()),
            "compared": len(pairs),
            "tried": len(tried),
            "accepted": len(edges),
            "verdicts": {verdict: verdicts.count(verdict) for verdict in sorted(set(verdicts))},
        }

    return recorded(store, "close", task_key, work)


def assemble(store: Store, task_key: str, manifests: list[str], poses_file: str, origin: list[float]) -> Record:
    """The manifest of the whole map: the submaps of all pieces, at their corrected poses, which count from `origin`."""

    def work() -> Record:
        poses = {int(number): pose for number, pose in json.loads(store.read(poses_file)).items()}
        texts = [store.read(name).decode() for name in manifests]
        text = _native.join_manifests(texts, poses, True, origin)
        return {"manifest": store.keep("manifests", text.encode()), "submaps": len(poses)}

    return recorded(store, "assemble", task_key, work)


def tiles(store: Store, task_key: str, region: Record) -> Record:
    """Fuses the submaps in a region and writes its tiles. Only the submaps that reach into it are loaded."""

    def work() -> Record:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "region.vox"
            path.mkdir()
            poses = {int(number): pose for number, pose in region["poses"].items()}
            text = _native.join_manifests([store.read(name).decode() for name in region["manifests"]], poses, True, [0.0, 0.0, 0.0])
            (path / "manifest.json").write_text(text)
            for entry in json.loads(text)["submaps"]:
                (path / entry["file"]).symlink_to(store.local(f"{MAP}/{entry['file']}", Path(folder)))
            # Sessions of a fleet have no order in time: nothing of one is taken to be gone because another does not see it.
            part = _native.write_tiles(
                _native.Map.open(path, True)[0], (region["level"], region["cell"]), tuple(region["heights"]), Path(folder) / "tiles"
            )
            if part is None:
                return {"part": None, "files": []}
            content, files = part
            for name in files:
                store.write(f"{TILES}/content/{name}", (Path(folder) / "tiles" / "content" / name).read_bytes())
        return {"part": store.keep("regions", content), "files": files}

    return recorded(store, "tiles", task_key, work)


def finish_tiles(store: Store, task_key: str, parts: list[str], voxel: float, title: str, origin: list[float]) -> Record:
    """The upper levels of the tiles, and the page."""

    def work() -> Record:
        with tempfile.TemporaryDirectory() as folder:
            target = Path(folder) / "tiles"
            _native.finish_tiles([store.local(name, Path(folder)) for name in parts], voxel, target, title, origin)
            files = sorted(str(path.relative_to(target)) for path in target.rglob("*") if path.is_file())
            # What viewers begin with comes last.
            for name in sorted(files, key=lambda name: name == "tileset.json"):
                store.write(f"{TILES}/{name}", (target / name).read_bytes())
        return {"files": [name.removeprefix("content/") for name in files if name.startswith("content/")]}

    return recorded(store, "finish-tiles", task_key, work)
