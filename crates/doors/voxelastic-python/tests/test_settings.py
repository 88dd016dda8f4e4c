"""Settings."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
from pathlib import Path

import pytest

import voxelastic as vx


def test_settings_are_values() -> None:
    settings = vx.Settings(voxel_size=0.1, sensor="os1-64")
    assert settings == vx.Settings().replace(voxel_size=0.1, sensor="os1-64") != vx.Settings() and hash(settings) == hash(copy.copy(settings))
    assert repr(settings) == "Settings(voxel_size=0.1, sensor='os1-64')" and repr(vx.Settings()) == "Settings()"
    assert eval(repr(settings), {"Settings": vx.Settings}) == settings
    for again in (copy.copy(settings), copy.deepcopy(settings), pickle.loads(pickle.dumps(settings)), vx.Settings.from_text(settings.as_text())):
        assert again == settings


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"voxel_size": -1}, "voxel_size = -1: must be 0.005 to 5 m"),
        ({"field": "colour"}, r"field = colour: must be tsdf \| occupancy \| both"),
        ({"threads": 1.5}, "threads = 1.5: must be 0 to 1024"),
        ({"min_range": 20, "max_range": 10}, "min_range = 20: must be less than max_range"),
        ({"sensor": "os1-63"}, "os1-64"),
        ({"max_rang": 3}, "there is no setting `max_rang`; did you mean `max_range`?"),
        ({"voxel_size": None}, "voxel_size = None: must be"),
    ],
)
def test_refused_settings_are_named(changes: dict[str, object], message: str) -> None:
    for use in (vx.Settings().replace, vx.Mapper):
        with pytest.raises(vx.SettingError, match=message):
            use(**changes)  # type: ignore[arg-type]


def test_settings_and_changes_go_together() -> None:
    mapper = vx.Mapper(vx.Settings(voxel_size=0.1, max_range=30), max_range=20, threads=1)
    assert mapper.settings == vx.Settings(voxel_size=0.1, max_range=20, threads=1)


def test_the_class_is_that_of_the_one_definition() -> None:
    generator = Path(__file__).parent.parent / "generate_settings.py"
    subprocess.run([sys.executable, generator, "--check"], check=True)
