"""The package as a guest in a process: interrupts, forks, memory, and the command."""

from __future__ import annotations

import json
import os
import signal
import struct
import subprocess
import sys
import sysconfig
import textwrap
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import voxelastic as vx
from conftest import Scan

COMMAND = Path(sysconfig.get_path("scripts")) / "voxelastic"


def run(*arguments: str | Path, **options: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([COMMAND, *arguments], capture_output=True, text=True, timeout=300, **options)  # type: ignore[call-overload, no-any-return]


def python(script: str, *arguments: str | Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", textwrap.dedent(script), *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=Path(__file__).parent)


def test_the_command_works_and_exits_with_its_codes(tmp_path: Path, saved: Path) -> None:
    done = run("-V")
    assert (done.returncode, done.stdout) == (0, f"voxelastic {vx.__version__}\n")
    assert "features: foxglove, ros2\n" in run("--version").stdout
    assert run("mesh", saved, "-o", tmp_path / "room.ply").returncode == 0
    mesh = (tmp_path / "room.ply").read_bytes()
    assert f"element vertex {len(vx.Map.open(saved).mesh().vertices)}\n".encode() in mesh
    failed = run("info", tmp_path / "nothing.vox")
    assert failed.returncode == 1 and failed.stderr.startswith("error: ")
    assert run("mesh", saved).returncode == 2
    usage = run("--help")
    assert usage.returncode == 0 and "Usage: voxelastic" in usage.stdout
    module = subprocess.run([sys.executable, "-m", "voxelastic", "-V"], capture_output=True, text=True)
    assert module.stdout == done.stdout


def read_pcd(path: Path) -> NDArray[Any]:
    """A binary PCD file with a structured type, as `voxelastic simulate` writes it."""
    content = path.read_bytes()
    header, _, body = content.partition(b"DATA binary\n")
    fields = {line.split()[0]: line.split()[1:] for line in header.decode().splitlines() if line and not line.startswith("#")}
    kinds = [{"F": "f", "U": "u", "I": "i"}[kind] + size for kind, size in zip(fields["TYPE"], fields["SIZE"], strict=True)]
    points = np.frombuffer(body, np.dtype(list(zip(fields["FIELDS"], kinds, strict=True))))
    return points.reshape(int(fields["HEIGHT"][0]), int(fields["WIDTH"][0]))


def test_the_command_and_the_mapper_make_the_same_map(tmp_path: Path) -> None:
    """Of the same scans: the voxels bit for bit, the poses but for the last bits, because quaternions are normalised in different places."""
    drive, by_command, by_mapper = tmp_path / "drive", tmp_path / "command.vox", tmp_path / "mapper.vox"
    assert run("simulate", "room", "-o", drive, "--scans", "10", "--sensor", "vlp-16").returncode == 0
    (drive / "graph.g2o").unlink()
    for corrected in drive.glob("poses@*"):
        corrected.unlink()
    settings = {"voxel_size": 0.1, "max_range": 30.0, "field": "both"}
    flags = [word for name, value in settings.items() for word in (f"--{name.replace('_', '-')}", str(value))]
    assert run("map", drive, "-o", by_command, *flags).returncode == 0
    mapper = vx.Mapper(**settings)  # type: ignore[arg-type]
    for pose, path in zip(np.loadtxt(drive / "poses.tum"), sorted((drive / "scans").iterdir()), strict=True):
        cloud = read_pcd(path)
        points = np.stack([cloud[name] for name in "xyz"], axis=-1)
        mapper.integrate(points, (pose[1:4], pose[4:8]), intensity=cloud["intensity"], ring=cloud["ring"], times=cloud["time"])
    mapper.finish().save(by_mapper)
    files = [[sections(file.read_bytes()) for file in sorted(path.glob("submap-*"))] for path in (by_command, by_mapper)]
    assert len(files[0]) == len(files[1]) > 0
    for one, other in zip(*files, strict=True):
        origins = [json.loads(part.pop(b"orig")) for part in (one, other)]
        assert one == other and {b"tsdf", b"occu"} <= one.keys()
        poses = [np.array([scan["t_submap_lidar"] for scan in origin["scans"]]) for origin in origins]
        np.testing.assert_allclose(poses[0], poses[1], rtol=0, atol=1e-12)


def sections(file: bytes) -> dict[bytes, bytes]:
    """The sections of a submap file by their tags, as the book describes it."""
    count = struct.unpack_from("<I", file, 16)[0]
    heads = [struct.unpack_from("<4sIQQ", file, 20 + 24 * k) for k in range(count)]
    return {tag: file[offset : offset + length] for tag, _, offset, length in heads}


LONG_CALLS = {
    "query": "map.query(np.tile(np.float32([3.99, 0, 0]), (20_000_000, 1)))",
    "distance": "map.distance(np.tile(np.float32([3.99, 0, 0]), (80_000_000, 1)))",
    "plan": "map.plan([-2, -1, 0], [2, 1, 0.3], radius=0.3, time=100)",
    "clearance": "map.clearance(np.tile([0.0, 0, 0], (20_000_000, 1)))",
    "surface of a world": "vx.Simulation('campus', scans=100).surface(0.01)",
    "replay": "[vx.Mapper(voxel_size=0.02).replay(data) for _ in range(1000)]",
}


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize("call", LONG_CALLS.values(), ids=LONG_CALLS.keys())
def test_ctrl_c_ends_a_long_call(call: str, saved: Path, tmp_path: Path) -> None:
    script = f"""
        import sys, numpy as np, voxelastic as vx
        map = vx.Map.open(sys.argv[1])
        data = vx.Simulation("room", scans=4, columns=128).write(sys.argv[2])
        print("begin", flush=True)
        try:
            {call}
        except KeyboardInterrupt:
            print("interrupted", map.query([[3.99, 0, 0]]).observed[0], flush=True)
    """
    child = python(script, saved, tmp_path / "data")
    assert child.stdout is not None and child.stdout.readline() == "begin\n"
    time.sleep(0.7)
    begin = time.monotonic()
    child.send_signal(signal.SIGINT)
    out, err = child.communicate(timeout=60)
    assert out == "interrupted True\n", err
    assert time.monotonic() - begin < 10


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="address space is limited as on Linux")
def test_a_question_that_is_too_large_for_memory_is_refused(saved: Path) -> None:
    """2 GB of points that are there, and no room for the answers."""
    script = """
        import resource, sys, numpy as np, voxelastic as vx
        map = vx.Map.open(sys.argv[1])
        map.distance(np.zeros((10_000, 3)))
        used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + 2_500_000_000, resource.RLIM_INFINITY))
        points = np.zeros((180_000_000, 3), np.float32)
        for ask in (map.distance, map.query):
            try:
                ask(points)
            except MemoryError as error:
                print(error)
        print(map.distance(points[:1]))
    """
    out, err = python(script, saved).communicate(timeout=120)
    assert out == 2 * "there is no memory for the answers to 180000000 points: ask for fewer at a time\n" + "[nan]\n", err


def test_other_threads_run_during_long_calls(saved: Path) -> None:
    """A thread that counts every millisecond gets on with it."""
    script = """
        import sys, threading, time, numpy as np, voxelastic as vx
        map = vx.Map.open(sys.argv[1])
        points = np.tile(np.float32([3.99, 0, 0]), (4_000_000, 1))
        ticks, done = [], False
        def count():
            while not done:
                ticks.append(time.perf_counter())
                time.sleep(0.001)
        thread = threading.Thread(target=count)
        thread.start()
        begin = time.perf_counter()
        map.query(points)
        end = time.perf_counter()
        done = True
        thread.join()
        print(sum(begin < tick < end for tick in ticks))
    """
    out, err = python(script, saved).communicate(timeout=120)
    assert int(out) > 10, err


def test_forked_processes_can_use_maps_but_not_mappers(saved: Path, scans: list[Scan]) -> None:
    script = """
        import os, sys, numpy as np, voxelastic as vx, conftest
        map = vx.Map.open(sys.argv[1])
        map.query(np.zeros((10_000, 3)))
        mapper = vx.Mapper(voxel_size=0.1)
        mapper.integrate(*conftest.room_scans(1)[0])
        child = os.fork()
        if child == 0:
            assert (map.query(np.zeros((10_000, 3))).state == vx.State.FREE).all() and len(map.mesh()) > 0
            try:
                mapper.snapshot()
            except RuntimeError as error:
                assert "forked" in str(error)
                del mapper
                own = vx.Mapper(voxel_size=0.1)
                own.integrate(*conftest.room_scans(1)[0])
                assert len(own.finish().mesh()) > 0
                os._exit(7)
            os._exit(1)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), len(mapper.finish().mesh()) > 0)
    """
    out, err = python(script, saved).communicate(timeout=120)
    assert out == "7 True\n", err


def resident_megabytes() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_many_calls_leak_nothing(room: vx.Map, scans: list[Scan]) -> None:
    point, wrong = np.zeros((1, 3)), np.zeros((1, 2))

    def calls(count: int) -> None:
        for k in range(count):
            room.query(point)
            if k % 10 == 0:
                with pytest.raises(ValueError):
                    room.query(wrong)
            if k % 1000 == 0:
                room.mesh(lod=2)
                mapper = vx.Mapper(voxel_size=0.1, max_range=20)
                mapper.integrate(*scans[0])
                mapper.finish()

    calls(3_000)
    before = resident_megabytes()
    calls(20_000)
    assert resident_megabytes() - before < 20


def test_a_memory_budget_changes_no_result(saved: Path, tmp_path: Path) -> None:
    script = """
        import sys, voxelastic as vx
        vx.limit_memory(sys.argv[1])
        map = vx.Map.open(sys.argv[2])
        mapper = vx.Mapper(voxel_size=0.2, memory=sys.argv[1])
        for scan in vx.Simulation("room", scans=4, columns=128):
            mapper.integrate(scan.points, scan.pose)
        print(map.mesh().vertices.tobytes().hex()[-4000:], mapper.finish().mesh().vertices.tobytes().hex()[-4000:])
        try:
            vx.limit_memory("much")
        except vx.SettingError as error:
            assert "500MB" in str(error), error
    """
    free, limited = (python(script, size, saved) for size in ("none", "300MB"))
    (out, err), (expected, _) = limited.communicate(timeout=300), free.communicate(timeout=300)
    assert limited.returncode == 0, err
    assert out == expected and len(out) > 1000
