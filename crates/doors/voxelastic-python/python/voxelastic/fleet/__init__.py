"""Maps of many sessions, by many processes: on one machine or on the workers of a Dask cluster.

    from distributed import Client
    from voxelastic import fleet

    report = fleet.map(["monday.mcap", "s3://drives/tuesday"], "/maps/city", Client("scheduler:8786"))
    print(report)                           # map.vox, tiles and fleet.html are in /maps/city

Needs `pip install 'voxelastic[fleet]'`.
"""

from ._map import Session, map  # noqa: A004
from ._report import FleetReport, SessionReport
from ._runner import Stage
from ._store import ManifestError, Store, StoreError

__all__ = ["FleetReport", "ManifestError", "Session", "SessionReport", "Stage", "Store", "StoreError", "map"]
