"""Settings."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
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
        ({"min_range": 20, "max_range": 10}, "min_range = 20: must be less than max_range"),
        ({"sensor": "os1-63"}, "os1-64"),
        ({"max_rang": 3}, "there is no setting `max_rang`; did you mean `max_range`?"),
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


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"voxel_size": "0.1"}, r"voxel_size: expected a number \(float\), not '0.1' of type str"),
        ({"voxel_size": None}, r"voxel_size: expected a number \(float\), not None of type NoneType"),
        ({"voxel_size": True}, "of type bool"),
        ({"threads": 2.0}, r"threads: expected a whole number \(int\), not 2.0 of type float"),
        ({"threads": "2"}, "of type str"),
        ({"max_scale": 1.5}, "max_scale: expected a whole number"),
        ({"field": 3}, r"field: expected text \(str\), not 3 of type int"),
        ({"sensor": 64}, r"sensor: expected text \(str\), not 64"),
        ({"robot_radius": [1]}, r"robot_radius: expected a number \(float\) or text \(str\), not \[1\] of type list"),
    ],
)
def test_settings_of_another_type_are_refused(changes: dict[str, object], message: str) -> None:
    for use in (vx.Settings().replace, vx.Settings, vx.Mapper):
        with pytest.raises(TypeError, match=message):
            use(**changes)  # type: ignore[arg-type]


def test_what_is_no_setting_is_refused() -> None:
    with pytest.raises(TypeError, match=r"settings: expected Settings, not 0.1 of type float; settings are keyword arguments: Mapper\(voxel_size=0.1\)"):
        vx.Mapper(0.1)  # type: ignore[arg-type]


def test_numbers_of_numpy_are_numbers() -> None:
    settings = vx.Settings(voxel_size=np.float64(0.1), threads=np.int32(2), max_range=30, robot_radius=0.3, robot_height=np.float32(0.5))  # type: ignore[arg-type]
    assert settings == vx.Settings(voxel_size=0.1, threads=2, max_range=30.0, robot_radius="0.3", robot_height="0.5") and type(settings.threads) is int
    assert vx.Settings.from_text(settings.as_text()) == settings
