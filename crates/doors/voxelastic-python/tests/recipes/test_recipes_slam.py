"""The recipes of the book for what SLAM systems leave: KISS-ICP, FAST-LIO, LIO-SAM, GLIM. The data are a simulated walk in exactly their layouts; the maps are compared with the world."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recipe_bags import Bag, Fields
from recipe_files import XYZI, floats, kitti_rows, matrix, pcd, tum_rows, xyz
from recipe_world import SMALL, SWEEP_S, Array, Walk, intensities, measured, rigid, rotations, spinning, sweep, undistorted, voxelastic

HDL32 = np.linspace(10.67, -30.67, 32)
VLP32 = np.linspace(15, -25, 32)
WALK = Walk()
BEGIN = 1_700_000_000.0
VELODYNE: Fields = (("x", 0, "f4"), ("y", 4, "f4"), ("z", 8, "f4"), ("intensity", 12, "f4"), ("ring", 16, "u2"), ("time", 18, "f4"))
"""Points of velodyne_pointcloud, 22 bytes."""
REGISTERED: Fields = (
    *(("x", 0, "f4"), ("y", 4, "f4"), ("z", 8, "f4"), ("normal_x", 16, "f4"), ("normal_y", 20, "f4")),
    *(("normal_z", 24, "f4"), ("intensity", 32, "f4"), ("curvature", 36, "f4")),
)
"""PCL's PointXYZINormal, 48 bytes, in which FAST-LIO publishes; `curvature` has milliseconds."""


def folder_without_times(folder: Path) -> Path:
    """Clouds whose points have times, and a pose for each, but no times of clouds."""
    beams = spinning(HDL32, 240, by_column=True)
    times = SWEEP_S * np.arange(100)
    for k, time in enumerate(times):
        points = sweep(WALK.poses, time, beams, seed=k)
        known = np.isfinite(points[:, 0])
        pcd(folder / "scans" / f"{k:06d}.pcd", (*XYZI[:3], ("time", 12, "f4")), xyz(points[known]) | {"time": beams.times[known]})
    np.savetxt(folder / "poses.txt", kitti_rows(WALK.poses(times)))
    return folder


def test_times_of_points_without_times_of_clouds(tmp_path: Path) -> None:
    """Nothing says when clouds were taken: surfaces tell that they are distorted, and that one sweep follows the other."""
    folder = folder_without_times(tmp_path / "walk")
    said = voxelastic("map", folder, "-o", tmp_path / "walk.vox", *SMALL)
    assert "neither clouds nor poses do" in said and "one sweep after the other" in said
    found = measured(tmp_path / "walk.vox")
    print(f"times of points alone: {found}")
    assert found.median < 0.01 and found.most < 0.04 and found.complete > 0.85, said
    said = voxelastic("map", folder, "--point-times", "given", "-o", tmp_path / "given.vox", *SMALL)
    assert "distorted or not" in said, "what is asked for is done, and said to be doubtful"


def kiss_icp_results(folder: Path, name: str, times: Array, poses: Array) -> Path:
    """What `kiss_icp_pipeline` leaves: the folder `latest` points to the one of the run."""
    run = folder / "results" / "2026-11-29_12-00-00"
    run.mkdir(parents=True)
    np.save(run / f"{name}_poses.npy", poses)
    np.savetxt(run / f"{name}_poses_kitti.txt", kitti_rows(poses))
    np.savetxt(run / f"{name}_poses_tum.txt", tum_rows(times, poses), fmt="%.4f")
    (run / "config.yml").write_text("data:\n  deskew: true\n  max_range: 100.0\nout_dir: results\n")
    (folder / "results" / "latest").symlink_to(run)
    return folder / "results" / "latest"


