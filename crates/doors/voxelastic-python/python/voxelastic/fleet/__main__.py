"""The command `voxelastic-fleet`: also `python -m voxelastic.fleet`."""

from __future__ import annotations

import argparse
import json
import os
import sys
from typing import Any

from .._errors import SettingError
from .._settings import Settings
from ._map import Session
from ._map import map as map_sessions
from ._needs import needed

EXAMPLES = """examples:
  voxelastic-fleet drives/* -o city                              on this machine, with a worker for each core
  voxelastic-fleet drives/* -o city --workers 0                  in this process
  voxelastic-fleet s3://drives/* -o s3://maps/city --scheduler tcp://10.0.0.1:8786
                                                                 on the workers of a Dask cluster
"""


def arguments() -> argparse.ArgumentParser:
    """The arguments of the command."""
    parser = argparse.ArgumentParser(
        prog="voxelastic-fleet",
        description="Makes one map of many recordings, with or without poses, on one machine or on the workers of a Dask cluster. A run that was stopped goes on "
        "where it was; later runs may add recordings.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("sessions", nargs="+", metavar="SESSION", help="a recording or a folder of scans, as a path or a URL that fsspec knows")
    parser.add_argument("-o", "--output", required=True, metavar="STORE", help="folder or URL for the map, the tiles and the report")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--workers", type=int, metavar="N", help="worker processes on this machine; 0 for none but this process [default: one for each core]")
    where.add_argument("--scheduler", metavar="ADDRESS", help="address of a Dask scheduler, such as tcp://10.0.0.1:8786, or a file that it wrote")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting of the mapper, such as voxel_size=0.1; see `voxelastic config`")
    parser.add_argument("--title", default="map", help="name of the map in its page")
    parser.add_argument("--tile-level", type=int, default=3, metavar="N", help="size of the regions that are fused at a time: 128 voxels, doubled N times [default: 3]")
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    parser.add_argument("--quiet", action="store_true", help="print no progress")
    return parser


def client_of(given: argparse.Namespace) -> Any:
    """The Dask client, or none for this process."""
    if given.workers == 0:
        return None
    module = needed("distributed")
    Client, LocalCluster = module.Client, module.LocalCluster  # noqa: N806
    if given.scheduler is not None:
        return Client(given.scheduler) if "://" in given.scheduler else Client(scheduler_file=given.scheduler)
    workers = given.workers or cores()
    # One task at a time in each, with its share of the cores.
    environment = {"RAYON_NUM_THREADS": os.environ.get("RAYON_NUM_THREADS", str(max(1, cores() // workers)))}
    cluster = LocalCluster(n_workers=workers, threads_per_worker=1, env=environment, host="127.0.0.1", dashboard_address="127.0.0.1:0", silence_logs=40)
    if not given.quiet:
        print(f"dashboard: {cluster.dashboard_link}", file=sys.stderr)
    return Client(cluster)


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def show(stage: str, done: int, all_: int) -> None:
    """One bar in the terminal."""
    width = 30 * done // max(all_, 1)
    end = "\n" if done == all_ else ""
    print(f"\r{stage:>10} {'#' * width}{'.' * (30 - width)} {done}/{all_}", end=end, file=sys.stderr, flush=True)


def main(arguments_: list[str] | None = None) -> int:
    """Runs the command and returns its exit code: 0 if all sessions are in the map, 3 if some are not, 1 if there is no map."""
    given = arguments().parse_args(arguments_)
    try:
        settings = Settings.from_text(dict(pair.split("=", 1) for pair in given.set))
        client = client_of(given)
    except (SettingError, ValueError, OSError, ImportError) as error:
        print(f"voxelastic-fleet: {error}", file=sys.stderr)
        return 2
    try:
        report = map_sessions(
            [Session(url) for url in given.sessions],
            given.output,
            client,
            settings=settings,
            tile_level=given.tile_level,
            title=given.title,
            progress=None if given.quiet else show,
        )
    except (OSError, ValueError) as error:
        print(f"voxelastic-fleet: {error}", file=sys.stderr)
        return 1
    finally:
        if client is not None:
            client.close()
            if client.cluster is not None:
                client.cluster.close()
    print(json.dumps(report.as_json(), indent=1) if given.json else report)
    return 0 if all(session.state == "joined" for session in report.sessions) else 3


if __name__ == "__main__":
    sys.exit(main())
