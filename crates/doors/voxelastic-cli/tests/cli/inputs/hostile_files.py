"""Files that were made to harm, of every kind that is read; Python's own library is enough. `all_cases` gives the name of each, its files, and what is done with them."""

import json
import math
import struct
import zlib

from hostile_recordings import ESCAPE, HUGE, bags, le, mcaps, pcaps, points, sqlites

# Not a number, and numbers that overflow when they are added.
ODD = (math.nan, math.inf, -1e308)


# Clouds as files.


def pcd(count=600, body=None, data="binary", fields="x y z", size="4 4 4", kind="F F F", each="1 1 1", width=None):
    head = f"VERSION 0.7\nFIELDS {fields}\nSIZE {size}\nTYPE {kind}\nCOUNT {each}\nWIDTH {count if width is None else width}\nHEIGHT 1\nPOINTS {count}\nDATA {data}\n"
    return head.encode() + (points() if body is None else body)


def pcds():
    for count in (0, -1, 10**12, 2**62, 2**64 - 1, 2**64):
        for data in ("ascii", "binary", "binary_compressed"):
            yield f"{data} of {count}", pcd(count, data=data)
    yield "width", pcd(width=10**12)
    yield "size", pcd(size="4 4 4000000000")
    yield "each", pcd(2**62, each="1 1 4611686018427387904")
    yield "fields", pcd(1, fields="x y z " + "a " * 100_000, size="4 " * 100_003, kind="F " * 100_003, each="1 " * 100_003)
    yield "lzf of zeros", pcd(10**9, data="binary_compressed", body=le("II", 3_000_004, 2**32 - 1) + b"\0\0" + b"\xe0\xff\0" * 1_000_000)
    yield "lzf that claims", pcd(100, data="binary_compressed", body=le("II", 2**32 - 1, 1200) + bytes(10))
    yield "escapes", pcd(fields="x y " + ESCAPE.decode())
    for name, value in (("nan", math.nan), ("inf", math.inf), ("tiny", 1e-40), ("large", 3e38)):
        yield name, pcd(body=le("f", value) * 1800)
    yield "line", b"VERSION " + b"7" * 20_000_000


def plys():
    xyz = "property float x\nproperty float y\nproperty float z\n"
    for form in ("ascii", "binary_little_endian", "binary_big_endian"):
        head = f"ply\nformat {form} 1.0\n"
        for count in (10**12, 2**64 - 1):
            yield f"{form} of {count}", (head + f"element vertex {count}\n{xyz}end_header\n").encode() + points()
            yield f"{form} nothing {count}", (head + f"element no {count}\nelement vertex 1\n{xyz}end_header\n").encode() + points()
        yield f"{form} list", (head + f"element a 1\nproperty list uint double l\nelement vertex 9\n{xyz}end_header\n").encode() + b"\xff" * 900
    yield "elements", b"ply\nformat ascii 1.0\n" + b"element a 0\nproperty float x\n" * 50_000 + b"end_header\n"
    yield "line", b"ply\ncomment " + b"a" * 20_000_000
    yield "escapes", b"ply\nformat " + ESCAPE + b" 1.0\n"


def las(count=10, minor=4, at=375, length=30, kind=6, vlrs=0, evlrs=0, evlr_at=0, scale=0.001, body=bytes(3000)):
    head = bytearray(375)
    head[0:4], head[24], head[25] = b"LASF", 1, minor
    struct.pack_into("<HIIBH", head, 94, 375, at, vlrs, kind, length)
    struct.pack_into("<I", head, 107, min(count, 2**32 - 1))
    struct.pack_into("<12d", head, 131, *3 * [scale], 0, 0, 0, 1, 0, 1, 0, 1, 0)
    struct.pack_into("<QIQ", head, 235, evlr_at, evlrs, min(count, 2**64 - 1))
    return bytes(head) + body


