"""RKO-LIO as a peer of `voxelastic bench --slam`: odometry with an inertial measurement unit, with its defaults.

    python3 rko_lio_adapter.py request.json
"""
from slam import ABSENT, NOT_HERE, REQUEST, leave

try:
    import rko_lio  # noqa: F401
except ImportError:
    leave(ABSENT, "RKO-LIO is left out: pip install rko-lio (VOXELASTIC_PYTHON names the Python)")
if not REQUEST.get("imu"):
    leave(NOT_HERE, "RKO-LIO needs an inertial measurement unit, which these recordings do not have")
