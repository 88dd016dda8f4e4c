"""Files for the fuzz targets to start from, written by other people's software: rosbags, mcap, laspy, pye57, Open3D.

usage: seeds.py FOLDER [OUSTER]

OUSTER is a folder with captures (.pcap) and their metadata (.json); of each the first packets are taken. Libraries that are not
installed are left out, with a word.
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
    sys.path.insert(0, str(REPOSITORY / "crates/voxelastic-io/tests/bags"))
    import write

    write.SCANS, write.POINTS = 3, 32
    with tempfile.TemporaryDirectory() as out:
        sys.argv = ["write.py", out]
        write.main()
        for target, pattern in (("ros1", "*.bag"), ("mcap", "*.mcap"), ("sqlite", "*/*.db3")):
            for file in Path(out).glob(pattern):
                shutil.copy(file, folder / target / file.name)


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


def ouster(folder, captures):
    for metadata in captures.glob("*.json"):
        for capture in captures.glob(metadata.stem[:6] + "*.pcap"):
            (folder / f"{capture.stem}-{metadata.stem}").write_bytes(metadata.read_bytes() + b"\0" + capture.read_bytes()[:60_000])


def main():
    folder = Path(sys.argv[1])
    captures = Path(sys.argv[2]) if len(sys.argv) > 2 else None
    for target in ("ros1", "mcap", "sqlite", "las", "e57", "pcd", "ply", "poses", "bin", "ouster"):
        (folder / target).mkdir(parents=True, exist_ok=True)
    texts(folder)
    if captures:
        ouster(folder / "ouster", captures)
    for write, where in ((las, folder / "las"), (e57, folder / "e57"), (open3d, folder), (recordings, folder)):
        try:
            write(where)
        except ImportError as error:
            print(f"{write.__name__} is left out: {error}", file=sys.stderr)


if __name__ == "__main__":
    main()
