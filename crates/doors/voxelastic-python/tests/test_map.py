"""Maps: what they know about a room of which everything is known."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import voxelastic as vx
from conftest import ROOM, Scan, distance_to_walls, room_scans, with_box


def test_the_mesh_is_the_walls(room: vx.Map) -> None:
    mesh = room.mesh()
    assert mesh.vertices.dtype == np.float32 and mesh.vertices.shape == (len(mesh.vertices), 3) == mesh.normals.shape
    assert mesh.triangles.dtype == np.int32 and mesh.triangles.shape == (len(mesh), 3)
    assert mesh.triangles.min() == 0 and mesh.triangles.max() == len(mesh.vertices) - 1
    assert mesh.intensity is None and mesh.colours is None and mesh.scales.max() <= 3
    assert np.quantile(np.abs(distance_to_walls(mesh.vertices)), 0.95) < 0.02
    # Most of the walls are seen; normals face into the room, triangles as their normals do.
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    faces = np.cross(b - a, c - a)
    assert 0.5 * np.linalg.norm(faces, axis=1).sum() > 0.5 * 8 * (ROOM[0] * ROOM[1] + ROOM[1] * ROOM[2] + ROOM[0] * ROOM[2])
    inwards = (faces * (a + b + c)).sum(axis=1) < 0
    assert inwards.mean() > 0.99
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-3)
    assert mesh.vertices.flags.writeable and mesh.vertices.flags.c_contiguous
    assert repr(mesh) == f"Mesh({len(mesh.vertices):,} vertices, {len(mesh):,} triangles)"


def test_options_of_meshes_do_what_they_say(room: vx.Map) -> None:
    full = room.mesh()
    assert len(room.mesh(lod=2)) < len(full) / 8
    assert len(room.mesh(min_weight=5)) < len(full)
    assert len(room.mesh(close_gaps=False)) <= len(full)
    assert len(room.mesh(keep_all=True)) >= len(full)
    frontier, hull = room.mesh(surface="frontier"), room.mesh(surface="free")
    assert 0 < len(frontier) < len(hull)
    occupied = room.mesh(surface="occupied")
    assert np.abs(distance_to_walls(occupied.vertices)).max() < 0.4


def test_submaps_are_fused_unless_unfused_ones_are_wanted(make_map: Callable[..., vx.Map]) -> None:
    parts = make_map(lambda_odom=0.5, min_overlap=1.0)
    assert len(parts.submaps) > 2
    assert len(parts.mesh()) < 0.7 * len(parts.mesh(unfused=True))
    assert np.quantile(np.abs(distance_to_walls(parts.mesh().vertices)), 0.95) < 0.02


@pytest.mark.parametrize("dtype", [np.float32, np.float64, ">f8", np.int16])
def test_queries_know_distances_gradients_and_states(room: vx.Map, dtype: str) -> None:
    heights = np.linspace(-0.5, 0.5, 11)
    inside = np.stack([np.full(11, 3.98), np.zeros(11), heights], axis=1)
    found = room.query(inside)
    np.testing.assert_allclose(found.distance, 0.02, atol=0.015)
    np.testing.assert_allclose(np.median(found.gradient, axis=0), [-1, 0, 0], atol=0.1)
    points = np.array([[0, 0, 0], [1, 1, 0], [100, 0, 0], [6, 0, 0]]).astype(dtype)
    found = room.query(points)
    assert found.distance.dtype == np.float32 and found.gradient.shape == (4, 3)
    assert np.isnan(found.distance).all() and not found.gradient.any()
    assert found.state.tolist() == [vx.State.FREE, vx.State.FREE, vx.State.UNKNOWN, vx.State.UNKNOWN]
    assert found.observed.tolist() == [True, True, False, False]
    assert (room.query([[4.02, 0, 0]]).state == vx.State.OCCUPIED).all()


def test_queries_of_nothing_and_nowhere(room: vx.Map) -> None:
    found = room.query(np.empty((0, 3)))
    assert [array.shape for array in found] == [(0,), (0, 3), (0,)] and found.observed.shape == (0,)
    nowhere = room.query([[np.nan, 0, 0], [np.inf, 0, 0], [1e300, 0, 0], [0, -1e30, 0]])
    assert not nowhere.observed.any() and np.isnan(nowhere.distance).all()


def test_queries_do_not_depend_on_the_form_or_the_number_of_points(room: vx.Map) -> None:
    points = np.random.default_rng(1).uniform(-ROOM - 0.2, ROOM + 0.2, (600_000, 3))
    points[::3, 0] = 3.99
    once = room.query(points)
    assert once.observed.mean() > 0.5 and (~np.isnan(once.distance)).sum() > 100_000
    for form in (np.asfortranarray(points), points[::-1][::-1], np.hstack([points, points])[:, :3]):
        for a, b in zip(once, room.query(form), strict=True):
            np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(room.distance(points), once.distance)
    np.testing.assert_array_equal(room.distance(points.astype(np.float32)), room.query(points.astype(np.float32)).distance)
    np.testing.assert_array_equal(room.state(points), once.state)
    parts = [room.query(points[k : k + 1000]) for k in range(0, 5000, 1000)]
    for name in vx.Query._fields:
        np.testing.assert_array_equal(getattr(once, name)[:5000], np.concatenate([getattr(part, name) for part in parts]))


def test_read_only_points_stay_as_they_are(room: vx.Map) -> None:
    points = np.zeros((10, 3))
    points.flags.writeable = False
    assert (room.query(points).state == vx.State.FREE).all() and not points.any()


def test_a_saved_map_comes_back(room: vx.Map, saved: Path) -> None:
    again = vx.Map.open(saved)
    np.testing.assert_array_equal(again.mesh().vertices, room.mesh().vertices)
    points = np.random.default_rng(2).uniform(-ROOM, ROOM, (1000, 3))
    for a, b in zip(room.query(points), again.query(points), strict=True):
        np.testing.assert_array_equal(a, b)
    assert again.settings == room.settings and again.sensor == room.sensor and again.sensor
    assert [submap.nodes for submap in again.submaps] == [list(range(8))]
    assert again.has_distances and again.has_occupancy and again.nbytes > 0 and again.voxel_size == 0.05
    bounds = again.bounds
    assert bounds is not None and (bounds[0] <= -ROOM).all() and (bounds[1] >= ROOM).all() and np.abs(bounds).max() < 6
    assert repr(again) == repr(room) and repr(room).startswith("Map(8 scans, 1 submaps, voxels of 0.05 m, distances and occupancy, ")
    # Open maps do not need their files.
    shutil.rmtree(saved)
    assert len(again.mesh()) == len(room.mesh())
    again.save(str(saved))
    assert len(vx.Map.open(str(saved)).mesh()) == len(room.mesh())


def test_maps_have_what_their_settings_say(make_map: Callable[..., vx.Map]) -> None:
    surfaces, space = make_map(field="tsdf"), make_map(field="occupancy")
    assert (surfaces.has_distances, surfaces.has_occupancy, space.has_distances, space.has_occupancy) == (True, False, False, True)
    point = [[3.99, 0.0, 0.0], [0.0, 0.0, 0.0]]
    assert surfaces.query(point).observed.tolist() == [True, False] and not surfaces.query(point).state.any()
    assert np.isnan(space.query(point).distance).all() and space.query(point).observed.all()
    assert len(space.mesh()) == len(space.mesh(surface="occupied")) > 0 and len(surfaces.mesh(surface="occupied")) == 0


def test_an_empty_map_knows_nothing() -> None:
    empty = vx.Mapper().finish()
    assert len(empty.mesh()) == 0 and empty.mesh().vertices.shape == (0, 3) and empty.bounds is None and empty.submaps == []
    assert not empty.query([[0, 0, 0]]).observed.any() and repr(empty).startswith("Map(0 scans, 0 submaps")


def test_what_cannot_be_opened_is_named(saved: Path, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="nowhere.vox: there is nothing of this name"):
        vx.Map.open(tmp_path / "nowhere.vox")
    (tmp_path / "file.vox").write_text("no map")
    with pytest.raises(vx.FileError, match="file.vox"):
        vx.Map.open(tmp_path / "file.vox")
    with pytest.raises(vx.FileError, match="no manifest.json"):
        vx.Map.open(tmp_path)
    submap = next(saved.glob("submap-*"))
    content = bytearray(submap.read_bytes())
    content[len(content) // 2] ^= 255
    submap.write_bytes(content)
    with pytest.raises(vx.FileError, match=submap.name):
        vx.Map.open(saved)
    submap.unlink()
    with pytest.raises(OSError, match=submap.name):
        vx.Map.open(saved)


def test_what_cannot_be_saved_is_named(room: vx.Map, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "text").write_text("mine")
    with pytest.raises(vx.FileError, match="other"):
        room.save(tmp_path / "other")
    assert (tmp_path / "other" / "text").read_text() == "mine"


def test_strange_settings_of_a_map_are_a_warning(saved: Path) -> None:
    manifest = saved / "manifest.json"
    text = re.sub('"crc32": "[0-9a-f]{8}"', '"crc32": "00000000"', manifest.read_text(), count=1).replace('"voxel_size"', '"shine": "7", "voxel_size"')
    manifest.write_text(text.replace("00000000", f"{zlib.crc32(text.encode()):08x}", 1))
    with pytest.warns(UserWarning, match="shine"):
        vx.Map.open(saved)


def test_maps_are_not_made_by_hand() -> None:
    with pytest.raises(TypeError, match=r"Map\.open"):
        vx.Map()


def test_a_map_of_two_sessions_is_as_it_was_last(tmp_path: Path) -> None:
    low, high = np.array([1.0, -1.4, -1.0]), np.array([1.8, -0.6, 0.4])
    for day in ("monday", "tuesday"):
        (tmp_path / day / "scans").mkdir(parents=True)
        poses = []
        for number, (points, pose) in enumerate(room_scans(12)):
            cloud = (with_box(points, pose, low, high) if day == "monday" else points).reshape(-1, 3)
            np.hstack([cloud, np.zeros((len(cloud), 1), np.float32)]).tofile(tmp_path / day / "scans" / f"{number:06d}.bin")
            poses.append(pose[:3].reshape(-1))
        np.savetxt(tmp_path / day / "poses.txt", np.array(poses))
    command = [sys.executable, "-m", "voxelastic", "map", "-q"]
    settings = ["--voxel-size", "0.1", "--max-range", "20", "--field", "both", "--every", "scan"]
    subprocess.run([*command, "monday", *settings, "-o", "room.vox"], cwd=tmp_path, check=True)
    subprocess.run([*command, "tuesday", "--every", "scan", "--into", "room.vox"], cwd=tmp_path, check=True)

    def of_box(room: vx.Map) -> int:
        # Below, the sensor does not see on Tuesday that it is gone.
        vertices = room.mesh().vertices
        return int(np.all((vertices > [*(low[:2] - 0.1), -0.5]) & (vertices < high + 0.1), axis=1).sum())

    newest, everything = vx.Map.open(tmp_path / "room.vox"), vx.Map.open(tmp_path / "room.vox", keep_vanished=True)
    assert of_box(newest) == 0 and of_box(everything) > 100
    side = np.array([[low[0] + 0.03, y, z] for y in np.arange(-1.3, -0.7, 0.1) for z in np.arange(-0.5, 0.3, 0.1)])
    assert (newest.state(side) == vx.State.FREE).mean() > 0.9 and (everything.state(side) == vx.State.OCCUPIED).mean() > 0.5


def test_a_mesh_is_written_by_its_ending_and_read_by_others(room: vx.Map, tmp_path: Path) -> None:
    mesh = room.mesh()
    for name in ("room.ply", "room.glb"):
        mesh.save(tmp_path / name)
    with pytest.raises(vx.FileError, match=r"\.ply or \.glb"):
        mesh.save(tmp_path / "room.obj")
    head = (tmp_path / "room.ply").read_bytes()[:400]
    assert head.startswith(b"ply\nformat binary_little_endian") and f"element vertex {len(mesh.vertices)}\n".encode() in head
    assert (tmp_path / "room.glb").read_bytes()[:4] == b"glTF"
    trimesh = pytest.importorskip("trimesh")
    again = trimesh.load(tmp_path / "room.ply", process=False)
    np.testing.assert_allclose(again.vertices, mesh.vertices, atol=1e-6)
    np.testing.assert_array_equal(again.faces, mesh.triangles)


def test_poses_of_a_map_are_those_of_its_scans_after_corrections(scans: list[Scan]) -> None:
    mapper = vx.Mapper(voxel_size=0.1, max_range=20)
    for points, pose in scans:
        mapper.integrate(points, pose[:3])
    poses = mapper.snapshot().poses
    assert list(poses) == list(range(len(scans)))
    for (_, pose), found in zip(scans, poses.values(), strict=True):
        np.testing.assert_allclose(found, pose, atol=1e-6)
    lift = np.eye(4)
    lift[2, 3] = 0.5
    mapper.update_poses({node: lift @ pose for node, pose in poses.items()})
    np.testing.assert_allclose(mapper.finish().poses[3], lift @ poses[3], atol=1e-6)
