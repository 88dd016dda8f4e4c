"""Reads a map directory, by its description in docs/src/reference/map-directory.md alone, and prints sums of all that is in it as JSON."""

import json
import struct
import sys
import zlib
from pathlib import Path

import numpy as np
import zstandard


def numbers(form, data, at=0):
    return struct.unpack_from("<" + form, data, at)


def read_manifest(folder):
    text = (folder / "manifest.json").read_bytes()
    manifest = json.loads(text)
    assert manifest["format"] == "voxelastic map" and manifest["version"] == 4
    without = text.replace(b'"crc32": "' + manifest["crc32"].encode(), b'"crc32": "00000000', 1)
    assert f"{zlib.crc32(without):08x}" == manifest["crc32"], "checksum of the manifest"
    return manifest


def read_sections(data, entry):
    """The sections of a submap file by tag."""
    assert len(data) == entry["bytes"] and zlib.crc32(data) == entry["crc32"]
    assert data[:8] == b"\x89VXSUB\r\n"
    version, submap, count = numbers("III", data, 8)
    assert (version, submap) == (4, entry["id"])
    end = 20 + 24 * count
    assert numbers("I", data, end) == (zlib.crc32(data[:end]),), "checksum of the head"
    sections, expected = {}, end + 4
    for row in range(count):
        tag, crc32, offset, length = numbers("4sIQQ", data, 20 + 24 * row)
        assert offset == expected, "sections follow each other without gaps"
        expected = offset + length
        sections[tag.decode()] = data[offset:expected]
        assert zlib.crc32(sections[tag.decode()]) == crc32
    assert expected == len(data)
    return sections


def frames(data):
    """The pages of a section after its head, unpacked, each with its number of items."""
    at = 0
    while at < len(data):
        packed, raw, items, crc32 = numbers("IIII", data, at)
        page = data[at + 16 : at + 16 + packed]
        assert zlib.crc32(page) == crc32 and raw <= 2 << 20
        yield Page(zstandard.ZstdDecompressor().decompress(page, max_output_size=raw)), items
        at += 16 + packed


class Page:
    """What is left of a page."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def bytes(self, count):
        taken = np.frombuffer(self.data, np.uint8, count, self.at)
        self.at += count
        return taken

    def varint(self):
        value = shift = 0
        while True:
            byte = int(self.bytes(1)[0])
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return value

    def keys(self, count):
        found, last = [], 0
        for _ in range(count):
            last += self.varint()
            found.append(last)
        return found

    def mask(self, values):
        return np.unpackbits(self.bytes(-(-values // 8)), bitorder="little")[:values].astype(bool)

    def ones(self, count):
        """Bits that are set in the masks of bricks."""
        return int(np.unpackbits(self.bytes(count)).sum())

    def end(self):
        assert self.at == len(self.data), "bytes are left over"


def voxels_at(scale):
    return (8 >> scale) ** 3


def mask_bytes(scale):
    """Bytes of the masks of an array's bricks."""
    return -(-voxels_at(scale) // 8)


def read_tsdf(data):
    (blocks,) = numbers("Q", data)
    sums = {"blocks": 0, "keys": 0, "scales": [0] * 4, "voxels": 0, "distances": 0, "weights": 0, "intensities": 0}
    for page, items in frames(data[8:]):
        heads = page.bytes(items)
        scales, finest, intense = heads & 3, heads >> 2 & 3, heads >> 4 & 1
        sums["keys"] += sum(page.keys(items))
        arrays = [range(f, s + 1) for s, f in zip(scales, finest)]
        stored = page.ones(sum(mask_bytes(s) for a in arrays for s in a) + sum(mask_bytes(s) for a in arrays for s in a[1:]))
        folded = page.bytes(stored).astype(np.uint16) | page.bytes(stored).astype(np.uint16) << 8
        steps = (folded >> 1) ^ np.where(folded & 1, 0xFFFF, 0).astype(np.uint16)
        distances = np.cumsum(steps.astype(np.int64)).astype(np.uint16).astype(np.int16)
        weights = page.bytes(stored).astype(np.int64) + 256 * page.bytes(stored).astype(np.int64)
        shaded = page.ones(sum(mask_bytes(s) for a, i in zip(arrays, intense) if i for s in a))
        sums["intensities"] += int(page.bytes(shaded).sum())
        page.end()
        sums["blocks"] += items
        sums["scales"] = [n + int((scales == s).sum()) for s, n in enumerate(sums["scales"])]
        sums["voxels"] += stored
        sums["distances"] += int(distances.astype(np.int64).sum())
        sums["weights"] += int(weights.sum())
    assert sums["blocks"] == blocks
    return sums


def read_colours(data):
    (blocks,) = numbers("Q", data)
    sums = {"blocks": 0, "red": 0, "green": 0, "blue": 0, "observations": 0}
    for page, items in frames(data[8:]):
        scales = page.bytes(items)
        page.keys(items)
        stored = int(page.mask(sum(voxels_at(int(s)) for s in scales)).sum())
        for name in ["red", "green", "blue", "observations"]:
            sums[name] += int(page.bytes(stored).sum())
        page.end()
        sums["blocks"] += items
    assert sums["blocks"] == blocks
    return sums


def read_occupancy(data):
    _level, _key, octants, blocks = numbers("IQQQ", data)
    sums = {"octants": 0, "blocks": 0, "linked": 0, "observed": 0, "values": 0, "maxima": 0, "scales": [0] * 4, "known": 0, "voxels": 0}
    for page, items in frames(data[28:]):
        if sums["octants"] < octants:
            sums["linked"] += int(page.mask(items).sum())
            sums["observed"] += int(page.mask(items).sum())
            sums["values"] += int(page.bytes(items).view(np.int8).astype(np.int64).sum())
            sums["maxima"] += int(page.bytes(items).view(np.int8).astype(np.int64).sum())
            sums["octants"] += items
        else:
            scales = page.bytes(items)
            values = page.bytes(sum(voxels_at(int(s)) for s in scales)).view(np.int8).astype(np.int64)
            sums["scales"] = [n + int((scales == s).sum()) for s, n in enumerate(sums["scales"])]
            sums["known"] += int((values != -128).sum())
            sums["voxels"] += int(values[values != -128].sum())
            sums["blocks"] += items
        page.end()
    assert (sums["octants"], sums["blocks"]) == (octants, blocks)
    return sums


def main():
    folder = Path(sys.argv[1])
    found = []
    for entry in read_manifest(folder)["submaps"]:
        sections = read_sections((folder / entry["file"]).read_bytes(), entry)
        origin = json.loads(sections.pop("orig"))
        submap = {"id": entry["id"], "scans": len(entry["scans"]), "origin": [len(origin["scans"]), origin["travelled"], origin["t_map_submap"]]}
        readers = {"tsdf": read_tsdf, "colr": read_colours, "occu": read_occupancy}
        found.append(submap | {tag: readers[tag](data) for tag, data in sections.items()})
    print(json.dumps(found))


main()
