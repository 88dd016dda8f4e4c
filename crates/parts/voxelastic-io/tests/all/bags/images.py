
# Images beside the clouds of a drive: topics as drivers of cameras publish them.
# usage: .. FOLDER images


def camera_messages(drive, jpeg):
    """Cameras /front (rgb8), /left (JPEG, no raw images), /rect (bgr8, rectified), /bare (mono8, without intrinsics) and /depth (16 bits)."""
    out = drive.messages()
    pose = drive.pose(0)
    pose.position.x, pose.position.z = 0.25, -0.5
    pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w = -0.5, 0.5, -0.5, 0.5
    out.append(("/tf_static", 99_900_000_002, drive.transforms(0, "lidar", "front_optical", pose)))
    pose = drive.pose(0)
    pose.position.y = 1.0
    out.append(("/tf_static", 99_900_000_003, drive.transforms(0, "front_optical", "left_optical", pose)))
    roi = drive.type("sensor_msgs/msg/RegionOfInterest")(x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    height, width = 6, 8
    rows, columns = np.mgrid[0:height, 0:width]
    picture = np.stack([10 * rows, 20 * columns, rows + columns], axis=-1).astype(np.uint8)

    def info(k, frame, model, d):
        names = ("D", "K", "R", "P") if drive.ros1 else ("d", "k", "r", "p")
        numbers = (np.array(d), np.array([5.0, 0, 3.5, 0, 6.0, 2.5, 0, 0, 1]), np.eye(3).reshape(-1), np.array([4.0, 0, 3.0, 0, 0, 4.5, 2.0, 0, 0, 0, 1.0, 0]))
        return drive.type("sensor_msgs/msg/CameraInfo")(
            header=drive.header(k, frame), height=height, width=width, distortion_model=model, binning_x=0, binning_y=0, roi=roi, **dict(zip(names, numbers)))

    def raw(k, frame, encoding, pixels):
        data = np.ascontiguousarray(pixels).view(np.uint8).reshape(height, -1)
        return drive.type("sensor_msgs/msg/Image")(
            header=drive.header(k, frame), height=height, width=width, encoding=encoding, is_bigendian=0, step=data.shape[1], data=data.reshape(-1))

    for k in range(SCANS):
        s, ns = seconds(k)
        at = s * 1_000_000_000 + ns + 20_000_000
        compressed = drive.type("sensor_msgs/msg/CompressedImage")(header=drive.header(k, "left_optical"), format="jpeg", data=np.frombuffer(jpeg, np.uint8))
        out += [
            ("/front/camera_info", at, info(k, "front_optical", "plumb_bob", [-0.1, 0.01, 0.001, 0.002, 0.0])),
            ("/front/image_raw", at + 1, raw(k, "front_optical", "rgb8", picture)),
            ("/front/image_raw/compressed", at + 2, compressed),
            ("/left/camera_info", at + 3, info(k, "left_optical", "equidistant", [0.1, 0.0, 0.0, 0.0])),
            ("/left/image_raw/compressed", at + 4, compressed),
            ("/rect/camera_info", at + 5, info(k, "front_optical", "plumb_bob", [-0.1, 0.01, 0.001, 0.002, 0.0])),
            ("/rect/image_rect_color", at + 6, raw(k, "front_optical", "bgr8", picture[:, :, ::-1])),
            ("/bare/image", at + 7, raw(k, "front_optical", "mono8", picture[:, :, 0])),
            ("/depth/image", at + 8, raw(k, "front_optical", "16UC1", picture[:, :, 0].astype(np.uint16))),
        ]
    return sorted(out, key=lambda m: m[1])


if len(sys.argv) == 3 and sys.argv[2] == "images":
    folder = Path(sys.argv[1])
    jpeg = (folder / "left.jpg").read_bytes()
    one, two = Drive(ros1=True), Drive(ros1=False)
    bag1(folder / "images.bag", camera_messages(one, jpeg), one, Writer1.CompressionFormat.LZ4)
    mcap(folder / "images.mcap", camera_messages(two, jpeg), two, CompressionType.ZSTD)
    sqlite(folder / "images_db3", camera_messages(two, jpeg), two)
