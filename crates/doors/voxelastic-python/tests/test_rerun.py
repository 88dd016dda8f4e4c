"""What the Rerun logger sends: meshes of submaps in their own frames, poses after corrections, and the fused surface at the end."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import room_scans

import voxelastic as vx

rr: Any = pytest.importorskip("rerun")
from rerun import experimental

from voxelastic import rerun as vxr


def logged(path: Path) -> dict[str, dict[str, list[tuple[float, Any]]]]:
    """The values of each component of each entity, with their times."""
    found: dict[str, dict[str, list[tuple[float, Any]]]] = defaultdict(lambda: defaultdict(list))
    for chunk in experimental.RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        names = batch.schema.names
        nanoseconds = batch.column("map_time").to_numpy(zero_copy_only=False).astype(np.int64) if "map_time" in names else np.full(batch.num_rows, -1)
        for name in (name for name in names if ":" in name):
            found[chunk.entity_path][name] += zip((nanoseconds / 1e9).tolist(), batch.column(name).to_pylist(), strict=True)
    return found


def test_a_mapper_is_followed(tmp_path: Path) -> None:
    recording = rr.RecordingStream("test")
    recording.save(tmp_path / "map.rrd")
    # A submap for each metre or so.
    mapper = vx.Mapper(voxel_size=0.1, max_range=20, lambda_odom=0.6, min_overlap=1.0)
    logger = vxr.Logger(mapper, "room", recording=recording)
    poses = {}
    for k, (points, pose) in enumerate(room_scans(8)):
        poses[k] = pose.copy()
        mapper.integrate(points, pose, node=k)
        logger.update(float(k))
    before = mapper.submaps
    assert len(before) > 1
    for pose in poses.values():
        pose[0, 3] += 0.25
    mapper.update_poses(poses)
    mapper.add_loop_edge(0, 7, np.linalg.inv(poses[0]) @ poses[7])
    changes = logger.update(20.0)
    assert changes.moved or changes.changed
    assert logger.update(21.0) == vx.SubmapChanges([], [], [])
    after = mapper.submaps
    map = mapper.finish()
    vxr.log(map, "room", recording=recording)
    recording.flush()
    recording.disconnect()
    entities = logged(tmp_path / "map.rrd")

    for submap in after:
        sent = entities[f"/room/submaps/{submap.id}"]
        at, translation = sent["Transform3D:translation"][-1]
        np.testing.assert_allclose(translation[0], submap.pose[:3, 3], atol=1e-5)
        if submap.id in changes.moved:
            assert at == 20.0 and sent["Mesh3D:vertex_positions"][-1][0] < 20.0, "a correction sends a pose, and no mesh"
    # In the map frame the mesh that was sent is that of the submap.
    submap = after[0]
    sent = entities[f"/room/submaps/{submap.id}"]
    vertices = np.array(sent["Mesh3D:vertex_positions"][-1][1])
    (turn,) = sent["Transform3D:mat3x3"][-1][1]
    in_map = vertices @ np.array(turn).reshape(3, 3) + sent["Transform3D:translation"][-1][1][0]
    walls = np.abs(np.abs(in_map - [0.25, 0, 0]) - [4.0, 3.0, 1.5]).min(axis=1)
    assert len(vertices) > 500 and np.quantile(walls, 0.95) < 0.03
    paths = entities["/room/path"]["LineStrips3D:strips"]
    assert len(paths[-1][1][0]) == len(paths[-2][1][0]) == 8
    # That of the logger is placed by the submaps.
    np.testing.assert_allclose(paths[-2][1][0], paths[-1][1][0], atol=0.05)
    # The fused surface takes the place of the submaps.
    assert entities["/room/submaps"]["Clear:is_recursive"][-1][1] == [True]
    surface = entities["/room/surface"]
    assert len(surface["Mesh3D:triangle_indices"][-1][1]) == len(map.mesh()) == len(np.array(surface["Mesh3D:triangle_indices"][-1][1]))
    assert len(surface["Mesh3D:vertex_colors"][-1][1]) == len(surface["Mesh3D:vertex_positions"][-1][1])


def test_a_map_without_surfaces_is_refused() -> None:
    mapper = vx.Mapper(voxel_size=0.1, max_range=20, field="occupancy")
    with pytest.raises(ValueError, match="no surface"):
        vxr.log(mapper.finish(), recording=rr.RecordingStream("test"))
