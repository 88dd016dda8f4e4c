"""GenZ-ICP as a peer of `voxelastic-bench --slam`: odometry, with its defaults (voxels of 0.3 m).

    python3 genz_icp_adapter.py request.json
"""
from slam import ABSENT, REQUEST, emit, leave, measure, np

try:
    from importlib.metadata import version

    from genz_icp.config import GenZConfig
    from genz_icp.genz_icp import GenZICP
except ImportError:
    leave(ABSENT, "GenZ-ICP is left out: pip install genz-icp (VOXELASTIC_PYTHON names the Python)")

emit(system=f"GenZ-ICP {version('genz-icp')}")
# user code: begin
config = GenZConfig()
config.data.deskew = False  # the scans are given without times
config.data.max_range, config.data.min_range = REQUEST["max_range_m"], REQUEST["min_range_m"]
odometry = GenZICP(config)


def register(points, times):
    odometry.register_frame(points, np.zeros(0))
    return odometry.last_pose
# user code: end


measure(register)
