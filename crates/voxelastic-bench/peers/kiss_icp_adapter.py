"""KISS-ICP as a peer of `voxelastic bench --slam`: odometry, with its defaults.

    python3 kiss_icp_adapter.py request.json
"""
from slam import ABSENT, REQUEST, emit, leave, measure, np

try:
    from importlib.metadata import version

    from kiss_icp.config import KISSConfig
    from kiss_icp.kiss_icp import KissICP
except ImportError:
    leave(ABSENT, "KISS-ICP is left out: pip install kiss-icp (VOXELASTIC_PYTHON names the Python)")

emit(system=f"KISS-ICP {version('kiss-icp')}")
config = KISSConfig()
config.data.deskew = False  # the scans are given without times
config.data.max_range, config.data.min_range = REQUEST["max_range_m"], REQUEST["min_range_m"]
config.registration.max_num_threads, config.mapping.voxel_size = REQUEST["threads"], REQUEST["max_range_m"] / 100
odometry = KissICP(config)


def register(points):
    odometry.register_frame(points, np.zeros(0))
    return odometry.last_pose


measure(register)