def lass():
    laszip = bytes(2) + b"laszip encoded".ljust(16, b"\0") + le("HH", 22204, 46) + bytes(32)
    items = le("HHBBHIIqqH", 3, 0, 3, 4, 0, 0, 50000, -1, -1, 1) + le("HHH", 10, 30, 3)
    for name, options in {
        "count": {"count": 10**12}, "vlrs": {"vlrs": 2**32 - 1}, "evlrs": {"evlrs": 2**32 - 1, "evlr_at": 400}, "offset": {"at": 2**32 - 1},
        "no length": {"length": 0}, "long points": {"length": 65535}, "kind": {"kind": 99}, "packed": {"kind": 0x86}, "old": {"minor": 0},
        "packed count": {"kind": 0x86, "count": 10**12, "vlrs": 1, "at": 375 + 54 + 46, "body": laszip + items + le("q", -1) + bytes(99)},
        "packed items": {"kind": 0x86, "vlrs": 1, "at": 375 + 54 + 46, "body": laszip + b"\xff" * 46 + bytes(99)},
        "packed table": {"kind": 0x86, "vlrs": 1, "at": 475, "body": laszip + items + le("q", 483) + le("II", 0, 2**32 - 1) + b"\xff" * 99},
    }.items():  # fmt: skip
        yield name, las(**options)
    for value in (*ODD, 0.0):
        yield f"scale {value}", las(scale=value, body=b"\xff\x7f" * 1500)


def crc32c(data):
    crc = 0xFFFFFFFF
    for byte in data:
        crc = CRC32C[(crc ^ byte) & 255] ^ crc >> 8
    return crc ^ 0xFFFFFFFF


def crc32c_of(byte):
    for _ in range(8):
        byte = byte >> 1 ^ (0x82F63B78 if byte & 1 else 0)
    return byte


CRC32C = [crc32c_of(byte) for byte in range(256)]


def e57(xml, section=bytes(64)):
    """A section of packed points at byte 48, the XML behind it, in pages with checksums."""
    content = bytearray(48) + section + xml
    pages = -(-len(content) // 1020)
    at = 48 + len(section)
    struct.pack_into("<8sIIQQQQ", content, 0, b"ASTM-E57", 1, 0, pages * 1024, at // 1020 * 1024 + at % 1020, len(xml), 1024)
    content += bytes(pages * 1020 - len(content))
    parts = [bytes(content[k : k + 1020]) for k in range(0, len(content), 1020)]
    return b"".join(part + struct.pack(">I", crc32c(part)) for part in parts)


def e57_xml(count, prototype, before=""):
    fields = "".join(f'<cartesian{axis} type="{prototype}"/>' for axis in "XYZ")
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>{before}<e57Root type="Structure" xmlns="http://www.astm.org/COMMIT/E57/2010-e57-v1.0">'
        f'<formatName type="String">ASTM E57 3D Imaging Data File</formatName><guid type="String">a</guid><versionMajor type="Integer">1</versionMajor>'
        f'<versionMinor type="Integer">0</versionMinor><data3D type="Vector" allowHeterogeneousChildren="1"><vectorChild type="Structure"><guid type="String">b</guid><points type="CompressedVector" fileOffset="48" recordCount="{count}">'
        f'<prototype type="Structure">{fields}</prototype><codecs type="Vector"/></points></vectorChild></data3D></e57Root>'
    ).encode()


def e57s():
    zero_bits = 'ScaledInteger" minimum="0" maximum="0" scale="1" offset="0'
    single, wide = 'Float" precision="single', 'Integer" minimum="-9223372036854775808" maximum="9223372036854775807'
    section = le("B7xQQQ", 1, 64, 80, 0)
    packet = lambda lengths, size=64: le("BBHH", 1, 0, size - 1, len(lengths)) + b"".join(le("H", n) for n in lengths) + bytes(60)
    for count in (0, 10**6, 10**9, 10**12, 2**63 - 1, -1):
        for name, prototype in (("no bits", zero_bits), ("singles", single), ("wide", wide)):
            yield f"{name} {count}", e57(e57_xml(count, prototype), section + packet([0, 0, 0]))
    yield "packet", e57(e57_xml(9, single), section + packet([65535] * 3, 65536))
    yield "no packet", e57(e57_xml(9, single), le("B7xQQQ", 1, HUGE, HUGE, HUGE))
    yield "many streams", e57(e57_xml(9, single), section + packet([0] * 20, 12))
    # A bit of x for each point, and nothing of y and z: what the decoder keeps of x grows by 128 times.
    bit = 'ScaledInteger" minimum="0" maximum="1" scale="1" offset="0'
    ahead = le("BBHH", 1, 0, 65535 - 24, 3) + b"".join(le("H", n) for n in (65500, 0, 0)) + bytes(65500)
    ahead += bytes(-len(ahead) % 4)
    yield "one stream ahead", e57(e57_xml(10**7, bit), section[:32] + ahead * 110)
    laughs = "".join(f'<!ENTITY a{k + 1} "{f"&a{k};" * 10}">' for k in range(9))
    yield "entities", e57(e57_xml("&a9;", single, f'<!DOCTYPE a [<!ENTITY a0 "ha">{laughs}]>'))
    yield "deep", e57(b"<e57Root>" + b"<a>" * 100_000)
    yield "escapes", e57(b"<e57Root " + ESCAPE)
    yield "not a number", e57(e57_xml(9, f'ScaledInteger" minimum="0" maximum="9" scale="{ESCAPE.decode()}'))


# Images, for a camera of a size.


def png(width, height, zeros, kind=2, depth=8, more=b"", interlaced=0):
    chunk = lambda name, data: struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
    packer = zlib.compressobj(9)
    data = b"".join(packer.compress(bytes(1 << 20)) for _ in range(zeros >> 20)) + packer.compress(bytes(zeros % (1 << 20))) + packer.flush()
    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, interlaced))
    return b"\x89PNG\r\n\x1a\n" + head + more + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def jpeg(width, height, parts=3, scans=1, progressive=False, marks=b""):
    table = b"\xff\xdb\0\x43\0" + bytes([1]) * 64
    code = b"\xff\xc4\0\x14\0" + bytes([1]) + bytes(15) + b"\0" + b"\xff\xc4\0\x14\x10" + bytes([1]) + bytes(15) + b"\0"
    head = struct.pack(">HHBHHB", 8 + 3 * parts, 0, 0, 0, 0, 0)
    head = b"\xff" + (b"\xc2" if progressive else b"\xc0") + struct.pack(">HBHHB", 8 + 3 * parts, 8, height, width, parts) + b"".join(bytes([k + 1, 0x11, 0]) for k in range(parts))
    scan = b"\xff\xda" + struct.pack(">HB", 6 + 2 * parts, parts) + b"".join(bytes([k + 1, 0]) for k in range(parts)) + (b"\0\0\0" if progressive else b"\0\x3f\0") + bytes(40)
    return b"\xff\xd8" + marks + table + head + code + scan * scans + b"\xff\xd9"


