"""Rays, free space, paths and pictures of a room of which everything is known."""

from __future__ import annotations

import base64
import re
import struct
import sys
import types
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import voxelastic as vx
from conftest import ROOM, distance_to_walls, pose_at, scan_at


def test_rays_end_at_walls(solid: vx.Map) -> None:
    directions = np.array([[1, 0, 0], [-2, 0, 0], [0, 0.5, 0], [0, -1, 0]], dtype=float)
    hits = solid.ray_cast([0.3, 0.2, 0], directions)
    np.testing.assert_allclose(hits.distance, [3.7, 4.3, 2.8, 3.2], atol=0.02)
    np.testing.assert_allclose(hits.normal, -np.sign(directions), atol=1e-6)
    assert (hits.state == vx.State.OCCUPIED).all()
    short = solid.ray_cast([[0.0, 0, 0]] * 4, directions, max_range=1)
    assert np.isnan(short.distance).all() and not short.normal.any()
    # Behind the walls nothing is known.
    outside = [[9.0, 0, 0]], [[1.0, 0, 0]]
    assert np.isnan(solid.ray_cast(*outside).distance[0])
    unknown = solid.ray_cast(*outside, unknown_blocks=True)
    assert unknown.distance[0] == 0 and unknown.state[0] == vx.State.UNKNOWN
    assert solid.ray_cast([0, 0, 0], np.empty((0, 3))).distance.shape == (0,)


def test_signed_distances_make_rays_more_accurate(make_map: Callable[..., vx.Map]) -> None:
    pose = pose_at(0.2, 0.1, 0.4)
    beams = scan_at(pose).reshape(-1, 3)[::7].astype(float)
    errors = []
    for field in ("occupancy", "both"):
        hits = make_map(field=field).ray_cast(pose[:3, 3], beams @ pose[:3, :3].T)
        errors.append(np.median(np.abs(hits.distance - np.linalg.norm(beams, axis=1))))
    assert errors[1] < 0.005 < errors[0] < 0.08, errors


def test_rays_together_are_rays_one_by_one(solid: vx.Map) -> None:
    """They are cast in another order, and go to the surface together."""
    random = np.random.default_rng(5)
    directions, origins = random.normal(size=(700, 3)), random.uniform(-1, 1, (700, 3))
    together = solid.ray_cast(origins, directions)
    alone = [solid.ray_cast(origin, [direction]) for origin, direction in zip(origins, directions, strict=True)]
    np.testing.assert_array_equal(together.distance, [hit.distance[0] for hit in alone])
    np.testing.assert_array_equal(together.normal, [hit.normal[0] for hit in alone])
    np.testing.assert_array_equal(together.state, [hit.state[0] for hit in alone])
    assert np.isfinite(together.distance).mean() > 0.5
    ends = origins + directions / np.linalg.norm(directions, axis=1)[:, None] * together.distance[:, None]
    error = distance_to_walls(ends[np.isfinite(together.distance)])
    assert np.quantile(np.abs(error), 0.8) < 0.01


@pytest.mark.parametrize("direction", [[0, 0, 0], [np.nan, 1, 0], [np.inf, 0, 0]])
def test_rays_without_a_direction_end_nowhere(solid: vx.Map, direction: list[float]) -> None:
    hits = solid.ray_cast([0, 0, 0], np.array([direction, [1.0, 0, 0]]))
    assert np.isnan(hits.distance[0]) and abs(hits.distance[1] - 4) < 0.02


def test_a_rendered_scan_is_what_the_sensor_would_measure(solid: vx.Map) -> None:
    pose = pose_at(0.5, -0.3, 1.0)
    points = solid.render_scan(pose, "vlp-16", columns=360, max_range=20)
    assert points.shape == (16, 360, 3) and points.dtype == np.float32
    hit = points[np.isfinite(points).all(axis=-1)].astype(float)
    assert len(hit) > 0.95 * 16 * 360
    assert np.quantile(np.abs(distance_to_walls(hit @ pose[:3, :3].T + pose[:3, 3])), 0.9) < 0.03
    again = vx.Mapper(voxel_size=0.1, max_range=20)
    assert again.integrate(points, pose).returns > 0.9 * 16 * 360
    with pytest.raises(ValueError, match="vlp-16"):
        solid.render_scan(pose, "vlp-17")


