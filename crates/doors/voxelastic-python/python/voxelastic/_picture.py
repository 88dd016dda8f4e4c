"""A small picture of a mesh from above, for notebooks: without other packages."""

from __future__ import annotations

import base64
import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from ._mesh import Mesh


def png(pixels: NDArray[np.uint8]) -> bytes:
    """A PNG file of rows x columns x 4 values: red, green, blue, opacity."""
    rows, columns, _ = pixels.shape
    # Each row begins with the number of its filter: none.
    lines = np.zeros((rows, 1 + 4 * columns), np.uint8)
    lines[:, 1:] = pixels.reshape(rows, -1)

    def chunk(name: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))

    header = struct.pack(">IIBBBBB", columns, rows, 8, 6, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(lines.tobytes(), 6)) + chunk(b"IEND", b"")


def from_above(mesh: Mesh, spacing: float, size: int = 400) -> NDArray[np.uint8] | None:
    """The vertices of a mesh, `spacing` metres apart, seen from above, the lower ones on top of the higher: roofs and ceilings do not hide what is below. At
    most `size` pixels along an edge; clear where there is nothing."""
    vertices = mesh.vertices
    if len(vertices) == 0:
        return None
    low, high = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
    pixel = max(float((high - low).max()) / (size - 1), spacing)
    columns, rows = ((high - low) / pixel).astype(np.int64) + 1
    image = np.zeros((int(rows), int(columns), 4), np.uint8)
    x, y = ((vertices[:, :2] - low) / pixel).astype(np.int64).T
    order = np.argsort(-vertices[:, 2], kind="stable")
    image[rows - 1 - y[order], x[order], :3] = mesh.vertex_colours()[order]
    image[rows - 1 - y, x, 3] = 255
    return image


def html(title: str, mesh: Mesh | None, spacing: float) -> str:
    """A line of text over the picture of a mesh."""
    text = f"<code>{title.replace('&', '&amp;').replace('<', '&lt;')}</code>"
    image = None if mesh is None else from_above(mesh, spacing)
    if image is None:
        return text
    data = base64.b64encode(png(image)).decode()
    return f'{text}<br><img alt="the map from above" style="image-rendering: pixelated; width: 400px" src="data:image/png;base64,{data}">'
