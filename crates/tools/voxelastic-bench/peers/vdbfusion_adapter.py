"""VDBFusion as a peer of `voxelastic-bench`.

    python3 vdbfusion_adapter.py request.json

Needs numpy and the package vdbfusion. Surfaces only: the band is three voxels to each side, its authors' choice, and no space is carved.
"""
from adapter import absent, emit, in_map, measure, np, request_for

request = request_for("tsdf")
try:
    from importlib.metadata import version

    import vdbfusion
except ImportError:
    absent("VDBFusion is left out: this Python has no vdbfusion (pip install vdbfusion; VOXELASTIC_PYTHON names the Python)")

emit(system=f"VDBFusion {version('vdbfusion')}")
# user code: begin
volume = vdbfusion.VDBVolume(request["voxel_m"], 3 * request["voxel_m"], False)


def integrate(points, origin):
    pose = np.eye(4)
    pose[:3, 3] = origin
    volume.integrate(points, pose)
# user code: end


measure(
    request,
    lambda scan: in_map(scan, request["min_range_m"], request["max_range_m"]),
    integrate,
    lambda: volume.extract_triangle_mesh(False, 1.0)[0],
)
