"""OctoMap as a peer of `voxelastic-bench`.

    python3 octomap_adapter.py request.json

Needs numpy and one of the packages pyoctomap and octomap-python. OctoMap runs with its own defaults (hit 0.7, miss 0.4, clamping 0.12 to
0.97), end points discretised first, which is its fastest way, and inner nodes updated after each scan, so that the map can be asked.
"""
from adapter import absent, emit, in_map, measure, np, request_for

request = request_for("occupancy")
try:
    import pyoctomap as octomap
except ImportError:
    try:
        import octomap
    except ImportError:
        absent("OctoMap is left out: this Python has neither pyoctomap nor octomap (pip install pyoctomap; VOXELASTIC_PYTHON names the Python)")

version = getattr(octomap, "__version__", "")
emit(system=f"OctoMap ({octomap.__name__} {version})".replace(" )", ")"))
# user code: begin
voxel = request["voxel_m"]
tree = octomap.OcTree(voxel)


def integrate(points, origin):
    tree.insertPointCloud(points, origin, request["max_range_m"], True, True)
    tree.updateInnerOccupancy()


def occupied():
    """Centres of the occupied voxels; larger leaves are cut into voxels."""
    centres = []
    for leaf in tree.begin_leafs():
        if not tree.isNodeOccupied(leaf):
            continue
        edge = max(1, round(leaf.getSize() / voxel))
        steps = (np.arange(edge) - (edge - 1) / 2) * voxel
        grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3)
        centres.append(grid + np.array(leaf.getCoordinate()))
    return np.concatenate(centres) if centres else np.zeros((0, 3))
# user code: end


# Returns beyond the range free the space up to it, so they are not left out.
measure(request, lambda scan: in_map(scan, request["min_range_m"]), integrate, occupied, map_mb=lambda: tree.memoryUsage() / 1e6)
