#!/usr/bin/env python3
"""What Python adds to the command: the same data mapped and saved by `voxelastic map`, by `Mapper.replay`, by events, and scan by scan through arrays.

    python crates/doors/voxelastic-python/benches/overhead.py DATA --repeat 5

Each round runs all of them in turn, each in a process of its own. Processor time is that of mapping and saving, of all threads, without the start of the interpreter:
the command is that of the wheel, which has no other code than the binary; with `--binary` it is a binary, and its start counts. The maps are compared: files of submaps
with the same names have the same content.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import voxelastic as vx
from voxelastic import _native


def by_replay(mapper: vx.Mapper, data: vx.Dataset) -> None:
    mapper.replay(data, progress=False)


def by_event(mapper: vx.Mapper, data: vx.Dataset) -> None:
    for event in data.events():
        mapper.handle(event)


def by_array(mapper: vx.Mapper, data: vx.Dataset) -> None:
    for scan in data:
        mapper.integrate(scan.points, scan.pose, node=scan.node, intensity=scan.intensity, ring=scan.ring, times=scan.times)


COMMAND = "voxelastic map"
WAYS = {"mapper.replay(data)": by_replay, "for event in data.events()": by_event, "for scan in data: integrate(arrays)": by_array}


def in_this_process(way: str, data: str, target: str) -> None:
    begin = time.process_time()
    if way == COMMAND:
        code = _native.run_command(["voxelastic", "map", data, "-o", target, "-q"])
        assert code == 0, f"the command ended with {code}"
    else:
        mapper = vx.Mapper()
        WAYS[way](mapper, vx.Dataset.open(data))
        mapper.finish().save(target)
    print(json.dumps(time.process_time() - begin), flush=True)


def processor_time_of(command: list[str]) -> tuple[float, str]:
    """Processor time of a program in seconds, and the last line that it printed."""
    before = os.times()
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system, done.stdout.strip().rpartition("\n")[2]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", help="scans with poses: a folder or a recording")
    parser.add_argument("--binary", help="the command as a program of its own, built of the same sources in the same profile")
    parser.add_argument("--repeat", type=int, default=5, help="rounds")
    parser.add_argument("--way", choices=[COMMAND, *WAYS], help=argparse.SUPPRESS)
    parser.add_argument("--target", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.way:
        in_this_process(options.way, options.data, options.target)
        return
    times: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        submaps: dict[str, list[str]] = {}
        for round_ in range(options.repeat):
            for k, way in enumerate([COMMAND, *WAYS]):
                target = f"{folder}/{k}-{round_}.vox"
                if way == COMMAND and options.binary:
                    seconds, _ = processor_time_of([options.binary, "map", options.data, "-o", target, "-q"])
                else:
                    seconds = float(processor_time_of([sys.executable, __file__, options.data, "--way", way, "--target", target])[1])
                times.setdefault(way, []).append(seconds)
                submaps[way] = sorted(file.name for file in Path(target).glob("submap-*"))
                shutil.rmtree(target)
    print("| mapped and saved by | processor time, median (least) | over the command, median of the rounds (least over least) | the same map |\n| --- | --- | --- | --- |")
    base = times[COMMAND]
    for way, measured in times.items():
        ratio = statistics.median(a / b for a, b in zip(measured, base, strict=True)) - 1
        least, same = min(measured) / min(base) - 1, "yes" if submaps[way] == submaps[COMMAND] else "no"
        print(f"| `{way}` | {statistics.median(measured):.2f} s ({min(measured):.2f}) | {ratio:+.1%} ({least:+.1%}) | {same} |")


if __name__ == "__main__":
    main()
