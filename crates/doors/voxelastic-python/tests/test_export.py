"""Maps in the formats of other programs: the files of the command."""

from __future__ import annotations

import subprocess
import sysconfig
from pathlib import Path

import numpy as np
import pytest

import voxelastic as vx
from conftest import Scan

COMMAND = Path(sysconfig.get_path("scripts")) / "voxelastic"


def content(path: Path) -> dict[str, bytes]:
    """All files of a folder, or a file."""
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    return {str(file.relative_to(path)): file.read_bytes() for file in files if file.is_file() and file.name != ".lock"}


@pytest.mark.parametrize("name", ["room.ply", "room.pcd", "room.las", "room.laz", "room.copc.laz", "room.e57", "room.bt", "room.ot", "tiles/"])
def test_files_are_those_of_the_command(saved: Path, tmp_path: Path, name: str) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    vx.Map.open(saved).export(f"{tmp_path}/a/{name}")
    subprocess.run([COMMAND, "export", saved, "-o", f"{tmp_path}/b/{name}", "-q"], check=True, timeout=120)
    ours, theirs = (content(tmp_path / where / name) for where in "ab")
    assert ours.keys() == theirs.keys() and sum(map(len, ours.values())) > 5000
    # It has the title.
    assert [ours.pop("tileset.json", None) is None, theirs.pop("tileset.json", None) is None] == 2 * [name != "tiles/"]
    assert ours == theirs


def test_sizes_are_chosen(solid: vx.Map, tmp_path: Path) -> None:
    for first, second in ((("a.bt", {}), ("b.bt", {"voxel_size": 0.4})), (("a.ply", {}), ("b.ply", {"lod": 2}))):
        for name, options in (first, second):
            solid.export(tmp_path / name, **options)
        assert (tmp_path / second[0]).stat().st_size < 0.4 * (tmp_path / first[0]).stat().st_size
    solid.export(f"{tmp_path}/tiles/", lod=1)
    assert (tmp_path / "tiles" / "tileset.json").exists() and (tmp_path / "tiles" / "index.html").exists()


def test_clouds_are_in_the_frame_of_the_poses(scans: list[Scan], tmp_path: Path) -> None:
    mapper = vx.Mapper(voxel_size=0.1, max_range=20, field="both")
    for points, pose in scans:
        far = pose.copy()
        far[:3, 3] += [448_000, 5_411_000, 100]
        mapper.integrate(points, far)
    map = mapper.finish()
    map.export(tmp_path / "far.las")
    data = (tmp_path / "far.las").read_bytes()
    # The header's largest and smallest coordinates.
    largest, smallest = np.frombuffer(data, "<f8", 6, 179).reshape(3, 2).T
    np.testing.assert_allclose((largest + smallest) / 2, [448_000, 5_411_000, 100], atol=0.5)
    with pytest.warns(UserWarning, match=r"counts from the origin of the map: add \[448000"):
        map.export(tmp_path / "far.bt")


def test_what_cannot_be_exported_is_named(solid: vx.Map, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"map.stl: not a known format; use the extension .ply"):
        solid.export(tmp_path / "map.stl")
    with pytest.raises(ValueError, match="voxel_size: it is for OctoMaps"):
        solid.export(tmp_path / "map.las", voxel_size=0.2)
    with pytest.raises(ValueError, match="voxel_size: expected metres, more than 0"):
        solid.export(tmp_path / "map.bt", voxel_size=-1)
    with pytest.raises(ValueError, match="the finest voxel of the map is 0.1 m, but voxels of 0.05 m are asked for"):
        solid.export(tmp_path / "map.bt", voxel_size=0.05)
    with pytest.raises(ValueError, match="lod, min_weight: they are for surfaces"):
        solid.export(tmp_path / "map.ot", lod=2)
    with pytest.raises(ValueError, match="lod: expected"):
        solid.export(tmp_path / "map.ply", lod=7)
    with pytest.raises(vx.FileError, match="the map has no surface with 900.0 observations or more|has no surface"):
        solid.export(tmp_path / "map.ply", min_weight=900)
    with pytest.raises(ValueError, match='make it with field="occupancy"'):
        vx.Mapper().finish().export(tmp_path / "map.bt")
    assert list(tmp_path.iterdir()) == []
