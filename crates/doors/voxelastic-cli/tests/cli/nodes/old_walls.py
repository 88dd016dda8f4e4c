"""What of a map lies where nothing is: how long after a correction each topic shows walls where they were before. The room is that of robots.py."""
import struct
import tempfile
from pathlib import Path

import numpy

import dds_types as t

#: Well inside the room, away from floor and ceiling.
INSIDE = numpy.array([[-3.6, -2.6, -0.2], [7.6, 4.6, 2.0]])


def count(points):
    points = numpy.asarray(points).reshape(-1, 3)
    return int(((points > INSIDE[0]) & (points < INSIDE[1])).all(axis=1).sum())


def of_cells(cells, info):
    """Occupied cells, of a grid as it is."""
    rows, columns = numpy.nonzero(cells == 100)
    x, y = info.origin.position.x + (columns + 0.5) * info.resolution, info.origin.position.y + (rows + 0.5) * info.resolution
    return count(numpy.stack([x, y, numpy.zeros(len(x))], axis=1))


def of_grid(message):
    return of_cells(numpy.array(message.data, numpy.int8).reshape(message.info.height, message.info.width), message.info)


def of_octomap(message):
    """Occupied voxels, by OctoMap's own library."""
    import pyoctomap

    with tempfile.TemporaryDirectory() as folder:
        path, data = Path(folder) / "map.bt", numpy.array(message.data, numpy.int8).view(numpy.uint8)
        # Two bits for each child of each node, zero where there is none.
        nodes = 1 + sum(int(((data >> shift) & 3 > 0).sum()) for shift in (0, 2, 4, 6))
        path.write_bytes(f"# Octomap OcTree binary file\nid OcTree\nsize {nodes}\nres {message.resolution}\ndata\n".encode() + data.tobytes())
        tree = pyoctomap.OcTree(message.resolution)
        if not tree.readBinary(str(path)):
            raise SystemExit("OctoMap cannot read the map")
        occupied, _ = tree.extractPointCloud()
    return count(occupied)


class Surface:
    """The surface as a viewer keeps it: tiles by name and number, which others replace and take away."""

    def __init__(self):
        self.tiles = {}

    def take(self, messages):
        for message in messages:
            for name, action, points in message.tiles:
                if action == 3:
                    self.tiles.clear()
                elif action == 2:
                    self.tiles.pop(name, None)
                else:
                    self.tiles[name] = count(points)
        return sum(self.tiles.values())


class Tiles:
    """A message of markers, of which names, actions and points are read, by an own reader: Cyclone's makes an object of each number, which takes seconds."""

    def __init__(self, data, *_, **__):
        at = 4

        def take(form):
            nonlocal at
            size = struct.calcsize("<" + form[-1])
            at += -(at - 4) % size
            values = struct.unpack_from("<" + form, data, at)
            at += struct.calcsize("<" + form)
            return values if len(values) > 1 else values[0]

        def sequence(each, size):
            nonlocal at
            length = take("I")
            at += -(at - 4) % size if length else 0
            values = numpy.frombuffer(data, f"<f{size}", length * each, at).reshape(length, each)
            at += values.nbytes
            return values

        def octets():
            nonlocal at
            length = take("I")
            at += length
            return bytes(data[at - length : at])

        tiles = []
        for _ in range(take("I")):
            take("iI"), octets()
            name = (octets(), take("i"))
            take("i")
            action = take("i")
            take("10d"), take("4f"), take("iI"), take("B")
            points = sequence(3, 8)
            # Colours, texture, its places, text, mesh.
            sequence(4, 4), octets(), take("iI"), octets(), octets(), octets(), sequence(2, 4), octets(), octets(), octets(), octets(), take("B")
            tiles.append((name, action, points))
        self.tiles = tiles


t.MarkerArray.deserialize = Tiles
