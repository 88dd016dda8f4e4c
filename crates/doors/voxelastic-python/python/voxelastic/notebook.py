"""Maps in a notebook, in 3D: Jupyter, VS Code, Colab, marimo.

    from voxelastic.notebook import MapView

    view = MapView(map)
    view                                    # drag to turn, with shift to move, wheel to zoom, double-click to pick
    view.picked                             # x, y, z of the surface there
    view.show(mapper.snapshot())            # another map, in the same cell

Needs `pip install 'voxelastic[notebook]'`. Nothing is loaded from the network.
"""

from __future__ import annotations

import pathlib

import numpy as np

from ._map import Map
from ._mesh import Mesh
from ._needs import missing

try:
    import anywidget
    import traitlets
except ModuleNotFoundError as error:
    raise missing(error, "notebook") from None

__all__ = ["MapView"]

COARSEST = 3
"""The coarsest level of detail of a mesh."""


class MapView(anywidget.AnyWidget):
    """A widget that shows a map or a mesh. Surfaces are seen from free space only, so that one looks into rooms from above.

    Args:
        shown: The map or mesh.
        height: Height of the view, pixels.
        most_triangles: A larger map is shown at a coarser level of detail; the number of a mesh is not limited.

    Raises:
        ValueError: There is no surface in it, or a number is not more than 0.
    """

    _esm = pathlib.Path(__file__).with_name("_notebook.js")

    height = traitlets.Int(480).tag(sync=True)
    """Height of the view, pixels."""
    picked = traitlets.List(traitlets.Float(), allow_none=True, default_value=None).tag(sync=True)
    """The point of the surface, x, y, z in metres in the frame of the poses, that was double-clicked last; none before. `view.observe(function, "picked")` calls a function when it changes."""
    lod = traitlets.Int(0).tag(sync=True)
    """The level of detail that is shown."""

    # Arrays in little-endian order: 3 floats each, 3 floats, 4 bytes; 3 numbers of 32 bits; the path has 3 floats a pose.
    _vertices = traitlets.Bytes(b"").tag(sync=True)
    _normals = traitlets.Bytes(b"").tag(sync=True)
    _colours = traitlets.Bytes(b"").tag(sync=True)
    _triangles = traitlets.Bytes(b"").tag(sync=True)
    _path = traitlets.Bytes(b"").tag(sync=True)
    _origin = traitlets.List(traitlets.Float(), default_value=[0.0, 0.0, 0.0]).tag(sync=True)

    def __init__(self, shown: Map | Mesh, *, height: int = 480, most_triangles: int = 500_000) -> None:
        for value, name in ((height, "height"), (most_triangles, "most_triangles")):
            if not value > 0:
                raise ValueError(f"{name}: expected a number above 0, not {value!r}")
        self._most_triangles = int(most_triangles)
        super().__init__(height=int(height))
        self.show(shown)

    def show(self, shown: Map | Mesh) -> None:
        """Shows another map or mesh in its place; where one looks from stays.

        Args:
            shown: The map or mesh.

        Raises:
            ValueError: There is no surface in it.
        """
        mesh, lod = (shown, 0) if isinstance(shown, Mesh) else self._meshed(shown)
        if len(mesh) == 0:
            raise ValueError("shown: there is no surface in it")
        path = np.zeros((0, 3))
        if isinstance(shown, Map):
            poses = shown.poses
            path = np.array([poses[node][:3, 3] - mesh.origin for node in sorted(poses)]).reshape(-1, 3)
        colours = np.full((len(mesh.vertices), 4), 255, np.uint8)
        colours[:, :3] = mesh.vertex_colours()
        # All at once: the page draws what belongs together.
        with self.hold_sync():
            self.lod, self._origin = lod, [float(c) for c in mesh.origin]
            self._vertices = mesh.vertices.astype("<f4").tobytes()
            self._normals = mesh.normals.astype("<f4").tobytes()
            self._colours = colours.tobytes()
            self._triangles = mesh.triangles.astype("<u4").tobytes()
            self._path = path.astype("<f4").tobytes()

    def _meshed(self, map: Map) -> tuple[Mesh, int]:
        """The finest mesh with few enough triangles."""
        for lod in range(COARSEST):
            mesh = map.mesh(lod=lod)
            if len(mesh) <= self._most_triangles:
                return mesh, lod
        return map.mesh(lod=COARSEST), COARSEST
