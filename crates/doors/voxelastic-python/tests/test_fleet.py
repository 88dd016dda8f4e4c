"""Many sessions, one map: whatever the number of workers, whatever fails on the way."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import voxelastic as vx

pytest.importorskip("fsspec")
from voxelastic import fleet
from voxelastic.fleet import _store, _worker
from voxelastic.fleet._tasks import recorded

SETTINGS = vx.Settings(voxel_size=0.3, max_range=25)


def write_drive(path: Path, simulation: vx.Simulation, first: int, last: int, start: np.ndarray[Any, Any]) -> None:
    """Some scans of a simulation as a folder of a session of its own: with a frame of its own, and poses that drift."""
    path.mkdir(parents=True)
    (path / "scans").mkdir()
    poses = simulation.true_poses[first:last]
    random = np.random.default_rng(first)
    drift = np.cumsum(random.normal(0, 0.004, (len(poses), 3)), axis=0)
    rows = []
    for k, pose in enumerate(poses):
        own = start @ pose
        own[:3, 3] += drift[k]
        rows.append(own[:3].reshape(-1))
        scan = simulation[first + k].points.reshape(-1, 3)
        kept = scan[np.isfinite(scan).all(axis=1)]
        np.hstack([kept, np.zeros((len(kept), 1), np.float32)]).astype(np.float32).tofile(path / "scans" / f"{k:06d}.bin")
    np.savetxt(path / "poses.txt", np.array(rows))


def frame(x: float, y: float, yaw: float) -> np.ndarray[Any, Any]:
    matrix = np.eye(4)
    matrix[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    matrix[:2, 3] = x, y
    return matrix


@pytest.fixture(scope="session")
def world() -> vx.Simulation:
    return vx.Simulation("campus", scans=120, sensor="vlp-16", columns=500, max_range=60, spacing=1.0)


@pytest.fixture(scope="session")
def drives(world: vx.Simulation, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two drives that share half of their ways."""
    folder = tmp_path_factory.mktemp("drives")
    write_drive(folder / "monday", world, 0, 70, frame(0, 0, 0))
    write_drive(folder / "tuesday", world, 30, 100, frame(300, -40, 1.1))
    return [folder / "monday", folder / "tuesday"]


