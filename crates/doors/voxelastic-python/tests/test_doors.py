"""The same data through every door, and the same submap files come out, bit for bit: the command, a live node, arrays, data sets, a fleet of one piece."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import voxelastic as vx

pytest.importorskip("fsspec")
from voxelastic import fleet

UTM = np.array([448_000.0, 5_411_000.0, 100.0])
SETTINGS = {"voxel_size": 0.2, "max_range": 25.0}
FLAGS = ["--voxel-size", "0.2", "--max-range", "25", "--threads", "2"]


def command(*words: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "voxelastic", *map(str, words)], capture_output=True, text=True, check=True, timeout=600)


def submaps(folder: Path) -> dict[str, str]:
    """Hashes of the files of submaps."""
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.glob("*.vxs"))}


class Case:
    """Data, and what each door is told about it."""

    def __init__(self, data: Path, poses: Path | None = None, *, flags: tuple[str, ...] = (), corrections: dict[str, bool] | None = None, **options: object) -> None:
        self.data, self.poses, self.flags = data, poses, flags
        self.corrections = corrections or {}
        self.options = options | ({"poses": str(poses)} if poses else {})

    def words(self) -> list[str]:
        return [*FLAGS, *(["--poses", str(self.poses)] if self.poses else []), *self.flags]

    def dataset(self) -> vx.Dataset:
        return vx.Dataset.open(self.data, **self.options)  # type: ignore[arg-type]


def by_command(case: Case, out: Path, *more: str) -> None:
    command("map", case.data, "-o", out, "--checkpoints", "off", *case.words(), *more)


def by_live_node(case: Case, out: Path) -> None:
    command("live", "--from", case.data, "--rate", "max", "-o", out, "--checkpoints", "off", *case.words())


def by_dataset(case: Case, out: Path) -> None:
    mapper = vx.Mapper(**SETTINGS, **case.corrections, threads=1)  # type: ignore[arg-type]
    mapper.replay(case.dataset())
    mapper.finish().save(out)


def by_events(case: Case, out: Path) -> None:
    """Each event is handed over, as a program does that looks at them."""
    mapper = vx.Mapper(**SETTINGS, **case.corrections)  # type: ignore[arg-type]
    for event in case.dataset().events():
        mapper.handle(event)
    mapper.finish().save(out)


def by_arrays(case: Case, out: Path) -> None:
    """Arrays alone. Poses are read here, as a matrix has other bits than the quaternion that it was made from."""
    poses = None
    if case.poses:
        rows = np.loadtxt(case.poses)
        poses = [(row[1:4], row[4:] / np.sqrt((row[4:] ** 2).sum()) if abs((row[4:] ** 2).sum() - 1) >= 1e-12 else row[4:]) for row in rows]
    mapper = vx.Mapper(**SETTINGS, **case.corrections)  # type: ignore[arg-type]
    for k, scan in enumerate(case.dataset()):
        pose = None if poses is None else poses[k]
        mapper.integrate(scan.points, pose, node=scan.node, time=scan.time, intensity=scan.intensity, ring=scan.ring, times=scan.times)
    mapper.finish().save(out)


def by_fleet(case: Case, out: Path) -> None:
    """A fleet of one session that is one piece."""
    fleet.map([fleet.Session(str(case.data), open=case.options)], out.parent / "store", settings=vx.Settings(**SETTINGS))  # type: ignore[arg-type]
    out.symlink_to(out.parent / "store" / "map.vox")


def killed(case: Case, out: Path) -> None:
    """The command is killed once it has kept something, and started again."""
    words = [sys.executable, "-m", "voxelastic", "map", str(case.data), "-o", str(out), "--checkpoints", "2", *case.words()]
    first = subprocess.Popen(words, stderr=subprocess.DEVNULL)
    kill_when_kept(first, out)
    again = subprocess.run(words, capture_output=True, text=True, check=True, timeout=600)
    assert "going on with the run that did not end" in again.stderr


def kill_when_kept(process: subprocess.Popen[bytes], out: Path) -> None:
    while not (out / "unfinished" / "manifest.json").is_file():
        assert process.poll() is None, "it ended before it was killed"
        time.sleep(0.001)
    process.send_signal(signal.SIGKILL)
    process.wait()


PROGRAM = """
import sys, voxelastic as vx
mapper = vx.Mapper(path=sys.argv[1], checkpoints=2, **eval(sys.argv[2]))
print("resumed", mapper.resumed, flush=True)
mapper.replay(vx.Dataset.open(sys.argv[3], **eval(sys.argv[4])))
mapper.finish()
"""


def killed_in_python(case: Case, out: Path) -> None:
    words = [sys.executable, "-c", PROGRAM, str(out), repr(SETTINGS | case.corrections), str(case.data), repr(case.options)]
    kill_when_kept(subprocess.Popen(words, stdout=subprocess.DEVNULL), out)
    again = subprocess.run(words, capture_output=True, text=True, timeout=600)
    assert again.returncode == 0, again.stderr
    assert int(again.stdout.split()[1]) > 0, again.stdout


Door = Callable[[Case, Path], None]
DOORS: dict[str, Door] = {
    "live": by_live_node,
    "dataset": by_dataset,
    "events": by_events,
    "arrays": by_arrays,
    "fleet": by_fleet,
    "killed": killed,
    "killed in Python": killed_in_python,
}


@pytest.fixture(scope="session")
def cases(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Case]:
    folder = tmp_path_factory.mktemp("cases")
    room = folder / "room"
    command("simulate", "room", "-o", room, "--scans", 16, "--spacing", 0.4, "--columns", 256, "--sensor", "vlp-16")
    truth = room / "groundtruth.tum"
    far = folder / "utm.tum"
    rows = np.loadtxt(truth)
    rows[:, 1:4] += UTM
    np.savetxt(far, rows, fmt="%.17g")
    walk = folder / "walk"
    command("simulate", "room", "-o", walk, "--scans", 24, "--rate", 10, "--moving", "--imu", 100, "--bag", "--columns", 256, "--sensor", "vlp-16")
    two = folder / "two"
    command("simulate", "room", "-o", two, "--scans", 12, "--rate", 10, "--moving", "--bag", "--columns", 256, "--sensor", "vlp-16", "--second-lidar", "vlp-16")
    loop = folder / "loop"
    command("simulate", "campus", "-o", loop, "--scans", 40, "--spacing", 12, "--columns", 128, "--sensor", "vlp-16")
    topics = ("--cloud-topic", "/points", "--cloud-topic", "/points_2")
    cases = {
        "poses": Case(room, truth),
        "no poses": Case(room, flags=("--slam",), slam=True),
        "walk with inertial unit": Case(walk / "recording.mcap", flags=("--every", "scan"), every="scan"),
        "loops": Case(loop, loop / "poses.tum", flags=("--loops",), corrections={"loops": True}),
        "UTM": Case(room, far),
        "two sensors": Case(two / "recording.mcap", flags=(*topics, "--every", "scan"), cloud_topic=["/points", "/points_2"], every="scan"),
    }
    data = Path(os.environ.get("VOXELASTIC_DATA", Path(__file__).parents[5] / "shared" / "data")) / "hall"
    if data.is_dir():
        cases["hall"] = Case(data)
    return cases


@pytest.fixture(scope="session")
def expected(cases: dict[str, Case], tmp_path_factory: pytest.TempPathFactory) -> Callable[..., dict[str, str]]:
    """What the command makes of a case."""
    made: dict[tuple[str, ...], dict[str, str]] = {}

    def of(name: str, *more: str) -> dict[str, str]:
        if (name, *more) not in made:
            out = tmp_path_factory.mktemp("map") / "map.vox"
            by_command(cases[name], out, *more)
            made[(name, *more)] = submaps(out)
            assert made[(name, *more)]
        return made[(name, *more)]

    return of


# Arrays have no place for edges, further sensors and samples of an inertial unit; a fleet corrects the poses of submaps by its own graph, and fuses
# none; it cuts a session without poses by the odometry of one sensor, and `hall` into two pieces.
LEFT_OUT = {
    ("loops", "fleet"),
    ("loops", "arrays"),
    ("walk with inertial unit", "arrays"),
    ("two sensors", "arrays"),
    ("hall", "arrays"),
    ("hall", "fleet"),
    ("two sensors", "fleet"),
}
NAMES = ["poses", "no poses", "walk with inertial unit", "loops", "UTM", "two sensors", "hall"]


@pytest.mark.filterwarnings("ignore::voxelastic.RunWarning")
@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("name", NAMES)
def test_every_door_leads_to_the_same_map(
    name: str, door: str, cases: dict[str, Case], expected: Callable[..., dict[str, str]], tmp_path: Path
) -> None:
    if (name, door) in LEFT_OUT:
        pytest.skip("this door has no place for it")
    if name not in cases:
        pytest.skip("the recorded data are not here")
    out = tmp_path / "map.vox"
    DOORS[door](cases[name], out)
    # The graph of a fleet comes after its submaps.
    assert submaps(out) == (expected(name, "--no-loops") if door == "fleet" else expected(name))


def test_a_map_far_from_zero_has_an_origin(cases: dict[str, Case]) -> None:
    case = cases["UTM"]
    mapper = vx.Mapper(**SETTINGS, lambda_odom=2.0)  # type: ignore[arg-type]
    mapper.replay(case.dataset())
    made = mapper.finish()
    assert len(made.submaps) > 1
    np.testing.assert_allclose(made.origin[:2], UTM[:2], atol=100)
    mesh = made.mesh()
    assert len(mesh) > 1000
    near = vx.Mapper(**SETTINGS, lambda_odom=2.0)  # type: ignore[arg-type]
    near.replay(cases["poses"].dataset())
    truth = near.finish().mesh()
    # In double precision the surface is where it is without the offset.
    np.testing.assert_array_equal(mesh.origin, made.origin)
    shifted = mesh.vertices + mesh.origin - UTM
    assert np.quantile(truth.distance(shifted.astype(np.float32)), 0.99) < 0.01
    with pytest.raises(ValueError, match="origin"):
        made.query(mesh.vertices[:5] + mesh.origin)
