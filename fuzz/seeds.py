"""Files for the fuzz targets to start from, written by other people's software: rosbags, mcap, laspy, pye57, Open3D.

usage: seeds.py FOLDER [DATA]

DATA is a folder with real data (see VOXELASTIC_DATA); of each kind of file the beginning is taken. Libraries that are not installed are
left out, with a word.
"""
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np

REPOSITORY = Path(__file__).resolve().parent.parent
K = np.arange(40)
XYZ = np.stack([1.0 + K * 0.25, np.sin(K), -0.5 * K - 1.0], axis=1)


def recordings(folder):
    sys.path.insert(0, str(REPOSITORY / "crates/parts/voxelastic-io/tests/all/bags"))
    import write

    write.SCANS, write.POINTS = 3, 32
    messages(folder / "message", write)
    with tempfile.TemporaryDirectory() as out:
        sys.argv = ["write.py", out]
        write.main()
        for target, pattern in (("ros1", "*.bag"), ("mcap", "*.mcap"), ("sqlite", "*/*.db3")):
            for file in Path(out).glob(pattern):
                shutil.copy(file, folder / target / file.name)


def messages(folder, write):
    """A letter for the type (as in fuzz_targets/message.rs; upper case for ROS 2), a message."""
    for ros1 in (True, False):
        drive = write.Drive(ros1=ros1)
        some = {f"a_{layout}": drive.cloud(1, layout) for layout in write.LAYOUTS}
        some |= {"b": drive.livox(1), "c": drive.odometry(1), "d": drive.pose_stamped(1), "f": drive.path(1), "g": drive.mounting()}
        for name, message in some.items():
            serialize = drive.store.serialize_ros1 if ros1 else drive.store.serialize_cdr
            letter = name[0] if ros1 else name[0].upper()
            (folder / f"{name}{1 if ros1 else 2}").write_bytes(letter.encode() + bytes(serialize(message, message.__msgtype__)))


def las(folder):
    import laspy

    for version, point_format in (("1.2", 1), ("1.2", 3), ("1.4", 6), ("1.4", 7)):
        cloud = laspy.LasData(laspy.LasHeader(version=version, point_format=point_format))
        cloud.header.scales = [1e-3] * 3
        cloud.x, cloud.y, cloud.z = XYZ.T
        cloud.intensity = K % 50
        for ending in ("las", "laz"):
            cloud.write(folder / f"{point_format}.{ending}")


def e57(folder):
    import pye57

    (folder / "stations.e57").unlink(missing_ok=True)
    file = pye57.E57(str(folder / "stations.e57"), mode="w")
    for station in range(2):
        columns = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), XYZ.T)) | {"intensity": K / 40.0}
        file.write_scan_raw(columns, rotation=np.array([1.0, 0, 0, 0]), translation=np.array([station, 0.0, 0.0]))
    file.close()


def open3d(folder):
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(XYZ))
    cloud.colors = o3d.utility.Vector3dVector(np.abs(XYZ) % 1.0)
    mesh = o3d.geometry.TriangleMesh.create_box()
    for text in (False, True):
        for packed in (False, True):
            o3d.io.write_point_cloud(str(folder / "pcd" / f"{text}{packed}.pcd"), cloud, write_ascii=text, compressed=packed)
        o3d.io.write_point_cloud(str(folder / "ply" / f"{text}.ply"), cloud, write_ascii=text)
        o3d.io.write_triangle_mesh(str(folder / "ply" / f"mesh{text}.ply"), mesh, write_ascii=text)


def texts(folder):
    unit = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1"
    lines = {
        "tum": lambda k: f"{k}.5 1 2 3 0 0.6 0 0.8",
        "kitti": lambda k: f"1 0 0 {k} 0 1e0 0 2 0 0 1 3",
        "newer_college": lambda k: f"{k},500000000,1,2,3,0,0.6,0,0.8",
        "g2o": lambda k: f"VERTEX_SE3:QUAT {k} 1 2 3 0 0 0 1\nEDGE_SE3:QUAT 0 {max(k, 1)} 1 0 0 0 0 0 1 {unit}",
    }
    for name, line in lines.items():
        (folder / "poses" / name).write_text("\n".join(map(line, range(5))) + "\n")
    np.concatenate([XYZ, XYZ[:, :1]], axis=1).astype("<f4").tofile(folder / "bin" / "kitti")