@pytest.fixture(scope="module")
def kiss_icp(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A folder of clouds without times, and the results beside it. KISS-ICP's frame is that of the first scan."""
    folder = tmp_path_factory.mktemp("kiss-icp")
    times = 0.4 * np.arange(32)
    beams = spinning(HDL32, 360)
    for k, time in enumerate(times):
        points = sweep(WALK.poses, time, beams, from_one_place=True, seed=k)
        floats(folder / "hall" / f"{k:06d}.bin", [*points.T, intensities(points)])
    poses = np.linalg.inv(WALK.poses(0.0)) @ WALK.poses(times)
    # The generic loader has no times: it counts.
    return folder / "hall", kiss_icp_results(folder, "hall", np.arange(32.0), poses)


@pytest.mark.parametrize("form", ["kitti", "tum"])
def test_kiss_icp(kiss_icp: tuple[Path, Path], form: str, tmp_path: Path) -> None:
    data, results = kiss_icp
    said = voxelastic("map", data, "--poses", results / f"hall_poses_{form}.txt", "-o", tmp_path / "hall.vox", *SMALL)
    found = measured(tmp_path / "hall.vox", WALK.poses(0.0))
    print(f"KISS-ICP, {form}: {found}")
    assert found.median < 0.01 and found.most < 0.04 and found.complete > 0.85, said


def test_kiss_icp_with_times_of_points(tmp_path: Path) -> None:
    """KISS-ICP undistorts the scans to the end of each sweep, whose pose it gives."""
    times, beams = 0.1 * np.arange(100), spinning(HDL32, 240, by_column=True)
    for k, time in enumerate(times):
        points = sweep(WALK.poses, time, beams, seed=k)
        known = np.isfinite(points[:, 0])
        pcd(tmp_path / "hall" / f"{k:06d}.pcd", (*XYZI[:3], ("time", 12, "f4")), xyz(points[known]) | {"time": beams.times[known]})
    (tmp_path / "hall" / "times.txt").write_text("".join(f"{time:.1f}\n" for time in times))
    poses = np.linalg.inv(WALK.poses(SWEEP_S)) @ WALK.poses(times + SWEEP_S)
    results = kiss_icp_results(tmp_path, "hall", np.arange(100.0), poses)
    words = ("map", tmp_path / "hall", "--poses", results / "hall_poses_kitti.txt", "-o", tmp_path / "hall.vox", *SMALL)
    assert "--pose-change rows=-1" in voxelastic(*words)
    said = voxelastic(*words, "--pose-change", "seconds=-0.1")
    found = measured(tmp_path / "hall.vox", WALK.poses(SWEEP_S))
    print(f"KISS-ICP, points with times: {found}")
    assert found.median < 0.01 and found.most < 0.04 and found.complete > 0.85, said


def fast_lio_bag(path: Path, *, sensor: bool = True, imu: bool = True, outputs: bool = True) -> Path:
    """A ROS 1 bag with what FAST-LIO reads (`velodyne.yaml`) and publishes. Its poses are those of the inertial unit at the end of each sweep."""
    bag, beams = Bag(ros=1), spinning(VLP32, 240, by_column=True)
    t_imu_lidar = rigid(FAST_LIO_EXTRINSIC)
    track = []
    for k in range(120):
        begin = SWEEP_S * k
        points, stamp, end = sweep(WALK.poses, begin, beams, seed=k), BEGIN + begin, BEGIN + begin + SWEEP_S
        strength = intensities(points)
        if sensor:
            columns = xyz(points) | {"intensity": strength, "ring": beams.rings, "time": beams.times}
            bag.add("/velodyne_points", end + 0.01, bag.cloud(stamp, "velodyne", VELODYNE, 22, columns))
        if not outputs:
            continue
        # The body's frame is that of the unit; the world's is that of the body when it began.
        t_world_body = WALK.poses(begin + SWEEP_S) @ np.linalg.inv(t_imu_lidar)
        track.append((end, t_world_body))
        bag.add("/Odometry", end + 0.05, bag.odometry(end, "camera_init", "body", t_world_body))
        bag.add("/tf", end + 0.05, bag.transform(end, "camera_init", "body", t_world_body))
        body = undistorted(points, WALK.poses, begin, beams, begin + SWEEP_S) @ t_imu_lidar[:3, :3].T + t_imu_lidar[:3, 3]
        in_map = body @ t_world_body[:3, :3].T + t_world_body[:3, 3]
        for topic, frame, cloud in (("/cloud_registered", "camera_init", in_map), ("/cloud_registered_body", "body", body)):
            columns = xyz(cloud) | {"intensity": strength, "curvature": 1e3 * beams.times}
            bag.add(topic, end + 0.05, bag.cloud(end, frame, REGISTERED, 48, columns))
        if k % 10 == 9:
            bag.add("/path", end + 0.05, bag.path("camera_init", track[9::10]))
    if imu:
        times = np.arange(2400) / 200
        for time, rate, force in zip(times, *WALK.imu(times, np.linalg.inv(t_imu_lidar)), strict=True):
            bag.add("/imu/data", BEGIN + time + 0.001, bag.imu(BEGIN + time, "imu_link", rate, force))
    return bag.save(path)


FAST_LIO_EXTRINSIC = (0.0, 0.0, 0.28)


@pytest.fixture(scope="module")
def fast_lio(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fast_lio_bag(tmp_path_factory.mktemp("fast-lio") / "drive.bag")


def test_fast_lio(fast_lio: Path, tmp_path: Path) -> None:
    """The sensor's own clouds with FAST-LIO's poses."""
    topics = ("--cloud-topic", "/velodyne_points", "--pose-topic", "/Odometry")
    said = voxelastic("map", fast_lio, *topics, "--every", "0.4s", "-o", tmp_path / "drive.vox", *SMALL)
    assert said.count("no fixed transform leads from body to velodyne") == 1, said
    assert "1 of 120 clouds have no pose" in said and "poses are there from 1700000000.100 to" in said, "the first cloud is before the first pose"
    chosen = (*topics, "--t-base-lidar", "0 0 0.28 0 0 0 1")
    said = voxelastic("map", fast_lio, *chosen, "--every", "0.4s", "-o", tmp_path / "drive.vox", *SMALL)
    found = measured(tmp_path / "drive.vox")
    print(f"FAST-LIO, the sensor's clouds: {found}")
    assert found.median < 0.01 and found.most < 0.04 and found.complete > 0.85, said


def test_fast_lio_without_a_choice_is_asked(fast_lio: Path, tmp_path: Path) -> None:
    said = voxelastic("map", fast_lio, "-o", tmp_path / "drive.vox", fails=True)
    assert "--cloud-topic" in said and "/velodyne_points" in said and "/cloud_registered_body" in said


def test_fast_lio_outputs_alone(tmp_path: Path) -> None:
    """Clouds that are undistorted already, although their points still have times."""
    bag = fast_lio_bag(tmp_path / "outputs.bag", sensor=False, imu=False)
    said = voxelastic("map", bag, "--every", "0.4s", "-o", tmp_path / "drive.vox", *SMALL)
    assert "so clouds are taken to be undistorted already" in said
    found = measured(tmp_path / "drive.vox")
    print(f"FAST-LIO, its outputs alone: {found}")
    assert found.median < 0.01 and found.most < 0.05 and found.complete > 0.8, said


@pytest.mark.parametrize("poses", ["given", "estimated"])
def test_fast_lio_clouds_saved_one_by_one(poses: str, tmp_path: Path) -> None:
    """As PCL writes what FAST-LIO publishes: undistorted, with times in `curvature`."""
    beams, lines = spinning(VLP32, 240, by_column=True), []
    for k in range(60):
        begin = SWEEP_S * k
        body = undistorted(sweep(WALK.poses, begin, beams, seed=k), WALK.poses, begin, beams, begin + SWEEP_S)
        known = np.isfinite(body[:, 0])
        pcd(tmp_path / "body" / f"{k:06d}.pcd", (*XYZI[:3], ("curvature", 12, "f4")), xyz(body[known]) | {"curvature": 1e3 * beams.times[known]})
        lines.append(f"{begin + SWEEP_S:.3f}\n")
    (tmp_path / "body" / "times.txt").write_text("".join(lines))
    if poses == "given":
        np.savetxt(tmp_path / "body" / "poses.txt", kitti_rows(WALK.poses(SWEEP_S * np.arange(1, 61))))
    said = voxelastic("map", tmp_path / "body", "-o", tmp_path / "body.vox", *SMALL)
    assert "in the field curvature, where an odometry keeps them, so clouds are taken to be undistorted already" in said
    found = measured(tmp_path / "body.vox", WALK.poses(SWEEP_S) if poses == "estimated" else np.eye(4), fit=poses == "estimated")
    print(f"FAST-LIO, clouds one by one, {poses} poses: {found}")
    assert found.median < 0.02 and found.most < 0.06, said


def test_fast_lio_with_clouds_in_the_frame_of_the_map(fast_lio: Path, tmp_path: Path) -> None:
    """They are moved back by the poses; where poses are to be estimated, the lidar would stand still in them."""
    words = ("map", fast_lio, "--cloud-topic", "/cloud_registered")
    said = voxelastic(*words, "--pose-topic", "/Odometry", "--every", "0.4s", "-o", tmp_path / "drive.vox", *SMALL)
    found = measured(tmp_path / "drive.vox")
    print(f"FAST-LIO, clouds in the frame of the map: {found}")
    assert found.median < 0.01 and found.most < 0.05 and found.complete > 0.8, said
    assert "they are moved back by their poses" in said
    said = voxelastic(*words, "--slam", "-o", tmp_path / "slam.vox", fails=True)
    assert "in them the lidar stands still" in said


def test_fast_lio_with_its_own_clouds(fast_lio: Path, tmp_path: Path) -> None:
    """Clouds in the body's frame, undistorted already."""
    chosen = ("--cloud-topic", "/cloud_registered_body", "--pose-topic", "/Odometry", "--point-times", "undistorted")
    said = voxelastic("map", fast_lio, *chosen, "--every", "0.4s", "-o", tmp_path / "drive.vox", *SMALL)
    found = measured(tmp_path / "drive.vox")
    print(f"FAST-LIO, clouds in the body's frame: {found}")
    assert found.median < 0.01 and found.most < 0.05 and found.complete > 0.8, said


LIO_SAM_POSES: Fields = (
    *XYZI,
    *(("roll", 0, "f4"), ("pitch", 0, "f4"), ("yaw", 0, "f4"), ("time", 0, "f8")),
)


def angles(pose: Array) -> list[float]:
    """Roll, pitch and yaw, in which LIO-SAM keeps rotations."""
    return [float(np.arctan2(pose[2, 1], pose[2, 2])), float(np.arcsin(-pose[2, 0])), float(np.arctan2(pose[1, 0], pose[0, 0]))]


DESKEWED: Fields = (("x", 0, "f4"), ("y", 4, "f4"), ("z", 8, "f4"), ("intensity", 16, "f4"))
"""PCL's PointXYZI, 32 bytes."""


@pytest.fixture(scope="module")
def lio_sam(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A bag of what LIO-SAM was given and of the clouds that it publishes undistorted, to the begin of the sweep; and the folder that its service `save_map` wrote: key poses at the begin
    of sweeps, a metre apart, and clouds of the map."""
    folder = tmp_path_factory.mktemp("lio-sam")
    bag, beams = Bag(ros=1), spinning(VLP32[::2], 360, by_column=True)
    loam = folder / "LOAM"
    keys: list[tuple[float, Array]] = []
    clouds = []
    for k in range(120):
        begin = SWEEP_S * k
        points, stamp = sweep(WALK.poses, begin, beams, seed=k), BEGIN + SWEEP_S * k
        strength = intensities(points)
        columns = xyz(points) | {"intensity": strength, "ring": beams.rings, "time": beams.times}
        bag.add("/points_raw", stamp + SWEEP_S, bag.cloud(stamp, "base_link", VELODYNE, 22, columns))
        level = undistorted(points, WALK.poses, begin, beams, begin)
        bag.add("/lio_sam/deskew/cloud_deskewed", stamp + SWEEP_S + 0.02, bag.cloud(stamp, "base_link", DESKEWED, 32, xyz(level) | {"intensity": strength}))
        pose = WALK.poses(begin)
        if not keys or np.linalg.norm(pose[:3, 3] - keys[-1][1][:3, 3]) >= 1.0:
            keys.append((stamp, pose))
            clouds.append(level[np.isfinite(level[:, 0])][::4] @ pose[:3, :3].T + pose[:3, 3])
    times, poses = np.array([time for time, _ in keys]), np.array([pose for _, pose in keys])
    rows = np.array([angles(pose) for pose in poses])
    number = np.arange(len(keys))
    pcd(loam / "trajectory.pcd", XYZI, xyz(poses[:, :3, 3]) | {"intensity": number})
    all_of_it = xyz(poses[:, :3, 3]) | {"intensity": number, "roll": rows[:, 0], "pitch": rows[:, 1], "yaw": rows[:, 2], "time": times}
    pcd(loam / "transformations.pcd", LIO_SAM_POSES, all_of_it)
    whole = np.concatenate(clouds)
    for name, part in (("CornerMap", whole[::7]), ("SurfMap", whole[::2]), ("GlobalMap", np.concatenate([whole[::7], whole[::2]]))):
        pcd(loam / f"{name}.pcd", XYZI, xyz(part) | {"intensity": np.zeros(len(part))})
    return bag.save(folder / "walk.bag"), loam


def test_lio_sam(lio_sam: tuple[Path, Path], tmp_path: Path) -> None:
    """The clouds that LIO-SAM undistorted, with its key poses."""
    bag, loam = lio_sam
    chosen = ("--cloud-topic", "/lio_sam/deskew/cloud_deskewed", "--poses", loam / "transformations.pcd", "--every", "scan")
    said = voxelastic("map", bag, *chosen, "-o", tmp_path / "walk.vox", *SMALL)
    found = measured(tmp_path / "walk.vox")
    print(f"LIO-SAM: {found}")
    assert found.median < 0.01 and found.most < 0.04 and found.complete > 0.7, said
    assert "109 of 120 clouds have no pose" in said


def test_lio_sam_with_clouds_that_are_distorted(lio_sam: tuple[Path, Path], tmp_path: Path) -> None:
    """Key poses do not say how the lidar moved during a sweep."""
    bag, loam = lio_sam
    said = voxelastic("map", bag, "--cloud-topic", "/points_raw", "--poses", loam / "transformations.pcd", "--every", "scan", "-o", tmp_path / "walk.vox", *SMALL)
    assert "poses are too far apart in time" in said and "--slam" in said


def test_lio_sam_saves_no_scans(lio_sam: tuple[Path, Path], tmp_path: Path) -> None:
    for words in ((), ("--slam",), ("--poses", lio_sam[1] / "transformations.pcd")):
        said = voxelastic("map", lio_sam[1], *words, "-o", tmp_path / "walk.vox", fails=True)
        assert "not scans: CornerMap.pcd, GlobalMap.pcd" in said and "--poses transformations.pcd" in said


@pytest.fixture(scope="module")
def glim(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dump of GLIM: submaps of fifteen frames, whose points are in the frame of the one in their middle, and trajectories."""
    dump = tmp_path_factory.mktemp("glim") / "dump"
    beams = spinning(HDL32, 240)
    t_lidar_imu = rigid([0.006, -0.012, 0.008], rotations(0, 0, np.pi))
    frame = 0
    for submap in range(8):
        times = 1.5 * submap + 0.1 * np.arange(15)
        origin = WALK.poses(times[7])
        folder = dump / f"{submap:06d}"
        folder.mkdir(parents=True)
        points = [sweep(WALK.poses, time, beams, from_one_place=True, seed=submap) for time in times[::3]]
        poses = WALK.poses(times)
        merged = np.concatenate([p @ (np.linalg.inv(origin) @ pose)[:3, :3].T + (np.linalg.inv(origin) @ pose)[:3, 3] for p, pose in zip(points, poses[::3], strict=True)])
        merged = merged[np.isfinite(merged[:, 0])]
        # GLIM keeps a share of the points, drawn at random from small cells.
        kept = merged[np.random.default_rng(submap).permutation(len(merged))[:20_000]]
        floats(folder / "points_compact.bin", kept.T)
        floats(folder / "covs_compact.bin", np.tile([[1e-3], [0], [0], [1e-3], [0], [1e-3]], len(kept)))
        text = [f"id: {submap}", "T_world_origin: ", matrix(origin), "T_origin_endpoint_L: ", matrix(np.linalg.inv(origin) @ poses[0])]
        text += ["T_origin_endpoint_R: ", matrix(np.linalg.inv(origin) @ poses[-1]), "T_lidar_imu: ", matrix(t_lidar_imu), "imu_bias: 0 0 0 0 0 0", "frame_id: 1"]
        text += [f"num_frames: {len(times)}"]
        for k, (time, pose) in enumerate(zip(times, poses, strict=True)):
            text += [f"frame_{k}", f"id: {frame}", f"stamp: {BEGIN + time:.9f}", "T_odom_lidar: ", matrix(pose), "T_world_lidar: ", matrix(pose), "v_world_imu: 0 0 0"]
            frame += 1
        (folder / "data.txt").write_text("\n".join(text) + "\n")
        (folder / "imu_rate.txt").write_text("".join(f"{BEGIN + time:.9f} 0 0 0 0 0 0 1\n" for time in times))
    (dump / "graph.txt").write_text("num_submaps: 8\nnum_all_frames: 120\nnum_matching_cost_factors: 0\n")
    for name in ("graph.bin", "values.bin"):
        (dump / name).write_bytes(bytes(64))
    every = np.arange(120) / 10
    rows = tum_rows(BEGIN + every, WALK.poses(every))
    for name in ("traj_lidar", "odom_lidar", "traj_imu", "odom_imu"):
        np.savetxt(dump / f"{name}.txt", rows, fmt=["%.9f"] + ["%.6f"] * 7)
    return dump


def test_glim(glim: Path, tmp_path: Path) -> None:
    said = voxelastic("map", glim, "-o", tmp_path / "glim.vox", *SMALL)
    found = measured(tmp_path / "glim.vox")
    print(f"GLIM: {found}")
    assert found.median < 0.02 and found.most < 0.08 and found.complete > 0.7, said
