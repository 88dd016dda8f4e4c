"""Elastic LiDAR mapping: scans in, one dense map that follows later corrections of their poses out.

    import voxelastic as vx

    mapper = vx.Mapper(voxel_size=0.1)
    for points, pose in scans:              # N x 3 in the lidar frame; 4 x 4, the lidar in the map frame
        mapper.integrate(points, pose)
    map = mapper.finish()
    map.save("hall.vox")
    mesh = map.mesh()                       # mesh.vertices, mesh.triangles, mesh.normals: arrays
    map.query([[1.0, 2.0, 0.5]]).distance   # metres to the nearest surface

Without poses, `mapper.integrate(points)` estimates them.

Lengths are metres, times seconds. Arrays go in and out as numpy arrays; poses are 4 x 4 matrices, or a translation with a quaternion (x, y, z, w), and say
where the lidar is in the map.
"""

from importlib.metadata import version as _version

from ._answers import Blocks, Merged, Path, Query, RayHits, Slice, State, Submap, SubmapChanges
from ._arrays import Points, Pose
from ._dataset import Dataset
from ._errors import Error, FileError, PlanError, RefusedError, RunWarning, SettingError
from ._estimation import Localiser, Location, Odometry, OdometryReport, Trajectory, odometry
from ._evaluation import TrajectoryErrors, evaluate, trajectory_errors
from ._events import Edge, Event, PoseUpdate, Scan
from ._map import Map, Surface
from ._mapper import Mapper, ScanReport
from ._memory import limit_memory
from ._mesh import Mesh
from ._progress import Progress
from ._settings import SettingArguments, Settings
from ._simulation import Simulation

__version__ = _version("voxelastic")

__all__ = [
    "Blocks",
    "Dataset",
    "Edge",
    "Error",
    "Event",
    "FileError",
    "Localiser",
    "Location",
    "Map",
    "Mapper",
    "Merged",
    "Mesh",
    "Odometry",
    "OdometryReport",
    "Path",
    "PlanError",
    "Points",
    "Pose",
    "PoseUpdate",
    "Progress",
    "Query",
    "RayHits",
    "RefusedError",
    "RunWarning",
    "Scan",
    "ScanReport",
    "SettingArguments",
    "SettingError",
    "Settings",
    "Simulation",
    "Slice",
    "State",
    "Submap",
    "SubmapChanges",
    "Surface",
    "Trajectory",
    "TrajectoryErrors",
    "__version__",
    "evaluate",
    "limit_memory",
    "odometry",
    "trajectory_errors",
]