def dumps(folder):
    """A letter for the layout, as in src/dumps.rs, and its file."""
    unit, row = "1 0 0 2\n0 1 0 3\n0 0 1 4\n0 0 0 1\n", "1 0 0 2 0 1 0 3 0 0 1 4"
    fields = ("x", "y", "z", "intensity", "roll", "pitch", "yaw", "time")
    poses = np.array([[1, 2, 3, k, 0, 0, 0.5, 10 + k] for k in range(3)])
    files = {
        "a": f"stamp 1 5\nestimate\n{unit}odom\n{unit}accum_distance 1\nfloor_coeffs 0 0 1 2\nid 7\n",
        "b": (folder.parent / "poses" / "g2o").read_text(),
        "c": f"id: 0\nT_world_origin: \n{unit}T_origin_endpoint_L: \n{unit}num_frames: 1\nframe_0\nid: 0\nstamp: 1.25\nT_odom_lidar: \n{unit}",
        "d": "1 2 3 1 0 0 0\n1.5 2 3 0.8 0 0.6 0\n",
        "e": f"P0: {row}\nTr: {row}\n",
        "f": "".join(f"{k}00000000,{row.replace(' ', ',')}\n" for k in (9, 10, 11, 12)),
        "g": pcd_text(fields, poses),
        "h": (folder.parent / "poses" / "tum").read_text(),
        "i": "0.0\n1.5e0\n",
        "j": f"{row}\n",
        "k": (folder.parent / "poses" / "newer_college").read_text().replace("1,500000000", "1583836591,500000000"),
    }
    for letter, text in files.items():
        (folder / letter).write_text(letter + text)


def pcd_text(fields, rows):
    n = len(fields)
    head = f"FIELDS {' '.join(fields)}\nSIZE {'4 ' * (n - 1)}8\nTYPE {'F ' * n}\nCOUNT {'1 ' * n}\nWIDTH {len(rows)}\nHEIGHT 1\nPOINTS {len(rows)}\n"
    return f"VERSION 0.7\n{head}DATA ascii\n" + "\n".join(" ".join(map(str, row)) for row in rows) + "\n"


def real(folder, data):
    """Beginnings of real files."""
    ouster(folder / "ouster", data / "ouster")
    for name in ("hall/poses.tum", "kitti00-street/poses_odometry.txt", "kitti00-loops/times.txt"):
        lines = (data / name).read_text().splitlines()[:6]
        (folder / "poses" / name.replace("/", "_")).write_text("\n".join(lines) + "\n")
    for graph in data.glob("posegraphs/*.g2o"):
        lines = graph.read_text().splitlines()
        edges = [line for line in lines if line.startswith("EDGE")][:4]
        (folder / "poses" / graph.name).write_text("\n".join(lines[:5] + edges) + "\n")
    for scan in (data / "kitti00-street/velodyne/000000.bin", data / "newer-college-sample/raw_00.bin"):
        if scan.is_file():
            (folder / "bin" / f"{scan.parent.name}_{scan.name}").write_bytes(scan.read_bytes()[:960])
    for scan in (data / "hall/scans/000000.pcd", data / "kitti00-loops/Scans/000000.pcd"):
        head, body = scan.read_bytes().split(b"DATA binary\n", 1)
        count = head.split(b"POINTS ")[1].split()[0]
        (folder / "pcd" / f"{scan.parent.parent.name}.pcd").write_bytes(head.replace(count, b"20") + b"DATA binary\n" + body[: 20 * 12])


def ouster(folder, captures):
    for metadata in captures.glob("*.json"):
        for capture in captures.glob(metadata.stem[:6] + "*.pcap"):
            (folder / f"{capture.stem}-{metadata.stem}").write_bytes(metadata.read_bytes() + b"\0" + capture.read_bytes()[:60_000])


def packets(folder):
    """A table of angles, if any, a zero byte, and a capture: packets of a Velodyne VLP-16, a Hesai PandarXT-32 and a Pandar40P."""
    measured = b"\x00\x10\x20"
    blocks = [b"\xff\xee" + (1000 * k).to_bytes(2, "little") + 32 * measured for k in range(12)]
    velodyne = b"".join(blocks) + (60_000_000).to_bytes(4, "little") + b"\x39\x22"
    blocks = [(1000 * k).to_bytes(2, "little") + 32 * (measured + b"\0") for k in range(8)]
    tail = bytes(10) + bytes([0x37, 0, 0, 123, 11, 14, 22, 25, 0]) + bytes(4) + b"\x42" + bytes(4)
    xt = b"\xee\xff\x06\x01\0\0\x20\x08\0\x04\x01\x01" + b"".join(blocks) + tail
    blocks = [b"\xff\xee" + (1000 * k).to_bytes(2, "little") + 40 * measured for k in range(10)]
    pandar = b"".join(blocks) + bytes(14) + bytes([0x37, 0x42, 23, 11, 14, 22, 25, 0]) + bytes(4)
    angles = "Channel,Elevation,Azimuth\n" + "".join(f"{k + 1},{15 - k},0.5\n" for k in range(32))
    for name, table, packet in (("velodyne", "", velodyne), ("xt", angles, xt), ("pandar", "", pandar)):
        capture = b"".join(n.to_bytes(4, "little") for n in (0xA1B2C3D4, 0x00040002, 0, 0, 65535, 1))
        for k in range(3):
            udp = len(packet) + 8
            ip = b"\x45\0" + (udp + 20).to_bytes(2, "big") + bytes([0, 0, 0, 0, 64, 17, 0, 0, 192, 168, 1, 201, 255, 255, 255, 255])
            frame = bytes(12) + b"\x08\0" + ip + b"\x09\x40\x09\x40" + udp.to_bytes(2, "big") + b"\0\0" + packet
            capture += b"".join(n.to_bytes(4, "little") for n in (1_700_000_000, 1000 * k, len(frame), len(frame))) + frame
        (folder / name).write_bytes(table.encode() + b"\0" + capture)


