"""A pipeline of evalio as a peer of `voxelastic-bench --slam`, with its defaults.

    python3 evalio_adapter.py request.json kiss|genz|mad|ct|loam|form|liosam|dlio

Some look for features along the rings, so all get the scans as an organised grid: rows by elevation, columns by azimuth.
"""
import sys

from slam import ABSENT, NOT_HERE, REQUEST, emit, leave, measure, np, rows

try:
    from importlib.metadata import version

    import evalio._cpp.pipelines as pipelines
    from evalio.types import SE3, SO3, Duration, ImuMeasurement, ImuParams, LidarMeasurement, LidarParams, Point, Stamp
except ImportError:
    leave(ABSENT, "evalio is left out: pip install evalio (VOXELASTIC_PYTHON names the Python)")

NEEDS_IMU = ("liosam", "dlio")
ROWS, COLUMNS = 64, 1024
name = sys.argv[2]
kind = next(c for c in vars(pipelines).values() if isinstance(c, type) and c is not pipelines.Pipeline and c.name() == name)
if name in NEEDS_IMU and not REQUEST.get("imu"):
    leave(NOT_HERE, f"{name} needs an inertial measurement unit, which this recording does not have")
emit(system=f"{kind.__name__} {kind.version()} (evalio {version('evalio')})")
has_times = bool(REQUEST["scans"]) and "time_s" in REQUEST["scans"][0]

# user code: begin
pipeline = kind()
settings = kind.default_params()
settings |= {key: 1 for key in ("num_threads", "max_num_threads", "ls_num_threads", "numberOfCores") if key in settings}
if "deskew" in settings:
    settings["deskew"] = has_times
pipeline.set_params(settings)
pipeline.set_lidar_params(LidarParams(num_rows=ROWS, num_columns=COLUMNS, min_range=REQUEST["min_range_m"], max_range=REQUEST["max_range_m"]))
pipeline.set_imu_params(ImuParams.up())
pipeline.set_imu_T_lidar(SE3(SO3(qx=0, qy=0, qz=0, qw=1), np.zeros(3)))
pipeline.initialize()


def feed(scan, stamp, end):
    global taken
    while taken < len(samples) and samples[taken, 0] <= end:
        time, gyro, accel = samples[taken, 0], samples[taken, 1:4], samples[taken, 4:7]
        pipeline.add_imu(ImuMeasurement(Stamp.from_sec(time + BEGIN), gyro, accel))
        taken += 1
    at = Stamp.from_sec(stamp + BEGIN)
    pipeline.add_lidar(LidarMeasurement(at, scan) if has_times else LidarMeasurement.from_vec_positions(at, scan))
    return [(s.to_sec() - BEGIN, np.array(pose.to_mat())) for s, pose in pipeline.saved_estimates()]
# user code: end


BEGIN = 1000.0  # they take no times before 0
samples = np.fromfile(REQUEST["imu"], np.float64).reshape(-1, 7) if REQUEST.get("imu") else np.zeros((0, 7))
taken, number, found = 0, 0, []
bounds = None


def organised(points, times):
    """The scan as a grid of points, row by row: the nearest of those that fall together, zero where there is none."""
    global bounds
    ranges = np.linalg.norm(points, axis=1)
    elevation = np.arcsin(np.clip(points[:, 2] / np.maximum(ranges, 1e-9), -1, 1))
    if bounds is None:
        bounds = np.quantile(elevation, [0.001, 0.999])
    row = np.rint((bounds[1] - elevation) / (bounds[1] - bounds[0]) * (ROWS - 1)).clip(0, ROWS - 1).astype(int)
    column = ((np.pi - np.arctan2(points[:, 1], points[:, 0])) / (2 * np.pi) * COLUMNS).astype(int) % COLUMNS
    order = np.argsort(-ranges)  # the nearest is written last
    grid, of = np.zeros((ROWS, COLUMNS, 3)), np.zeros((ROWS, COLUMNS))
    grid[row[order], column[order]] = points[order]
    if len(times):
        of[row[order], column[order]] = times[order]
    if not has_times:
        return grid.reshape(-1, 3)
    nanoseconds = np.rint(of * 1e9).astype(int)
    return [
        Point(x=x, y=y, z=z, t=Duration.from_nsec(t), row=k // COLUMNS, col=k % COLUMNS, range=int(1000 * (x * x + y * y + z * z) ** 0.5))
        for k, ((x, y, z), t) in enumerate(zip(grid.reshape(-1, 3).tolist(), nanoseconds.ravel().tolist()))
    ]


def prepared(points, times):
    return organised(points, times), float(times.max()) if len(times) else 0.0


def register(scan, span):
    global number
    stamp = REQUEST["scans"][number].get("time_s", 0.1 * number)
    number += 1
    found.extend(feed(scan, stamp, stamp + span))
    return None


if measure(register, prepared):
    stamps = np.array([scan.get("time_s", 0.1 * k) for k, scan in enumerate(REQUEST["scans"])])
    at = np.array([time for time, _ in found])
    # Without an estimate at a scan, as at the begin of those that wait for motion, the nearest stands for it.
    if len(at):
        emit(poses=[rows(found[int(np.abs(at - stamp).argmin())][1]) for stamp in stamps], estimates=len(at))