def images():
    profile = lambda zeros: (lambda data: struct.pack(">I", len(data)) + b"iCCP" + data + struct.pack(">I", zlib.crc32(b"iCCP" + data)))(b"a\0\0" + zlib.compress(bytes(zeros), 9))
    for size in (16, 4000, 16_000, 30_000, 65_500):
        yield f"png {size}", size, png(size, size, min(size * (3 * size + 1), 300 << 20))
        yield f"png of 16 bits {size}", size, png(size, size, min(size * (8 * size + 1), 200 << 20), kind=6, depth=16)
        yield f"png in passes {size}", size, png(size, size, 10**6, interlaced=1)
        for progressive in (False, True):
            yield f"jpeg {progressive} {size}", size, jpeg(size, size, progressive=progressive)
    yield "png with a profile", 16, png(16, 16, 16 * 49, more=profile(200 << 20))
    yield "png of too much", 16, png(16, 16, 200 << 20)
    yield "png of nothing", 16, png(0, 0, 0)
    for scans in (100, 5000):
        yield f"jpeg of {scans} scans", 2000, jpeg(2000, 2000, scans=scans, progressive=True)
    yield "jpeg of four colours", 16, jpeg(16, 16, parts=4)
    yield "jpeg of 255 colours", 16, jpeg(16, 16, parts=255)
    yield "jpeg with marks", 16, jpeg(16, 16, marks=b"\xff\xe1\xff\xff" + bytes(65533) + b"\xff\xfe\0\x02" * 10_000)


# Texts.


def texts():
    deep = b"[" * 200_000
    row = lambda value: f"0 {value} 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n".encode()
    for value in (*ODD, 1e300, "9" * 100_000):
        yield f"tum {str(value)[:9]}", "poses.tum", row(value)
    yield "tum without rotations", "poses.tum", b"0 0 0 0 0 0 0 0\n1 0 0 0 0 0 0 0\n"
    yield "tum line", "poses.tum", b"0 " * 10_000_000
    yield "tum escapes", "poses.tum", ESCAPE + b"\n"
    for name in ("pose.json", "poses.json", "graph.g2o", "poses.csv", "times.txt", "poses.txt"):
        yield f"{name} deep", name, deep
        yield f"{name} line", name, b"1" * 5_000_000
        yield f"{name} of zeros", name, bytes(100_000)
    yield "graph of one node", "graph.g2o", b"VERTEX_SE3:QUAT 18446744073709551615 0 0 0 0 0 0 1\n" + b"EDGE_SE3:QUAT 0 18446744073709551615 1\n" * 10_000


