"""VDBFusion as a peer of `voxelastic bench`.

    python3 vdbfusion_adapter.py request.json

Needs numpy and the package vdbfusion. Surfaces only: the band is three voxels to each side, its authors' choice, and no space is carved.
"""
from adapter import absent, in_map, measure, np, request, say

told = request("tsdf")
try:
    from importlib.metadata import version

    import vdbfusion
except ImportError:
    absent("VDBFusion is left out: this Python has no vdbfusion (pip install vdbfusion; VOXELASTIC_PYTHON names the Python)")

say(system=f"VDBFusion {version('vdbfusion')}")
volume = vdbfusion.VDBVolume(told["voxel_m"], 3 * told["voxel_m"], False)


def integrate(points, origin):
    pose = np.eye(4)
    pose[:3, 3] = origin
    volume.integrate(points, pose)


measure(
    told,
    lambda scan: in_map(scan, told["min_range_m"], told["max_range_m"]),
    integrate,
    lambda: volume.extract_triangle_mesh(False, 1.0)[0],
)
