"""What people expect of objects of Python: `with`, copies, pickles, progress."""

from __future__ import annotations

import contextlib
import copy
import io
import pickle
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import voxelastic as vx
from conftest import Scan


@pytest.fixture(scope="module")
def drive() -> vx.Simulation:
    return vx.Simulation("room", scans=4, spacing=0.5, columns=128)


USES: list[Callable[[vx.Map], object]] = [
    lambda map: map.query([[0, 0, 0]]),
    lambda map: map.distance([[0, 0, 0]]),
    lambda map: map.state([[0, 0, 0]]),
    lambda map: map.mesh(),
    lambda map: map.save("nowhere.vox"),
    lambda map: map.settings,
    lambda map: map.voxel_size,
    lambda map: map.sensor,
    lambda map: map.submaps,
    lambda map: map.bounds,
    lambda map: map.nbytes,
    lambda map: map.has_distances,
    lambda map: map.blocks(0),
    lambda map: map.ray_cast([0, 0, 0], [[1, 0, 0]]),
    lambda map: map.render_scan(np.eye(4)),
    lambda map: map.clearance([[0, 0, 0]]),
    lambda map: map.slice(),
    lambda map: map.plan([0, 0, 0], [1, 0, 0], radius=0.1),
    lambda map: vx.Localiser(map),
    lambda map: vx.evaluate(map, [[0.0, 0, 0]]),
    lambda map: copy.copy(map),
]


def test_a_map_is_closed_by_with(saved: Path) -> None:
    with vx.Map.open(saved) as room:
        assert len(room.mesh()) > 1000
    for use in USES:
        with pytest.raises(ValueError, match="the map is closed"):
            use(room)
    assert repr(room) == "Map(closed)" and "closed" in room._repr_html_()
    room.close()


def test_a_copy_of_a_map_shares_it_and_is_closed_by_itself(saved: Path) -> None:
    room = vx.Map.open(saved)
    for again in (copy.copy(room), copy.deepcopy(room)):
        assert repr(again) == repr(room)
        again.close()
    assert len(room.mesh()) > 1000
    with pytest.raises(TypeError, match="save it, and open it in the other process"):
        pickle.dumps(room)


def test_a_mapper_is_closed_by_with(scans: list[Scan]) -> None:
    with vx.Mapper(voxel_size=0.1) as mapper:
        mapper.integrate(*scans[0])
    with pytest.raises(RuntimeError, match="or it was closed"):
        mapper.integrate(*scans[1])
    with vx.Mapper(voxel_size=0.1) as mapper:
        mapper.integrate(*scans[0])
        kept = mapper.finish()
    mapper.close()
    assert len(kept.mesh()) > 1000
    for use in (copy.copy, pickle.dumps):
        with pytest.raises(TypeError, match="snapshot"):
            use(vx.Mapper())


def test_data_sets_are_closed_copied_and_pickled(drive: vx.Simulation, tmp_path: Path) -> None:
    with drive.write(tmp_path / "drive") as data:
        under_way = iter(data)
        next(under_way)
    assert [scan.node for scan in under_way] == [1, 2, 3], "iterators go on"
    assert repr(data).endswith("closed)")
    for use in (lambda: data.scan_count, lambda: data.has_poses, lambda: list(data), lambda: str(data), lambda: vx.Mapper().replay(data)):
        with pytest.raises(ValueError, match="drive: the data set is closed"):
            use()
    every_other = vx.Dataset.open(tmp_path / "drive", every=2)
    for again in (copy.copy(every_other), pickle.loads(pickle.dumps(every_other))):
        assert again.path == every_other.path and [scan.node for scan in again] == [0, 2]


def test_simulations_are_copied_and_pickled(drive: vx.Simulation) -> None:
    for again in (copy.deepcopy(drive), pickle.loads(pickle.dumps(drive))):
        np.testing.assert_array_equal(again[2].points, drive[2].points)


def test_answers_are_copied_and_pickled(room: vx.Map) -> None:
    mesh, found = room.mesh(lod=3), room.query([[3.99, 0, 0]])
    again: tuple[vx.Mesh, vx.Query] = pickle.loads(pickle.dumps((mesh, found)))
    np.testing.assert_array_equal(again[0].triangles, mesh.triangles)
    np.testing.assert_array_equal(again[1].gradient, found.gradient)
    assert copy.deepcopy(mesh).vertices is not mesh.vertices


class Bar:
    """What the tests need of tqdm."""

    def __init__(self, total: int | None, unit: str) -> None:
        self.total, self.unit, self.done, self.is_closed = total, unit, 0, False
        Bar.made.append(self)

    made: list[Bar]

    def __enter__(self) -> Bar:
        return self

    def __exit__(self, *error: object) -> None:
        self.is_closed = True

    def update(self, more: int) -> None:
        self.done += more


def test_a_bar_shows_how_far_it_is(drive: vx.Simulation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = drive.write(tmp_path / "drive")
    Bar.made = []
    module = types.ModuleType("tqdm")
    monkeypatch.setattr(module, "tqdm", Bar, raising=False)
    monkeypatch.setitem(sys.modules, "tqdm", module)
    vx.Mapper(voxel_size=0.1).replay(data)
    assert not Bar.made, "nobody is there to see it"
    vx.Mapper(voxel_size=0.1).replay(data, progress=True)
    vx.odometry(data, progress=True)
    assert [(bar.total, bar.unit, bar.done, bar.is_closed) for bar in Bar.made] == 2 * [(4, " scan", 4, True)]

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    with contextlib.redirect_stderr(Terminal()):
        vx.Mapper(voxel_size=0.1).replay(data)
        vx.Mapper(voxel_size=0.1).replay(data, progress=False)
        assert len(Bar.made) == 3
        # Without the package there is no bar, unless it is asked for.
        monkeypatch.setitem(sys.modules, "tqdm", None)
        vx.Mapper(voxel_size=0.1).replay(data)
        with pytest.raises(ImportError, match="tqdm"):
            vx.Mapper(voxel_size=0.1).replay(data, progress=True)
    steps: list[Any] = []
    vx.odometry(data, progress=steps.append)
    assert steps == [1, 1, 1, 1]


def test_a_bar_of_tqdm_itself(drive: vx.Simulation, tmp_path: Path) -> None:
    pytest.importorskip("tqdm")
    with contextlib.redirect_stderr(io.StringIO()) as shown:
        vx.Mapper(voxel_size=0.1).replay(drive.write(tmp_path / "drive"), progress=True)
    assert "4/4" in shown.getvalue() and "scan" in shown.getvalue()
