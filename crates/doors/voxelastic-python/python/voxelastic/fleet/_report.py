"""What became of a fleet, as JSON and as a page."""

from __future__ import annotations

import html
from dataclasses import asdict, dataclass, field
from typing import Any

from ._runner import Stage


@dataclass
class SessionReport:
    """What became of a session."""

    name: str
    number: int
    state: str = ""
    """`joined`, `joined in part` (its odometry was lost, and some of it no closures hold: that is not in the map), `unreadable`, `incomplete` (a piece of it could not be
    mapped), `meets no other`, or `in another scale`."""
    problem: str | None = None
    """What is wrong with it, and what to do."""
    scans: int = 0
    pieces: int = 0
    skipped: int = 0
    """Scans that could not be used."""
    lost: int = 0
    """How often its odometry was lost. What lies in between is joined by closures only."""
    pieces_left_out: int = 0
    """Pieces that no two closures hold after that: they are not in the map."""
    scans_left_out: int = 0
    """Scans of these."""


@dataclass
class FleetReport:
    """What became of a fleet of sessions."""

    store: str
    title: str
    sessions: list[SessionReport] = field(default_factory=list)
    submaps: int = 0
    moved: int = 0
    """Submaps that were in an earlier map and have another place now."""
    tried: int = 0
    """Closures between sessions that were tried."""
    closures: int = 0
    """Those that hold the sessions together."""
    outvoted: int = 0
    """Those that all others contradict: they do not count."""
    pairs: list[list[int]] = field(default_factory=list)
    """Two numbers of sessions, and how many closures they share."""
    tiles: int = 0
    """Files of tiles."""
    regions_failed: list[str] = field(default_factory=list)
    """What was wrong with regions whose tiles could not be made."""
    node_poses: str = ""
    """Name of the file in the store with the corrected pose of each node: x, y, z, qx, qy, qz, qw."""
    origin_m: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    """What these poses and the map's submaps count from, metres: not zero if the first session has coordinates of a survey, such as UTM."""
    stages: list[Stage] = field(default_factory=list)

    def as_json(self) -> dict[str, Any]:
        """The report as JSON has it."""
        return asdict(self)

    @property
    def joined(self) -> list[SessionReport]:
        """The sessions that are in the map, as a whole or in part."""
        return [session for session in self.sessions if session.state in ("joined", "joined in part", "incomplete")]

    def __str__(self) -> str:
        lines = [
            f"{len(self.joined)} of {len(self.sessions)} sessions, {self.submaps} submaps ({self.moved} moved), {self.closures} closures between sessions, "
            f"{self.tiles} tiles, in {self.store}"
        ]
        lines += [f"  {session.name}: {session.state}: {session.problem}" for session in self.sessions if session.problem]
        lines += [f"  tiles: {problem}" for problem in self.regions_failed]
        return "\n".join(lines)

    def html(self) -> str:
        """The report as a page."""
        names = {session.number: session.name for session in self.sessions}
        rows = [[s.name, s.state, s.scans, s.pieces, s.skipped, s.lost, s.pieces_left_out, s.problem or ""] for s in self.sessions]
        sessions = _table(["session", "state", "scans", "pieces", "skipped", "odometry lost", "pieces left out", "what is wrong"], rows)
        pairs = _table(["session", "session", "closures"], [[names.get(a, a), names.get(b, b), n] for a, b, n in self.pairs])
        longest = max([stage.wall_seconds for stage in self.stages] + [1e-9])
        stages = _table(
            ["stage", "tasks", "done before", "failed", "seconds", "", "busy seconds by worker", "peak MB", "most bytes a task"],
            [
                [
                    stage.name,
                    stage.tasks,
                    stage.repeated,
                    stage.failed,
                    f"{stage.wall_seconds:.1f}",
                    _Bar(stage.wall_seconds / longest),
                    ", ".join(f"{seconds:.1f}" for _, seconds in sorted(stage.seconds_by_worker.items())),
                    f"{stage.peak_mb:.0f}",
                    stage.most_bytes,
                ]
                for stage in self.stages
            ],
        )
        problems = "".join(f"<p class=bad>tiles: {html.escape(problem)}</p>" for problem in self.regions_failed)
        title = html.escape(self.title)
        facts = f"{self.submaps} submaps, {self.moved} of them moved since the last run; {self.closures} closures between sessions of {self.tried} tried"
        return f"""<!doctype html>
<html lang="en"><meta charset="utf-8"><title>{title}: fleet</title>
<style>
body {{ font: 15px/1.5 system-ui, sans-serif; margin: 2em auto; max-width: 75em; padding: 0 1em; color: #1d2733; }}
table {{ border-collapse: collapse; width: 100%; margin: .5em 0 2em; }}
td, th {{ text-align: left; padding: .3em .7em; border-bottom: 1px solid #dde3ea; font-variant-numeric: tabular-nums; }}
i {{ display: inline-block; height: .8em; background: #2a78b8; }}
.bad {{ color: #a33; }}
</style>
<h1>{title}</h1>
<p>{facts}, {self.outvoted} outvoted. <a href="tiles/index.html">The map in 3D</a> (served by any server of files).</p>{problems}
<h2>Sessions</h2>{sessions}<h2>Closures</h2>{pairs}<h2>Work</h2>{stages}
</html>
"""


class _Bar:
    """A bar of a share of a column."""

    def __init__(self, share: float) -> None:
        self.share = share

    def __str__(self) -> str:
        return f'<i style="width:{10 * self.share:.2f}em"></i>'


def _table(head: list[str], rows: list[list[Any]]) -> str:
    def cell(value: Any) -> str:
        return str(value) if isinstance(value, _Bar) else html.escape(str(value))

    body = "".join("<tr>" + "".join(f"<td>{cell(value)}</td>" for value in row) + "</tr>" for row in rows)
    return f"<table><tr>{''.join(f'<th>{html.escape(name)}</th>' for name in head)}</tr>{body}</table>"