def content(store: Path) -> dict[str, str]:
    """Hashes of all that a map and its tiles are made of."""
    files = [path for name in ("map.vox", "tiles") for path in (store / name).rglob("*") if path.is_file()]
    return {str(path.relative_to(store)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(scope="session")
def alone(drives: list[Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, fleet.FleetReport]:
    """The map by this process."""
    store = tmp_path_factory.mktemp("alone")
    return store, fleet.map(drives, store, settings=SETTINGS, tile_level=1)


def cluster(workers: int) -> Any:
    distributed = pytest.importorskip("distributed")
    return distributed.LocalCluster(n_workers=workers, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, silence_logs=50)


def test_sessions_are_joined_where_they_are(alone: tuple[Path, fleet.FleetReport], world: vx.Simulation) -> None:
    store, report = alone
    assert [session.state for session in report.sessions] == ["joined", "joined"], str(report)
    assert report.closures >= 2 and report.submaps >= 4 and report.tiles > 4
    nodes = {int(node): np.array(pose) for node, pose in json.loads((store / report.node_poses).read_text()).items()}
    for session, first in ((0, 0), (1, 30)):
        off = [np.linalg.norm(pose[:3] - world.true_poses[first + (node & 0xFFFFFFFF), :3, 3]) for node, pose in nodes.items() if node >> 32 == session]
        assert len(off) == 70 and np.mean(off) < 0.25, f"session {session}: {np.mean(off):.3f} m"
    opened = vx.Map.open(store / "map.vox")
    assert len(opened.submaps) == report.submaps
    truth = world.surface(0.3, max_range=25)
    queried = np.abs(opened.query(truth).distance)
    assert np.nanmedian(queried) < 0.08
    assert (store / "fleet.html").read_text().count("monday") >= 2 and (store / "tiles" / "index.html").exists()


def test_the_map_does_not_depend_on_workers(alone: tuple[Path, fleet.FleetReport], drives: list[Path], tmp_path: Path) -> None:
    with cluster(2) as local, local.get_client() as client:
        report = fleet.map(drives, tmp_path, client, settings=SETTINGS, tile_level=1)
    assert content(tmp_path) == content(alone[0])
    assert max(stage.most_bytes for stage in report.stages) < 20_000, "arrays went through the scheduler"


def test_what_is_done_is_not_done_again(alone: tuple[Path, fleet.FleetReport], drives: list[Path]) -> None:
    store = alone[0]
    before = content(store)
    again = fleet.map(drives, store, settings=SETTINGS, tile_level=1)
    assert content(store) == before and again.moved == 0
    assert all(stage.repeated == stage.tasks for stage in again.stages), again.stages


def test_a_new_session_leaves_the_others_alone(alone: tuple[Path, fleet.FleetReport], drives: list[Path], world: vx.Simulation, tmp_path: Path) -> None:
    store = tmp_path / "grown"
    shutil.copytree(alone[0], store)
    before = {name: found for name, found in content(store).items() if name.endswith(".vxs")}
    write_drive(tmp_path / "wednesday", world, 50, 110, frame(-5, 7, -2.0))
    report = fleet.map([*drives, tmp_path / "wednesday"], store, settings=SETTINGS, tile_level=1)
    assert [session.state for session in report.sessions] == 3 * ["joined"], str(report)
    assert before.items() <= content(store).items(), "submaps that are there are not written again"
    done = {stage.name: (stage.tasks, stage.repeated) for stage in report.stages}
    assert done["split"] == (3, 2) and done["close"] == (3, 1), done
    integrated, repeated = done["integrate"]
    assert 0 < integrated - repeated < repeated


def test_sessions_that_cannot_be_used_are_named_and_the_rest_goes_on(drives: list[Path], alone: tuple[Path, fleet.FleetReport], tmp_path: Path) -> None:
    mine = vx.Simulation("mine", scans=30, sensor="vlp-16", columns=600, max_range=40, spacing=1.0)
    write_drive(tmp_path / "elsewhere", mine, 0, 25, np.eye(4))
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "notes.txt").write_text("no scans")
    feet = tmp_path / "feet"
    feet.mkdir()
    (feet / "scans").mkdir()
    for file in sorted((drives[1] / "scans").iterdir()):
        (np.fromfile(file, np.float32).reshape(-1, 4) / np.array([0.3048, 0.3048, 0.3048, 1])).astype(np.float32).tofile(feet / "scans" / file.name)
    poses = np.loadtxt(drives[1] / "poses.txt").reshape(-1, 3, 4)
    poses[:, :, 3] /= 0.3048
    np.savetxt(feet / "poses.txt", poses.reshape(-1, 12))
    sessions = [*drives, tmp_path / "elsewhere", tmp_path / "broken", tmp_path / "nowhere", feet]
    report = fleet.map(sessions, tmp_path / "store", settings=SETTINGS, tile_level=1)
    states = [session.state for session in report.sessions]
    assert states == ["joined", "joined", "meets no other", "unreadable", "unreadable", "in another scale"], str(report)
    assert "feet" in (report.sessions[5].problem or "") and "nowhere" in (report.sessions[4].problem or "")
    submaps = {name for name in content(tmp_path / "store") if name.endswith(".vxs")}
    assert len(vx.Map.open(tmp_path / "store" / "map.vox").submaps) == alone[1].submaps == len(submaps)
    scaled = fleet.map([*drives, fleet.Session(str(feet), scale=0.3048)], tmp_path / "store2", settings=SETTINGS, tile_level=1)
    assert [session.state for session in scaled.sessions] == 3 * ["joined"], str(scaled)


def write_raw(path: Path, clouds: list[np.ndarray[Any, Any]]) -> None:
    """Scans as a folder of a session without poses."""
    (path / "scans").mkdir(parents=True)
    for k, cloud in enumerate(clouds):
        kept = cloud[np.isfinite(cloud).all(axis=1)]
        np.hstack([kept, np.zeros((len(kept), 1), np.float32)]).astype(np.float32).tofile(path / "scans" / f"{k:06d}.bin")


def test_what_no_closure_holds_after_odometry_was_lost_is_left_out(world: vx.Simulation, drives: list[Path], tmp_path: Path) -> None:
    """A session without poses that is carried to another world and back while it is off."""
    mine = vx.Simulation("mine", scans=30, sensor="vlp-16", columns=500, max_range=60, spacing=0.5)
    campus = {k: world[k].points.reshape(-1, 3) for k in (*range(5, 30), *range(55, 80))}
    visits = [[campus[k] for k in range(5, 30)], [mine[k].points.reshape(-1, 3) for k in range(30)], [campus[k] for k in range(55, 80)]]
    write_raw(tmp_path / "carried", [cloud for visit in visits for cloud in visit])
    sessions, store = [*drives, tmp_path / "carried"], tmp_path / "store"
    report = fleet.map(sessions, store, settings=SETTINGS, tile_level=1)
    carried = report.sessions[2]
    assert [session.state for session in report.sessions] == ["joined", "joined", "joined in part"], str(report)
    assert carried.lost >= 2 and 0 < carried.pieces_left_out < carried.pieces, carried
    assert "not in the map" in (carried.problem or "") and "carried" in str(report)
    assert "joined in part" in (store / "fleet.html").read_text()
    # What is in the map is where it was; nothing of the mine is.
    times = {node: time for track in (store / "tracks").iterdir() for node, time, _ in json.loads(track.read_text())["nodes"]}
    nodes = {int(node): np.array(pose) for node, pose in json.loads((store / report.node_poses).read_text()).items()}
    route = [*range(5, 30), *(30 * [-1]), *range(55, 80)]
    placed = {round(10 * times[node]): pose for node, pose in nodes.items() if node >> 32 == 2}
    assert len(placed) == carried.scans - carried.scans_left_out
    assert any(k < 25 for k in placed) and any(k >= 55 for k in placed) and not any(25 <= k < 55 for k in placed), sorted(placed)
    off = [float(np.linalg.norm(pose[:3] - world.true_poses[route[k], :3, 3])) for k, pose in placed.items()]
    assert max(off) < 0.5, f"{max(off):.2f} m"
    opened = vx.Map.open(store / "map.vox")
    assert len(opened.submaps) == report.submaps
    third = [submap for submap in opened.submaps if submap.id >> 16 == 2]
    assert len(third) == carried.pieces - carried.pieces_left_out
    again = fleet.map(sessions, store, settings=SETTINGS, tile_level=1)
    assert again.sessions[2] == carried and all(stage.repeated == stage.tasks for stage in again.stages)


def test_a_store_that_fails_now_and_then_changes_nothing(
    alone: tuple[Path, fleet.FleetReport], drives: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    random, put, failures = np.random.default_rng(7), _store._put, []

    def unreliable(fs: Any, path: str, written: bytes) -> None:
        if random.random() < 0.1:
            failures.append(path)
            raise OSError(5, "the store does not answer")
        put(fs, path, written)

    monkeypatch.setattr(_store, "_put", unreliable)
    fleet.map(drives, tmp_path, settings=SETTINGS, tile_level=1)
    assert content(tmp_path) == content(alone[0]) and failures


PLACES = (
    *("/records/probe-", "/pieces/", "/places/", "/descriptors/", "/tracks/", "/records/split-", "/closures/", "/records/close-", "/poses/", "/records/optimise-"),
    *(".vxs", "/parts/", "/records/integrate-", "/manifests/", "/records/assemble-", "/tiles/content/", "/regions/", "/records/tiles-", "/tiles/tileset.json"),
    *("/records/finish-tiles-", "/map.vox/manifest.json", "/fleet.html", "/fleet.json"),
)
"""All that a fleet writes, in the order in which it does."""


def what_is_wrong(drives: list[Path], store: Path) -> str | None:
    """What a run says that is wrong; none if nothing is."""
    try:
        report = fleet.map(drives, store, settings=SETTINGS, tile_level=1)
    except fleet.StoreError as error:
        return str(error)
    except OSError as error:
        assert str(store) in str(error)
        return str(error)
    problems = [session.problem for session in report.sessions if session.problem] + report.regions_failed
    assert all(session.state in ("joined", "incomplete") for session in report.sessions), str(report)
    return "; ".join(problems) or None


def test_a_store_that_is_full_in_any_stage_is_named_and_later_runs_go_on(
    alone: tuple[Path, fleet.FleetReport], drives: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put = _store._put
    written: dict[str, bytes] = {}
    for place in PLACES:

        def full(fs: Any, path: str, content: bytes, place: str = place) -> None:
            if place in path:
                raise OSError(28, "No space left on device")
            put(fs, path, content)
            written[path] = content

        monkeypatch.setattr(_store, "_put", full)
        said = what_is_wrong(drives, tmp_path)
        assert said is not None and "No space left" in said and str(tmp_path) in said and place.strip("/") in said, f"{place}: {said}"
        assert not list(tmp_path.rglob("*.tmp"))
        # What was written is there still, as it was.
        kept = {path: content for path, content in written.items() if not path.endswith(("fleet.json", "fleet.html", "manifest.json"))}
        assert all(Path(path).read_bytes() == content for path, content in kept.items() if "/tiles/" not in path), place
    monkeypatch.undo()
    assert what_is_wrong(drives, tmp_path) is None
    assert content(tmp_path) == content(alone[0])


def test_a_disk_that_is_too_small_is_named_and_enlarged(alone: tuple[Path, fleet.FleetReport], drives: list[Path], tmp_path: Path) -> None:
    """A file system of a fixed size, larger with every run."""
    disk = tmp_path / "disk"
    disk.mkdir()
    if os.name != "posix" or subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", disk], capture_output=True).returncode != 0:
        pytest.skip("only root can mount a small disk")
    try:
        failed = []
        for megabytes in (1, 2, 4, 8, 16, 32, 64, 128, 256):
            subprocess.run(["mount", "-o", f"remount,size={megabytes}m", disk], check=True)
            said = what_is_wrong(drives, disk)
            if said is None:
                break
            assert "No space left" in said and str(disk) in said, said
            failed.append(megabytes)
        assert len(failed) >= 3 and said is None, failed
        assert content(disk) == content(alone[0])
    finally:
        subprocess.run(["umount", disk], check=True)


def test_workers_that_are_killed_in_any_stage_cost_a_task_each(alone: tuple[Path, fleet.FleetReport], drives: list[Path], tmp_path: Path) -> None:
    from fleet_faults import STAGES, Faults

    (tmp_path / "notes").mkdir()
    faults = Faults(tmp_path / "notes", kill=STAGES)
    with cluster(2) as local, local.get_client() as client:
        client.register_plugin(faults)
        report = fleet.map(drives, tmp_path / "store", client, settings=SETTINGS, tile_level=1)
    assert faults.killed() == sorted(STAGES) and not any(stage.failed for stage in report.stages)
    assert content(tmp_path / "store") == content(alone[0])
    assert sorted(record.rsplit("-", 1)[0] for record in faults.repeated()) == sorted(STAGES) and set(faults.repeated().values()) == {1}


def test_a_scheduler_that_is_restarted_costs_the_tasks_under_way(alone: tuple[Path, fleet.FleetReport], drives: list[Path], tmp_path: Path) -> None:
    distributed: Any = pytest.importorskip("distributed")
    from fleet_faults import Cluster, Faults

    restarted: list[str] = []
    notes = tmp_path / "notes"
    notes.mkdir()

    def restart(stage: str, done: int, all_: int) -> None:
        if stage == "integrate" and not restarted:
            restarted.append(stage)
            local.restart()

    store = tmp_path / "store"
    with Cluster(2, notes) as local, distributed.Client(local.address, timeout=60) as client:
        report = fleet.map(drives, store, client, settings=SETTINGS, tile_level=1, progress=restart)
    assert restarted and content(store) == content(alone[0])
    integrated = next(stage for stage in report.stages if stage.name == "integrate")
    # What was done and not told to this process yet has its record: it is not done again.
    done, again = Faults(notes).noted("attempts"), Faults(notes).repeated()
    assert integrated.failed == 0 and sum(record.startswith("integrate-") for record in done) >= integrated.tasks, integrated
    assert sum(again.values()) <= 2, again


def test_a_scheduler_that_stays_away_is_named(drives: list[Path], tmp_path: Path) -> None:
    distributed: Any = pytest.importorskip("distributed")
    from fleet_faults import Cluster

    with Cluster(1) as local, distributed.Client(local.address, timeout=60) as client:
        # How long it would try to connect again.
        client._timeout = 1
        local.stop()
        with pytest.raises(ConnectionError, match="scheduler does not answer.*run again"):
            fleet.map(drives, tmp_path, client, settings=SETTINGS, tile_level=1)


def test_two_fleets_do_not_write_to_one_store(tmp_path: Path) -> None:
    store = fleet.Store(str(tmp_path))
    first = store.replace("fleet.json", b"{}", None)
    with pytest.raises(fleet.ManifestError, match="another fleet"):
        store.replace("fleet.json", b"[]", None)
    store.replace("fleet.json", b"[]", first)


def test_an_object_store_is_a_store(drives: list[Path], alone: tuple[Path, fleet.FleetReport], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """S3 as moto answers it, in a thread of this process."""
    moto, s3fs = pytest.importorskip("moto.server"), pytest.importorskip("s3fs")
    for name, value in (("AWS_ACCESS_KEY_ID", "x"), ("AWS_SECRET_ACCESS_KEY", "x"), ("AWS_DEFAULT_REGION", "us-east-1")):
        monkeypatch.setenv(name, value)
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    try:
        host, port = server.get_host_and_port()
        options = {"client_kwargs": {"endpoint_url": f"http://{host}:{port}"}}
        files = s3fs.S3FileSystem(**options)
        files.mkdir("drives")
        files.put(str(drives[0]), "drives/monday", recursive=True)
        sessions = [fleet.Session("s3://drives/monday", options=options), fleet.Session(str(drives[1]))]
        store = fleet.Store("s3://drives/city", options)
        report = fleet.map(sessions, store, settings=SETTINGS, tile_level=1)
        assert [session.state for session in report.sessions] == ["joined", "joined"], str(report)
        files.get("drives/city/map.vox", str(tmp_path / "map.vox"), recursive=True)
        assert {name: found for name, found in content(tmp_path).items() if name.endswith(".vxs")}.items() <= content(alone[0]).items()
        assert len(vx.Map.open(tmp_path / "map.vox").submaps) == report.submaps
    finally:
        server.stop()


def test_the_command(world: vx.Simulation, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With drives in coordinates of a survey."""
    from voxelastic.fleet.__main__ import main

    drives, store = [tmp_path / "monday", tmp_path / "tuesday"], tmp_path / "store"
    write_drive(drives[0], world, 0, 50, frame(448_123, 5_411_987, 0.3))
    write_drive(drives[1], world, 20, 70, frame(448_300, 5_411_900, 1.1))
    code = main([*map(str, drives), "-o", str(store), "--workers", "0", "--set", "voxel_size=0.3", "--set", "max_range=25", "--tile-level", "1", "--json"])
    said = capsys.readouterr()
    report = json.loads(said.out)
    assert code == 0 and report["submaps"] > 0 and "tiles" in said.err
    assert report["origin_m"] == [448_000, 5_412_000, 0]
    made = vx.Map.open(store / "map.vox")
    np.testing.assert_array_equal(made.origin, [448_000, 5_412_000, 0])
    submaps = made.submaps
    assert all(np.abs(submap.pose[:3, 3]).max() < 500 for submap in submaps)
    root = json.loads((store / "tiles" / "tileset.json").read_text())["root"]
    assert root["transform"][12:] == [448_000, 5_412_000, 0, 1] and np.abs(root["boundingVolume"]["box"][:3]).max() < 500
    assert main([str(tmp_path / "nothing"), "-o", str(tmp_path / "other"), "--workers", "0", "--quiet"]) == 1
    assert "nothing" in capsys.readouterr().err
    assert main([str(drives[0]), "-o", str(store), "--workers", "0", "--set", "voxel_size=no"]) == 2


def test_memory_is_that_of_the_task(tmp_path: Path) -> None:
    store = fleet.Store(str(tmp_path))

    def work(megabytes: int) -> dict[str, Any]:
        return {"sum": float(np.ones(megabytes * 125_000).sum())}

    idle = recorded(store, "idle", "0", lambda: work(0))["peak_mb"]
    work(300)
    after, busy = (recorded(store, "task", str(megabytes), lambda: work(megabytes))["peak_mb"] for megabytes in (1, 200))
    assert after < idle + 100 and busy > idle + 190, (idle, after, busy)


def test_a_worker_uses_as_many_threads_as_it_has(tmp_path: Path) -> None:
    def count() -> list[int]:
        import os

        import voxelastic as vx
        from voxelastic import _native
        from voxelastic.fleet import _worker

        def threads() -> int:
            names = [Path(f"/proc/self/task/{task}/comm").read_text() for task in os.listdir("/proc/self/task")]
            return sum(name.startswith("voxelastic ") and name.split()[1].isdigit() for name in names)

        _native.use_threads(_worker.threads())
        simulation = vx.Simulation("mine", scans=2, sensor="vlp-16", columns=64)
        simulation[0]
        return [_worker.threads(), threads()]

    with cluster(1) as local, local.get_client() as client:
        assert client.submit(count).result() == [1, 1]
    assert _worker.threads() == 0