def test_a_depth_image_shows_the_wall_ahead(solid: vx.Map) -> None:
    # The camera looks along x of the map.
    pose = np.array([[0, 0, 1, 1.0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    depth = solid.render_depth(pose, np.array([[40, 0, 29.5], [0, 40, 19.5], [0, 0, 1]]), (40, 60))
    assert depth.shape == (40, 60) and depth.dtype == np.float32
    # All of the wall at x = 4 has the same depth; the floor comes nearer below.
    np.testing.assert_allclose(depth[15:25, 20:40], 3.0, atol=0.03)
    assert depth[39, 30] < depth[30, 30] and depth[20, 0] < 3.03
    for wrong in (np.eye(4), np.zeros((3, 3))):
        with pytest.raises(ValueError, match="intrinsics"):
            solid.render_depth(pose, wrong, (4, 4))


def test_distance_fields_have_distances_to_walls_and_gradients(solid: vx.Map) -> None:
    points = np.column_stack([np.linspace(3.2, 3.7, 50), np.zeros(50), np.zeros(50)])
    distances, gradients = solid.esdf(points)
    assert distances.dtype == np.float32 and gradients.shape == (50, 3)
    # From centres of voxels to centres of voxels.
    assert np.abs(distances - (4 - points[:, 0])).max() < 0.15
    assert (gradients[:, 0] < -0.9).all()
    assert (solid.esdf(points, max_distance=0.5)[0] <= 0.5).all()
    assert (solid.esdf([[100.0, 0, 0]], unknown_blocks=True)[0] == 0).all()
    with pytest.raises(ValueError, match="48 voxels"):
        solid.esdf(points, max_distance=1e6)


def test_a_distance_field_is_kept_and_is_the_same(solid: vx.Map, make_map: Callable[..., vx.Map]) -> None:
    """Whatever was asked before, by points near and far, and with other settings."""
    random = np.random.default_rng(7)
    sets = [random.uniform([-4.5, -3.5, -2], [4.5, 3.5, 2], (count, 3)) for count in (3, 400, 40_000)]
    settings: list[dict[str, Any]] = [{}, {"max_distance": 0.7}, {"unknown_blocks": True}]
    for points in (*sets, sets[0]):
        for given in settings:
            distance, gradient = solid.esdf(points, **given)
            fresh = make_map(field="both", voxel_size=0.1).esdf(points, **given)
            np.testing.assert_array_equal(distance, fresh[0])
            np.testing.assert_array_equal(gradient, fresh[1])


def test_clearances_are_distances_to_walls(solid: vx.Map) -> None:
    # The wall at x = 4 is the nearest.
    points = np.random.default_rng(3).uniform([2.95, -1, -0.3], [3.85, 1, 0.3], (500, 3))
    found, expected = solid.clearance(points, unknown_blocks=False), 4 - points[:, 0]
    # Obstacles are whole voxels of 0.1 m.
    assert (found < expected + 0.03).mean() > 0.95 and (found > expected - 0.13).mean() > 0.95
    assert (solid.clearance(points, up_to=0.5, unknown_blocks=False) <= 0.5).all()
    assert (solid.clearance([[100.0, 0, 0]]) == 0).all() and solid.clearance([[4.02, 0, 0]])[0] == 0


def test_slices_are_pictures(room: vx.Map, make_map: Callable[..., vx.Map]) -> None:
    states = room.slice("z", 0.0)
    left, right, bottom, top = states.extent
    assert left < -4 and right > 4 and bottom < -3 and top > 3
    row, column = int((0 - bottom) / 0.05), int((0 - left) / 0.05)
    assert states.values[row, column] == vx.State.FREE and states.values[row, int((4.02 - left) / 0.05)] == vx.State.OCCUPIED
    coarse = room.slice("z", 0.0, pixel=0.2)
    assert coarse.values.size < states.values.size / 10
    distances = room.slice("x", 0.0, of="distance")
    assert distances.values.dtype == np.float32 and np.isnan(distances.values).any() and np.nanmin(distances.values) < 0 < np.nanmax(distances.values)
    surfaces = make_map(field="tsdf")
    assert surfaces.slice("y", 0.0).values.dtype == np.float32
    mistakes: list[tuple[dict[str, Any], str]]
    mistakes = [({"axis": "w"}, "axis"), ({"pixel": 0}, "pixel"), ({"pixel": 1e-6}, "16,384"), ({"at": np.nan}, "at, thickness"), ({"of": "x"}, "of:")]
    for wrong, message in mistakes:
        with pytest.raises(ValueError, match=message):
            room.slice(**wrong)


def test_paths_are_free(room: vx.Map) -> None:
    path = room.plan([-2, -1, 0], [2, 1, 0.3], radius=0.3, samples=200)
    assert path.points.shape[1] == 3 and np.allclose(path.points[[0, -1]], np.array([[-2, -1, 0], [2, 1, 0.3]]))
    assert path.length < 1.1 * np.linalg.norm([4, 2, 0.3]) and path.least_clearance >= 0.3 and len(path.clearance) == len(path.points)
    with pytest.raises(vx.PlanError, match="goal"):
        room.plan([-2, -1, 0], [4, 1, 0], radius=0.3, samples=200)
    with pytest.raises(vx.PlanError, match="goal .*; the robot fits at") as failed:
        room.plan([-2, -1, 0], [3.9, 1, 0], radius=0.3, samples=200)
    nearest = failed.value.nearest
    assert nearest is not None and nearest.shape == (3,) and np.linalg.norm(nearest - [3.7, 1, 0]) < 0.3
    assert room.plan([-2, -1, 0], nearest, radius=0.3, samples=200).least_clearance >= 0.3
    with pytest.raises(vx.PlanError, match="radius") as failed:
        room.plan([-2, -1, 0], [2, 1, 0], radius=-1)
    assert failed.value.nearest is None
    with pytest.raises(ValueError, match="time"):
        room.plan([-2, -1, 0], [2, 1, 0], radius=0.3, time=-1)


def test_maps_without_free_space_say_so(make_map: Callable[..., vx.Map]) -> None:
    surfaces = make_map(field="tsdf")
    uses: list[Callable[[], object]] = [
        lambda: surfaces.ray_cast([0, 0, 0], [[1, 0, 0]]),
        lambda: surfaces.clearance([[0, 0, 0]]),
        lambda: surfaces.plan([0, 0, 0], [1, 0, 0], radius=0.1),
        lambda: surfaces.slice(of="state"),
        lambda: surfaces.render_scan(np.eye(4)),
    ]
    for use in uses:
        with pytest.raises(ValueError, match='make it with field="occupancy" or field="both"'):
            use()
    with pytest.raises(ValueError, match="no signed distances"):
        make_map(field="occupancy").slice(of="distance")


def test_a_notebook_shows_a_picture(room: vx.Map) -> None:
    html = room._repr_html_()
    assert html.startswith("<code>Map(8 scans")
    image = re.search(r"base64,([^\"]+)", html)
    assert image is not None
    png = base64.b64decode(image[1])
    columns, rows = struct.unpack(">II", png[16:24])
    assert png[:8] == b"\x89PNG\r\n\x1a\n" and 75 < columns < 90 and 55 < rows < 70
    length = struct.unpack(">I", png[33:37])[0]
    pixels = np.frombuffer(zlib.decompress(png[41 : 41 + length]), np.uint8).reshape(rows, 1 + 4 * columns)[:, 1:].reshape(rows, columns, 4)
    # The walls are at the edges, and their picture goes from dark, away from surfaces, to light at them.
    assert pixels[:, :3, 3].any(axis=1).mean() > 0.8
    assert np.ptp(pixels[pixels[:, :, 3] > 0][:, 0]) > 150 and len(np.unique(pixels.reshape(-1, 4), axis=0)) > 20
    assert "<img" not in vx.Mapper().finish()._repr_html_()


def test_meshes_go_to_other_packages(room: vx.Map, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is handed over; with the packages themselves where they are installed."""
    mesh = room.mesh(lod=2)
    seen: dict[str, Any] = {}

    def trimesh(vertices: Any, faces: Any, **options: Any) -> str:
        seen.update(options, vertices=vertices, faces=faces)
        return "made"

    module = types.ModuleType("trimesh")
    monkeypatch.setattr(module, "Trimesh", trimesh, raising=False)
    monkeypatch.setitem(sys.modules, "trimesh", module)
    assert mesh.to_trimesh() == "made" and seen["process"] is False and seen["vertices"] is mesh.vertices
    assert seen["vertex_colors"].shape == (len(mesh.vertices), 3) and seen["vertex_colors"].dtype == np.uint8
    assert len(np.unique(seen["vertex_colors"], axis=0)) > 20, "colours by height"


def test_meshes_in_open3d(room: vx.Map) -> None:
    open3d = pytest.importorskip("open3d")
    mesh = room.mesh(lod=2)
    theirs = mesh.to_open3d()
    assert isinstance(theirs, open3d.geometry.TriangleMesh) and len(theirs.triangles) == len(mesh) and theirs.has_vertex_normals()
    np.testing.assert_array_equal(np.asarray(theirs.vertices), mesh.vertices.astype(float))


def test_meshes_in_trimesh(room: vx.Map) -> None:
    trimesh = pytest.importorskip("trimesh")
    mesh = room.mesh(lod=2)
    theirs = mesh.to_trimesh()
    assert isinstance(theirs, trimesh.Trimesh) and len(theirs.faces) == len(mesh)
    # Most of the room's 180 square metres are seen.
    assert 90 < theirs.area < 180 and theirs.visual.vertex_colors.shape == (len(mesh.vertices), 4)


def test_a_field_that_is_not_there_is_an_error(make_map: Callable[..., vx.Map]) -> None:
    surfaces, space = make_map(field="tsdf"), make_map(field="occupancy")
    with pytest.raises(ValueError, match="state needs free and occupied space"):
        surfaces.state([[0, 0, 0]])
    with pytest.raises(ValueError, match="distance needs signed distances"):
        space.distance([[0, 0, 0]])
    with pytest.raises(ValueError, match="blocks needs signed distances"):
        space.blocks(0)
