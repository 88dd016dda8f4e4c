"""Loads a 2-D map by the rules of ROS' map_server and prints what it says: an implementation of its own, from the description at wiki.ros.org/map_server."""

import json
import pathlib
import sys

import numpy
import yaml
from PIL import Image

path = pathlib.Path(sys.argv[1])
told = yaml.safe_load(path.read_text())
image = Image.open(path.parent / told["image"])
mode, alpha = told.get("mode", "trinary"), None
if image.mode == "LA":
    grey, alpha = [numpy.asarray(band).astype(int) for band in image.split()]
else:
    grey = numpy.asarray(image.convert("L")).astype(int)
# The first row of an image is the one with the largest y.
grey = grey[::-1]
assert told["negate"] == 0 and told["origin"][2] == 0
if mode == "raw":
    cells = numpy.where(grey <= 100, grey, -1)
else:
    p = (255 - grey) / 255
    high, low = told["occupied_thresh"], told["free_thresh"]
    between = -1 if mode == "trinary" else numpy.rint(1 + 98 * (p - low) / (high - low)).astype(int)
    cells = numpy.where(p > high, 100, numpy.where(p < low, 0, between))
    if mode == "scale" and alpha is not None:
        cells = numpy.where(alpha[::-1] < 255, -1, cells)
answer = {"size": [int(cells.shape[1]), int(cells.shape[0])], "resolution": told["resolution"], "origin": told["origin"][:2]}
answer["cells"] = cells.ravel().tolist()
print(json.dumps(answer))
