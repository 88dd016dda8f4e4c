"""Recordings that were made to harm: bombs in every compression, claims in every length."""

import bz2
import math
import sqlite3
import struct
import tempfile
from pathlib import Path

GIGABYTE = 1 << 30
HUGE = 2**63 - 1
ESCAPE = b"\x1b]0;PWNED\x07\x1b[31m"


def le(layout, *values):
    return struct.pack("<" + layout, *values)


def points(count=600):
    return b"".join(le("fff", 5 * math.cos(0.1 * k), 5 * math.sin(0.1 * k), 0.2 * (k % 16) - 1) for k in range(count))


# What unpacks to a gigabyte: text and then zeros.


def zstd(text, zeros):
    blocks = [(0, len(text), text)] + [(1, min(1 << 17, zeros - at), b"\0") for at in range(0, zeros, 1 << 17)]
    packed = b"".join(struct.pack("<I", (size << 3) | (kind << 1) | (k == len(blocks) - 1))[:3] + data for k, (kind, size, data) in enumerate(blocks))
    return b"\x28\xb5\x2f\xfd\x00\x58" + packed


def xxh32_of_two(data):
    """Of two bytes, as at the head of a frame."""
    mask, h = 0xFFFFFFFF, 374761393 + 2
    for byte in data:
        h = (h + byte * 374761393) & mask
        h = ((h << 11 | h >> 21) & mask) * 2654435761 & mask
    h ^= h >> 15
    h = h * 2246822519 & mask
    h ^= h >> 13
    h = h * 3266489917 & mask
    return h ^ h >> 16


