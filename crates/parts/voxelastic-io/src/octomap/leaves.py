"""Prints the leaves of an OctoMap file as the real OctoMap reads it: x y z of the centre, edge, log-odds; first nodes and resolution."""
import sys

import pyoctomap

path = sys.argv[1]
tree = pyoctomap.OcTree(1.0)
if path.endswith(".bt"):
    assert tree.readBinary(path), path
else:
    tree = pyoctomap.OcTree(1.0).read(path)
    assert tree is not None, path
print(tree.size(), tree.getResolution())
for leaf in tree.begin_leafs():
    x, y, z = leaf.getCoordinate()
    print(x, y, z, leaf.getSize(), leaf.current_node.getLogOdds())
