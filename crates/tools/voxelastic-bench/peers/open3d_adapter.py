"""Open3D as a peer of `voxelastic-bench`: what one does with scans of a LiDAR there, whose volumes integrate pictures of cameras only. Points are put into the
map and thinned to one for each voxel; the map is that cloud.

    python3 open3d_adapter.py request.json
"""
from adapter import absent, emit, in_map, measure, np, request_for

request = request_for("tsdf")
try:
    import open3d as o3d
except (ImportError, OSError) as error:
    absent(f"Open3D is left out: {error} (pip install open3d-cpu; VOXELASTIC_PYTHON names the Python)")

emit(system=f"Open3D {o3d.__version__} (cloud)")
# user code: begin
cloud = o3d.geometry.PointCloud()


def integrate(points, origin):
    global cloud
    cloud += o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)).voxel_down_sample(request["voxel_m"])
    integrate.scans = getattr(integrate, "scans", 0) + 1
    if integrate.scans % 10 == 0:  # thinned as a whole now and then, else it grows with each scan
        cloud = cloud.voxel_down_sample(request["voxel_m"])
# user code: end


measure(request, lambda scan: in_map(scan, request["min_range_m"], request["max_range_m"]), integrate, lambda: np.asarray(cloud.voxel_down_sample(request["voxel_m"]).points))
