"""A lidar in a room, for robots of tests: what it sees of the room's inner sides and of boxes."""
import math

import numpy


def rays(rings, columns):
    """Directions of a lidar that looks around, and 30 degrees up and down."""
    azimuth, elevation = numpy.linspace(-math.pi, math.pi, columns, endpoint=False), numpy.radians(numpy.linspace(-30, 30, rings))
    level = [numpy.outer(numpy.cos(elevation), f(azimuth)) for f in (numpy.cos, numpy.sin)]
    return numpy.stack([*level, numpy.outer(numpy.sin(elevation), numpy.ones(columns))], -1).reshape(-1, 3)


def scan(own, room, x, y, yaw, boxes=()):
    """Returns in its own frame along `own` rays, from `(x, y, 0.4)`; the room and each box are their lowest and their highest corner."""
    c, s = math.cos(yaw), math.sin(yaw)
    directions, at = own @ numpy.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T, numpy.array([x, y, 0.4])
    with numpy.errstate(divide="ignore"):
        sides = lambda box: [(numpy.array(corner) - at) / directions for corner in box]
        ranges = numpy.maximum(*sides(room)).min(1)
        for box in boxes:
            low, high = sides(box)
            near, far = numpy.minimum(low, high).max(1), numpy.maximum(low, high).min(1)
            ranges = numpy.where((near <= far) & (near > 0), numpy.minimum(ranges, near), ranges)
    return (own * ranges[:, None]).astype(numpy.float32)