def manifests():
    def manifest(rest):
        head = b'{\n"format": "voxelastic map",\n"version": 4,\n"crc32": "'
        return head + b"%08x" % zlib.crc32(head + b"00000000" + rest) + rest

    rest = lambda submaps, settings="{}": f'",\n"generator": "x",\n"settings": {settings},\n"sensor": {{}},\n"submaps": {submaps}\n}}\n'.encode()
    entry = {
        "id": 0, "file": "submap-000000-0000000000000000.vxs", "bytes": HUGE, "crc32": 0, "t_map_submap": [0, 0, 0, 0, 0, 0, 1], "travelled": 0,
        "tsdf": {"blocks_by_scale": [HUGE] * 4, "memory_bytes": HUGE}, "occupancy": {"octants": HUGE, "blocks_by_scale": [HUGE] * 4, "memory_bytes": HUGE}, "scans": [], "corrected": [],
    }  # fmt: skip
    yield "claims", manifest(rest(json.dumps([entry])))
    yield "a file elsewhere", manifest(rest(json.dumps([entry | {"file": "../../etc/passwd"}])))
    yield "not a number", manifest(rest(json.dumps([entry | {"t_map_submap": [1e308] * 7, "travelled": 1e308}])))
    yield "deep", manifest(rest("[" * 100_000))
    yield "many", manifest(rest("[" + "{}," * 100_000 + "{}]"))
    for value in ("0", "-1", "nan", "1e-30", "1e30", ESCAPE.decode("latin1").replace("\x1b", "\\u001b").replace("\x07", "")):
        yield f"voxels of {value[:9]}", manifest(rest("[]", f'{{"voxel_size": "{value}"}}'))


def configurations():
    yield "deep", b"a = " + b"[" * 100_000
    yield "tables", b"[a" + b".a" * 50_000 + b"]\nb = 1\n"
    yield "long", b"voxel_size = " + b"1" * 1_000_000
    yield "escapes", b"voxel_size = '" + ESCAPE + b"'"


TWO_POSES = b"0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n"
MAP = "map {data} -o {out}.vox --voxel-size 0.3 --max-scans 4 --threads 1 --overwrite --restart"


def all_cases():
    """Name, files by path, command."""
    for ending, cases in (("pcd", pcds), ("ply", plys)):
        for name, data in cases():
            yield f"{ending} {name}", {f"scans/00000{k}.{ending}": data for k in range(2)} | {"poses.tum": TWO_POSES}, MAP
    for name, data in lass():
        ending = "laz" if name.startswith("packed") else "las"
        yield f"{ending} {name}", {f"a.{ending}": data}, f"info {{data}}/a.{ending}"
    for ending, cases in (("e57", e57s), ("mcap", mcaps), ("bag", bags), ("db3", sqlites), ("pcap", pcaps)):
        for name, data in cases():
            yield f"{ending} {name}", {f"a.{ending}": data}, MAP.replace("{data}", f"{{data}}/a.{ending}")
    for name, file, data in texts():
        yield f"text {name}", {f"scans/00000{k}.pcd": pcd() for k in range(2)} | {file: data}, MAP + f" --poses {{data}}/{file}"
    for name, data in manifests():
        yield f"map {name}", {"a.vox/manifest.json": data, "a.vox/submap-000000-0000000000000000.vxs": bytes(100)}, "info {data}/a.vox --check"
    for name, data in configurations():
        yield f"settings {name}", {"scans/000000.pcd": pcd(), "a.toml": data}, MAP + " --config {data}/a.toml"
    for name, size, data in images():
        camera = f'[[camera]]\nname = "a"\nimages = "a"\nwidth = {size}\nheight = {size}\nfx = 20.0\nfy = 20.0\ncx = 8.0\ncy = 8.0\nt_lidar_camera = [0, 0, 0, 0, 0, 0, 1]\n'
        yield f"image {name}", {f"a/0.{k}.{name[:3].replace('jpe', 'jpg')}": data for k in (1, 2)} | {"cameras.toml": camera.encode()}, "mesh {good} -o {out}.ply --images {data}"