def maps(folder):
    """What follows the checksum of the manifest that is kept; journals and states, as in fuzz_targets/journal.rs."""
    kept = REPOSITORY / "crates/parts/voxelastic-io/tests/fixtures/map-v4/manifest.json"
    (folder / "manifest" / "kept").write_bytes(kept.read_bytes().split(b'"crc32": "', 1)[1][8:])
    (folder / "journal" / "records").write_bytes(b"\0!\x03abc!\0!\x05hello")
    (folder / "journal" / "cut").write_bytes(b"\0!\x03abc\x10\0\0\0\0\0\0\0")
    pose = "[0.0,0.0,0.0,0.0,0.0,0.0,1.0]"
    table = f'{{"submaps":[{{"id":0,"t_map_submap":{pose}}}],"journal":["journal-00000001.vxj",19]}}'.encode()
    (folder / "journal" / "state").write_bytes(b"\1" + len(table).to_bytes(8, "little") + table + b"state")


def asked(folder):
    """What clients send."""
    for name, request in {
        "page": "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n",
        "health": "GET /health HTTP/1.1\r\nHost: [::1]:80\r\nOrigin: http://[::1]:80\r\n\r\n",
        "stranger": "GET / HTTP/1.1\r\nHost: evil.test\r\nOrigin: http://evil.test\r\n\r\n",
        "socket": "GET /socket?session=1&tiles=2 HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n",
        "load": "POST /load HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer a-token-for-fuzzing\r\nContent-Length: 4\r\n\r\na.vox",
        "chunks": "POST /save HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer a-token-for-fuzzing\r\nTransfer-Encoding: chunked\r\n\r\n1\r\na\r\n0\r\n\r\n",
    }.items():
        (folder / "http" / name).write_bytes(request.encode())
    subscribe = b'{"op":"subscribe","subscriptions":[{"id":7,"channelId":1},{"id":8,"channelId":2}]}'
    leave = b'{"op":"unsubscribe","subscriptionIds":[7]}'
    (folder / "frames" / "texts").write_bytes(b"\3" + b"".join(bytes([len(text)]) + text for text in (subscribe, leave, b'{"op":"other"}')))
    for kind in (0, 1):
        (folder / "frames" / f"raw{kind}").write_bytes(bytes([kind]) + b"\x89\x82\1\2\3\4ab\x01\x81\0\0\0\0a\x80\x81\0\0\0\0b\x88\x80\0\0\0\0")


def pictures(folder):
    """Of the size that fuzz_targets/images.rs takes."""
    import cv2

    image = np.arange(16 * 24 * 3, dtype=np.uint8).reshape(16, 24, 3)
    for name, content, options in (
        ("colour.png", image, []),
        ("grey.png", image[..., 0], []),
        ("deep.png", image.astype(np.uint16) * 200, []),
        ("palette.png", image[..., 0] // 128 * 255, [cv2.IMWRITE_PNG_BILEVEL, 1]),
        ("colour.jpg", image, []),
        ("grey.jpg", image[..., 0], []),
        ("progressive.jpg", image, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_RST_INTERVAL, 1]),
    ):
        cv2.imwrite(str(folder / name), content, options)


def main():
    folder = Path(sys.argv[1])
    data = Path(sys.argv[2]) if len(sys.argv) > 2 else None
    for target in ("ros1", "mcap", "sqlite", "message", "las", "e57", "pcd", "ply", "poses", "bin", "ouster", "packets", "dumps", "images", "manifest", "journal", "http", "frames"):
        (folder / target).mkdir(parents=True, exist_ok=True)
    texts(folder)
    dumps(folder / "dumps")
    packets(folder / "packets")
    maps(folder)
    asked(folder)
    if data:
        real(folder, data)
    for write, where in ((las, folder / "las"), (e57, folder / "e57"), (open3d, folder), (pictures, folder / "images"), (recordings, folder)):
        try:
            write(where)
        except ImportError as error:
            print(f"{write.__name__} is left out: {error}", file=sys.stderr)


if __name__ == "__main__":
    main()