def lz4(text, zeros):
    head, blocks = b"\x60\x70", []
    while zeros > 0 or text:
        part = min(zeros, 4_000_000)
        literals = text + b"\0"
        long = lambda n: bytes([255]) * (n // 255) + bytes([n % 255])
        first = bytes([0xFF]) + long(len(literals) - 15) if len(literals) >= 15 else bytes([len(literals) << 4 | 15])
        block = first + literals + b"\1\0" + long(max(part - 25, 0)) + b"\x50" + bytes(5)
        blocks.append(le("I", len(block)) + block)
        zeros, text = zeros - 4_000_000, b""
    return b"\x04\x22\x4d\x18" + head + bytes([xxh32_of_two(head) >> 8 & 255]) + b"".join(blocks) + bytes(4)


def bzip2(text, zeros):
    packer = bz2.BZ2Compressor(1)
    packed = packer.compress(text)
    for _ in range(zeros >> 24):
        packed += packer.compress(bytes(1 << 24))
    return packed + packer.flush()


PACKED = {"zstd": zstd, "lz4": lz4, "none": lambda text, zeros: text + bytes(min(zeros, 1000))}


# Recordings.


def cloud_head(count, ros1=False):
    """A PointCloud2 up to its points."""
    text = (lambda t: le("I", len(t)) + t) if ros1 else (lambda t: le("I", len(t) + 1) + t + b"\0")
    out = le("III", 7, 1, 0) if ros1 else b"\0\1\0\0" + le("II", 1, 0)
    pad = (lambda n: b"") if ros1 else (lambda n: bytes(-(len(out) - 4) % n))
    out += text(b"lidar")
    out += pad(4) + le("III", 1, count, 3)
    for k, name in enumerate((b"x", b"y", b"z")):
        out += pad(4) + text(name)
        out += pad(4) + le("IB", 4 * k, 7)
        out += pad(4) + le("I", 1)
    out += b"\0"
    out += pad(4) + le("II", 12, 12 * count)
    return out + le("I", 12 * count)


def text32(text):
    return le("I", len(text)) + text


def mcap_record(kind, body):
    return le("BQ", kind, len(body)) + body


def mcap(*records):
    magic = b"\x89MCAP0\r\n"
    return magic + mcap_record(1, text32(b"ros2") + text32(b"")) + b"".join(records) + mcap_record(15, le("I", 0)) + mcap_record(2, le("QQI", 0, 0, 0)) + magic


CHANNEL = mcap_record(3, le("H", 1) + text32(b"sensor_msgs/msg/PointCloud2") + text32(b"ros2msg") + text32(b"")) + mcap_record(
    4, le("HH", 1, 1) + text32(b"/points") + text32(b"cdr") + le("I", 0)
)


def mcap_chunk(kind, text, zeros, claimed=None):
    packed = PACKED[kind](text, zeros)
    size = len(text) + zeros if claimed is None else claimed
    return mcap_record(6, le("QQQI", 0, 10, size, 0) + text32(b"" if kind == "none" else kind.encode()) + le("Q", len(packed)) + packed)


def mcaps():
    for kind in PACKED:
        for zeros in (10**6, GIGABYTE - 1024, 4 * GIGABYTE - 4096):
            if kind == "lz4" and zeros > GIGABYTE:
                continue
            count = zeros // 12
            message = le("HIQQ", 1, 0, 1, 1) + cloud_head(count)
            text = CHANNEL + le("BQ", 5, len(message) + 12 * count) + message
            yield f"{kind} {zeros}", mcap(mcap_chunk(kind, text, zeros))
            yield f"{kind} {zeros} many", mcap(*8 * [mcap_chunk(kind, text, zeros)])
            for claimed in (0, len(text), HUGE, 2**64 - 1):
                yield f"{kind} {zeros} as {claimed}", mcap(mcap_chunk(kind, text, zeros, claimed))
    for length in (10**12, HUGE, 2**64 - 1):
        for kind in (3, 4, 5, 6, 200):
            yield f"record {kind} of {length}", mcap(CHANNEL, le("BQ", kind, length) + bytes(99))
    for count in (2**32 - 1, 10**6):
        yield f"points {count}", mcap(CHANNEL, mcap_record(5, le("HIQQ", 1, 0, 1, 1) + cloud_head(count % 2**28)[:-4] + le("I", count) + points()))
    yield "summary", mcap(CHANNEL)[:-28] + le("QQI", HUGE, HUGE, 0) + b"\x89MCAP0\r\n"
    yield "escapes", mcap(mcap_record(3, le("H", 1) + text32(ESCAPE) + text32(ESCAPE) + text32(b"")) + mcap_record(4, le("HH", 1, 1) + text32(ESCAPE) + text32(b"cdr") + le("I", 0)))


def bag_record(data, **fields):
    head = b"".join(text32(name.encode() + b"=" + value) for name, value in fields.items())
    return text32(head) + data


CONNECTION = bag_record(
    text32(b"topic=/points") + text32(b"type=sensor_msgs/PointCloud2") + text32(b"md5sum=1158d486dd51d683ce2f1be655c3c181") + text32(b"message_definition=x"),
    op=b"\x07", conn=le("I", 0), topic=b"/points",
)  # fmt: skip


def bag(*records, index=0, connections=1, chunks=1):
    head = bag_record(b"", op=b"\x03", index_pos=le("Q", index), conn_count=le("I", connections), chunk_count=le("I", chunks))
    return b"#ROSBAG V2.0\n" + head + b"".join(records)


def bags():
    packed = {"bz2": bzip2, "lz4": lz4, "none": PACKED["none"]}
    for kind, pack in packed.items():
        for zeros in (10**6, GIGABYTE - 1024):
            count = zeros // 12
            message = text32(b"".join(text32(f) for f in (b"op=\2", b"conn=" + le("I", 0), b"time=" + le("II", 1, 0))))
            head = cloud_head(count, ros1=True)
            text = CONNECTION + message + le("I", len(head) + 12 * count) + head
            data = pack(text, zeros)
            for claimed in (len(text) + zeros, 0, 2**32 - 1):
                chunk = bag_record(text32(data), op=b"\x05", compression=kind.encode(), size=le("I", claimed % 2**32))
                yield f"{kind} {zeros} as {claimed}", bag(chunk)
            yield f"{kind} {zeros} many", bag(*4 * [bag_record(text32(data), op=b"\x05", compression=kind.encode(), size=le("I", (len(text) + zeros) % 2**32))])
    for length in (2**31, 2**32 - 1):
        yield f"head of {length}", bag(le("I", length) + bytes(99))
        yield f"data of {length}", bag(text32(text32(b"op=\5")) + le("I", length) + bytes(99))
        yield f"field of {length}", bag(text32(le("I", length)) + bytes(99))
    for index in (HUGE, 2**64 - 1, 13):
        yield f"index at {index}", bag(CONNECTION, index=index, connections=2**32 - 1, chunks=2**32 - 1)
    yield "escapes", bag(bag_record(text32(b"topic=" + ESCAPE) + text32(b"type=" + ESCAPE), op=b"\x07", conn=le("I", 0), topic=ESCAPE))


def sqlite(messages):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.db3"
        base = sqlite3.connect(path)
        base.execute("create table topics(id integer primary key, name text, type text, serialization_format text, offered_qos_profiles text)")
        base.execute("create table messages(id integer primary key, topic_id integer, timestamp integer, data blob)")
        base.execute("insert into topics values(1, '/points', 'sensor_msgs/msg/PointCloud2', 'cdr', '')")
        base.executemany("insert into messages values(?, 1, ?, ?)", ((k, 10**8 * k, data) for k, data in enumerate(messages)))
        base.commit()
        base.close()
        return path.read_bytes()


def sqlites():
    for zeros in (10**6, GIGABYTE - 1024, 4 * GIGABYTE - 4096):
        data = zstd(cloud_head(zeros // 12), zeros)
        for count in (1, 8):
            yield f"{count} of {zeros}", sqlite([data] * count)
    good = sqlite([cloud_head(600) + points()] * 5)
    for at in (16, 18, 20, 21, 28, 32, 36, 44, 56, 96, 100, 103, 105, 107, 108, 4096, 4099, 4101, 4104, 8192, 8195, 8197, 8200, len(good) - 4096, len(good) - 4000):
        for value in (b"\xff\xff\xff\xff", b"\0\0\0\1"):
            yield f"{value.hex()} at {at}", good[:at] + value + good[at + 4 :]
    yield "escapes", good.replace(b"/points", ESCAPE[:7])
    yield "cut", good[: len(good) // 2]


def pcaps():
    head = le("IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)
    for size in (0, 1 << 18, 1 << 31, 2**32 - 1):
        yield f"record of {size}", head + le("IIII", 1, 0, size, size) + bytes(2000)
    yield "link", head[:-4] + le("I", 999) + bytes(99)
    blocks = lambda *sizes: b"".join(le("II", 0x0A0D0D0A, size) + le("I", 0x1A2B3C4D) + bytes(16) + le("I", size) for size in sizes)
    for size in (0, 8, 12, 28, 2**32 - 4):
        yield f"block of {size}", blocks(28, size)
    fragments = b""
    for k in range(3000):
        ip = b"\x45\0" + struct.pack(">HHH", 1028, k, 0x2000 | k % 8191) + b"\x40\x11\0\0" + bytes(8) + bytes(1008)
        frame = bytes(12) + b"\x08\0" + ip
        fragments += le("IIII", k, 0, len(frame), len(frame)) + frame
    yield "fragments", head + fragments
