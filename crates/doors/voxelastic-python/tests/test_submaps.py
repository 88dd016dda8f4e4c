"""Parts of maps while they grow, and maps added to maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import voxelastic as vx
from conftest import Scan, pose_at, scan_at
from voxelastic._answers import _changes


def small_submaps(scans: list[Scan]) -> vx.Mapper:
    mapper = vx.Mapper(voxel_size=0.1, max_range=20, lambda_odom=0.5, min_overlap=1.0)
    for points, pose in scans:
        mapper.integrate(points, pose)
    return mapper


def test_the_meshes_of_submaps_are_those_of_the_unfused(scans: list[Scan]) -> None:
    map = small_submaps(scans).finish()
    numbers = [submap.id for submap in map.submaps]
    parts = [map.mesh(submap=number) for number in numbers]
    assert len(numbers) > 2 and min(len(part) for part in parts) > 1000
    np.testing.assert_array_equal(np.concatenate([part.vertices for part in parts]), map.mesh(unfused=True).vertices)
    with pytest.raises(ValueError, match=r"submap: there is none with number 99; there are \[0, 1"):
        map.mesh(submap=99)


def test_a_submap_of_free_space_has_its_own_surface(room: vx.Map) -> None:
    np.testing.assert_array_equal(room.mesh(surface="free", submap=0).vertices, room.mesh(surface="free").vertices)


def test_a_viewer_is_told_what_changed(scans: list[Scan]) -> None:
    mapper = small_submaps(scans[:4])
    before = mapper.submaps
    assert mapper.changed_since([]) == ([submap.id for submap in before], [], []) and mapper.changed_since(before) == ([], [], [])
    mapper.integrate(*scans[4])
    last = max(submap.id for submap in mapper.submaps)
    changes = mapper.changed_since(before)
    assert last in changes.changed and 0 not in changes.changed and changes.moved == changes.gone == []
    part = mapper.snapshot(submaps=changes.changed)
    assert [submap.id for submap in part.submaps] == changes.changed
    np.testing.assert_array_equal(part.mesh(submap=last).vertices, mapper.snapshot().mesh(submap=last).vertices)
    before = mapper.submaps
    shift = np.eye(4)
    shift[1, 3] = 2.0
    mapper.update_poses({node: shift @ pose for node, (_, pose) in enumerate(scans[:5])})
    assert mapper.changed_since(before) == ([], [submap.id for submap in before], [])
    mapper.add_loop_edge(0, 4, np.linalg.inv(scans[0][1]) @ scans[4][1])
    mapper.update_poses({node: pose for node, (_, pose) in enumerate(scans[:5])})
    with pytest.raises(ValueError, match="submaps: there is none with number 77"):
        mapper.snapshot(submaps=[77])
    # What is finished is fused.
    fused = _changes(before, mapper.finish().submaps)
    assert 0 in fused.changed and fused.gone and {0, *fused.gone} <= {submap.id for submap in before}


def walk(first: float, shift: float = 0.0) -> vx.Map:
    mapper = vx.Mapper(voxel_size=0.1, max_range=20)
    for k in range(6):
        pose = pose_at(first + 0.3 * k, 0.2, 0.1 * k)
        points = scan_at(pose)
        pose[0, 3] += shift
        mapper.integrate(points, pose)
    return mapper.finish()


def test_a_map_is_added_to_one_on_disk(tmp_path: Path) -> None:
    path = tmp_path / "room.vox"
    walk(-1.5).save(path)
    merged = walk(-0.5, shift=0.02).merge_into(path)
    assert merged.sessions == [2] and merged.by == "frame" and merged.pose.shape == (4, 4)
    both = vx.Map.open(path)
    assert len(both.poses) == 12 and len(both.submaps) == 2
    third = walk(0.0, shift=50.0)
    where = np.eye(4)
    where[0, 3] = -50.0
    assert third.merge_into(path, pose=where).by == "pose"
    assert len(vx.Map.open(path).poses) == 18


def test_maps_that_do_not_fit_are_refused(tmp_path: Path, solid: vx.Map) -> None:
    path = tmp_path / "room.vox"
    walk(-1.5).save(path)

    def files() -> list[tuple[str, int]]:
        return sorted((file.name, file.stat().st_mtime_ns) for file in path.iterdir() if file.name != ".lock")

    before = files()
    with pytest.raises(ValueError, match="it has tsdf, and what is to be added both"):
        solid.merge_into(path)
    with pytest.raises(FileNotFoundError, match="there is nothing of this name"):
        solid.merge_into(tmp_path / "none.vox")
    street = vx.Mapper(voxel_size=0.1, max_range=30)
    for scan in vx.Simulation("street", scans=3, columns=256):
        street.handle(scan)
    with pytest.raises(vx.FileError, match="the map is not added: it has no places .*; nothing was changed; `pose` says where it lies"):
        street.finish().merge_into(path, same_frame=False)
    assert before == files()
