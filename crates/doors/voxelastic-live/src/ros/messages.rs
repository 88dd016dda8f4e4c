//! Messages of ROS 2 as bytes (CDR). Definitions: common_interfaces, geometry2 and octomap_msgs, as in ROS 2 Jazzy.

use voxelastic::Pose;
use voxelastic_io::ros::{FieldType, MessageWriter};
pub use voxelastic_io::ros::{Header, transforms};

/// A colour, sRGB.
pub type Rgb = [u8; 3];

/// `sensor_msgs/PointCloud2` of points in one row, of 32-bit numbers with these names.
fn row_of_points(header: Header<'_>, fields: &[&str], data: &[u8]) -> Vec<u8> {
    let points = data.len() / (4 * fields.len());
    let fields: Vec<_> = fields.iter().map(|name| (*name, FieldType::F32)).collect();
    voxelastic_io::ros::point_cloud(header, [1, points], &fields, data, true)
}

/// `sensor_msgs/PointCloud2`: x, y, z and, as `intensity`, a distance, all as `f32`, metres.
pub fn distance_cloud(header: Header<'_>, points: &[[f32; 4]]) -> Vec<u8> {
    let data: Vec<u8> = points.iter().flatten().flat_map(|number| number.to_le_bytes()).collect();
    row_of_points(header, &["x", "y", "z", "intensity"], &data)
}

/// `sensor_msgs/PointCloud2`: x, y, z as `f32`, metres, and rgb if there is a colour for each point.
pub fn point_cloud(header: Header<'_>, points: &[[f32; 3]], colours: &[Rgb]) -> Vec<u8> {
    let colours = Some(colours).filter(|colours| colours.len() == points.len() && !points.is_empty());
    let mut data = Vec::with_capacity(16 * points.len());
    for (k, point) in points.iter().enumerate() {
        data.extend(point.iter().flat_map(|c| c.to_le_bytes()));
        if let Some([r, g, b]) = colours.map(|colours| colours[k]) {
            data.extend([b, g, r, 0]);
        }
    }
    row_of_points(header, if colours.is_some() { &["x", "y", "z", "rgb"] } else { &["x", "y", "z"] }, &data)
}

/// A triangle mesh of `visualization_msgs/MarkerArray`; without triangles it is removed.
#[derive(Clone, Debug)]
pub struct MeshMarker {
    /// Group of markers.
    pub namespace: String,
    /// Number in the group.
    pub id: i32,
    /// Corners of triangles, three each, metres, and a colour for each corner.
    pub corners: Vec<([f32; 3], Rgb)>,
}

/// `visualization_msgs/MarkerArray` of triangle meshes in the frame of the header.
pub fn mesh_markers(header: Header<'_>, markers: &[MeshMarker]) -> Vec<u8> {
    let corners: usize = markers.iter().map(|marker| marker.corners.len()).sum();
    let mut message = MessageWriter::with_capacity(corners * 40 + markers.len() * 400 + 64);
    message.u32(markers.len() as u32);
    for MeshMarker { namespace, id, corners } in markers {
        const TRIANGLE_LIST: i32 = 11;
        let action = if corners.is_empty() { 2 } else { 0 };
        let shape = Shape { kind: TRIANGLE_LIST, pose: Pose::identity(), scale: [1.0; 3], colour: [1.0; 4] };
        write_marker(&mut message, header, (namespace, *id, action), &shape, corners);
    }
    message.finish()
}

/// A box or an arrow of `visualization_msgs/MarkerArray`.
#[derive(Clone, Copy, Debug)]
pub struct Shape {
    kind: i32,
    pose: Pose,
    scale: [f64; 3],
    colour: [f32; 4],
}

impl Shape {
    /// A box around a pose with edges of `size`, metres; the colour is red, green, blue and opacity.
    pub fn cuboid(pose: Pose, size: [f64; 3], colour: [f32; 4]) -> Self {
        Self { kind: 1, pose, scale: size, colour }
    }

    /// An arrow from a pose along its x axis, `length` metres long.
    pub fn arrow(pose: Pose, length: f64, colour: [f32; 4]) -> Self {
        Self { kind: 0, pose, scale: [length, 0.08 * length, 0.16 * length], colour }
    }
}

/// `visualization_msgs/MarkerArray` of shapes in the frame of the header, in place of all those of before.
pub fn shape_markers(header: Header<'_>, namespace: &str, shapes: &[Shape]) -> Vec<u8> {
    const DELETE_ALL: i32 = 3;
    let mut message = MessageWriter::with_capacity(shapes.len() * 400 + 512);
    message.u32(shapes.len() as u32 + 1);
    let nothing = Shape::cuboid(Pose::identity(), [1.0; 3], [0.0; 4]);
    write_marker(&mut message, header, (namespace, 0, DELETE_ALL), &nothing, &[]);
    for (id, shape) in (0..).zip(shapes) {
        write_marker(&mut message, header, (namespace, id, 0), shape, &[]);
    }
    message.finish()
}

/// `visualization_msgs/Marker`, with its namespace, its number there and its action.
fn write_marker(
    message: &mut MessageWriter,
    header: Header<'_>,
    (namespace, id, action): (&str, i32, i32),
    shape: &Shape,
    corners: &[([f32; 3], Rgb)],
) {
    message.header(header).text(namespace).i32(id).i32(shape.kind).i32(action);
    // Then lifetime; whether it moves with its frame.
    message.pose(&shape.pose).f64s(&shape.scale).f32s(&shape.colour).i32(0).u32(0).bool(false);
    message.u32(corners.len() as u32);
    for (corner, _) in corners {
        message.f64s(&corner.map(f64::from));
    }
    message.u32(corners.len() as u32);
    for (_, colour) in corners {
        let [r, g, b] = colour.map(|c| f32::from(c) / 255.0);
        message.f32s(&[r, g, b, 1.0]);
    }
    // Texture: its name, an empty image (header, format, data), coordinates.
    message.text("");
    message.time(0.0).text("").text("").bytes(&[]).u32(0);
    // Text; mesh: its name, an empty file (name, data), whether to use its materials.
    message.text("").text("").text("").bytes(&[]).bool(false);
}

/// `octomap_msgs/Octomap` of free and occupied space: the nodes of a `.bt` file, without its text, whose smallest cubes have an edge of `resolution` metres.
pub fn octomap(header: Header<'_>, resolution: f64, nodes: &[u8]) -> Vec<u8> {
    let mut message = MessageWriter::with_capacity(nodes.len() + 128);
    message.header(header).bool(true).text("OcTree").f64s(&[resolution]).bytes(nodes).finish()
}

/// A floor plan.
#[derive(Clone, Debug)]
pub struct Grid<'a> {
    /// Edge of a cell, metres.
    pub resolution: f64,
    /// Cells along x.
    pub width: usize,
    /// Corner of the first cell in the frame of the header: x, y and the height, metres.
    pub origin: [f64; 3],
    /// 0 free, 100 occupied, -1 unknown; row after row, along x first.
    pub cells: &'a [i8],
}

/// `nav_msgs/OccupancyGrid`.
pub fn occupancy_grid(header: Header<'_>, grid: &Grid<'_>) -> Vec<u8> {
    write_occupancy_grid(&mut MessageWriter::with_capacity(grid.cells.len() + 160), header, grid).finish()
}

/// A floor plan as a part of a message.
pub(super) fn write_occupancy_grid<'w>(message: &'w mut MessageWriter, header: Header<'_>, grid: &Grid<'_>) -> &'w mut MessageWriter {
    message.header(header);
    message.time(header.stamp).f32s(&[grid.resolution as f32]).u32(grid.width as u32);
    message.u32((grid.cells.len() / grid.width.max(1)) as u32);
    let [x, y, z] = grid.origin;
    message.pose(&Pose::translation(x, y, z)).u32(grid.cells.len() as u32);
    for cell in grid.cells {
        message.u8(*cell as u8);
    }
    message
}

/// A rectangle of a floor plan.
#[derive(Clone, Debug)]
pub struct GridPart<'a> {
    /// Its first cell, along x and y.
    pub low: [usize; 2],
    /// Cells along x.
    pub width: usize,
    /// As those of a [`Grid`].
    pub cells: &'a [i8],
}

/// `map_msgs/OccupancyGridUpdate`.
pub fn occupancy_grid_update(header: Header<'_>, part: &GridPart<'_>) -> Vec<u8> {
    let mut message = MessageWriter::with_capacity(part.cells.len() + 96);
    message.header(header).i32(part.low[0] as i32).i32(part.low[1] as i32).u32(part.width as u32);
    message.u32((part.cells.len() / part.width.max(1)) as u32).u32(part.cells.len() as u32);
    for cell in part.cells {
        message.u8(*cell as u8);
    }
    message.finish()
}

/// `nav_msgs/Path`: poses with their times, seconds, in the frame of the header.
pub fn path(header: Header<'_>, poses: &[(f64, Pose)]) -> Vec<u8> {
    let mut message = MessageWriter::with_capacity(poses.len() * 96 + 64);
    write_path(&mut message, header, poses).finish()
}

/// A path as a part of a message.
pub(super) fn write_path<'w>(message: &'w mut MessageWriter, header: Header<'_>, poses: &[(f64, Pose)]) -> &'w mut MessageWriter {
    message.header(header).u32(poses.len() as u32);
    for (stamp, pose) in poses {
        message.header(Header { stamp: *stamp, ..header }).pose(pose);
    }
    message
}

/// `geometry_msgs/PoseStamped`.
pub fn pose_stamped(header: Header<'_>, pose: &Pose) -> Vec<u8> {
    let mut message = MessageWriter::with_capacity(128);
    message.header(header).pose(pose).finish()
}

/// `geometry_msgs/PoseArray`.
pub fn pose_array(header: Header<'_>, poses: &[Pose]) -> Vec<u8> {
    let mut message = MessageWriter::with_capacity(poses.len() * 56 + 64);
    message.header(header).u32(poses.len() as u32);
    for pose in poses {
        message.pose(pose);
    }
    message.finish()
}

/// How well something is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Health {
    /// As it should be.
    Ok = 0,
    /// It works, but something is lost or late.
    Warning = 1,
    /// It does not work.
    Error = 2,
}

/// `diagnostic_msgs/DiagnosticArray` with one status: how `name` is, in words, and figures.
pub fn diagnostics(header: Header<'_>, name: &str, (health, words): (Health, &str), figures: &[(String, String)]) -> Vec<u8> {
    let mut message = MessageWriter::new();
    message.header(header).u32(1).u8(health as u8).text(name).text(words).text("").u32(figures.len() as u32);
    for (key, value) in figures {
        message.text(key).text(value);
    }
    message.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic_testing::run_python;

    /// What rosbags reads in messages, as JSON.
    fn read_by_rosbags(messages: &[(&str, Vec<u8>)]) -> Option<serde_json::Value> {
        let script = "
import json, sys
import numpy
from rosbags.typesys import Stores, get_typestore, get_types_from_msg
store = get_typestore(Stores.ROS2_JAZZY)
octomap = 'std_msgs/Header header\\nbool binary\\nstring id\\nfloat64 resolution\\nint8[] data\\n'
store.register(get_types_from_msg(octomap, 'octomap_msgs/msg/Octomap'))
update = 'std_msgs/Header header\\nint32 x\\nint32 y\\nuint32 width\\nuint32 height\\nint8[] data\\n'
store.register(get_types_from_msg(update, 'map_msgs/msg/OccupancyGridUpdate'))
def plain(value):
    if isinstance(value, numpy.ndarray): return value.tolist()
    if isinstance(value, (list, tuple)): return [plain(v) for v in value]
    if hasattr(value, '__msgtype__'): return {k: plain(v) for k, v in vars(value).items() if k != '__msgtype__'}
    return value
folder = sys.argv[1]
out = []
for k, name in enumerate(open(folder + '/names').read().split()):
    data = open(f'{folder}/{k}', 'rb').read()
    message = store.deserialize_cdr(data, name)
    assert bytes(store.serialize_cdr(message, name)) == data, name
    out.append(plain(message))
print(json.dumps(out))
";
        let dir = tempfile::tempdir().unwrap();
        let names: Vec<&str> = messages.iter().map(|(name, _)| *name).collect();
        std::fs::write(dir.path().join("names"), names.join("\n")).unwrap();
        messages.iter().enumerate().for_each(|(k, (_, data))| std::fs::write(dir.path().join(k.to_string()), data).unwrap());
        Some(serde_json::from_str(&run_python("rosbags, numpy", script, &[dir.path()])?).unwrap())
    }

    #[test]
    fn another_implementation_reads_and_writes_the_same_bytes() {
        let header = Header { stamp: 1_700_000_000.25, frame: "map" };
        let pose = Pose::translation(1.0, -2.0, 3.0);
        let corner = |x: f32| ([x, 0.5, 1.0], [255, 0, 51]);
        let marker = |id, corners| MeshMarker { namespace: "submap 3".into(), id, corners };
        let messages = [
            ("sensor_msgs/msg/PointCloud2", point_cloud(header, &[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], &[[1, 2, 3], [4, 5, 6]])),
            ("sensor_msgs/msg/PointCloud2", point_cloud(header, &[[1.0, 2.0, 3.0]], &[])),
            (
                "visualization_msgs/msg/MarkerArray",
                mesh_markers(header, &[marker(7, vec![corner(0.0), corner(1.0), corner(2.0)]), marker(8, Vec::new())]),
            ),
            ("octomap_msgs/msg/Octomap", octomap(header, 0.1, &[1, 2, 255])),
            (
                "nav_msgs/msg/OccupancyGrid",
                occupancy_grid(header, &Grid { resolution: 0.5, width: 2, origin: [1.0, 2.0, 0.3], cells: &[0, 100, -1, 0] }),
            ),
            ("nav_msgs/msg/Path", path(header, &[(5.5, pose), (6.0, Pose::identity())])),
            ("geometry_msgs/msg/PoseArray", pose_array(header, &[pose])),
            ("tf2_msgs/msg/TFMessage", transforms(&[(header, "odom", pose)])),
            ("diagnostic_msgs/msg/DiagnosticArray", diagnostics(header, "voxelastic", (Health::Warning, "late"), &[("scans".into(), "12".into())])),
            ("sensor_msgs/msg/PointCloud2", distance_cloud(header, &[[1.0, 2.0, 3.0, 0.25]])),
            ("geometry_msgs/msg/PoseStamped", pose_stamped(header, &pose)),
            ("map_msgs/msg/OccupancyGridUpdate", occupancy_grid_update(header, &GridPart { low: [7, 9], width: 3, cells: &[0, 100, -1, 0, 0, 100] })),
            (
                "visualization_msgs/msg/MarkerArray",
                shape_markers(header, "frontier", &[Shape::cuboid(pose, [4.0, 2.0, 1.0], [1.0, 0.5, 0.0, 0.4]), Shape::arrow(pose, 1.5, [1.0; 4])]),
            ),
        ];
        let Some(read) = read_by_rosbags(&messages) else { return };
        assert_eq!(read[0]["header"]["stamp"], serde_json::json!({"sec": 1_700_000_000, "nanosec": 250_000_000}));
        assert_eq!((&read[0]["width"], &read[0]["point_step"], &read[1]["point_step"]), (&2.into(), &16.into(), &12.into()));
        assert_eq!(read[0]["data"].as_array().unwrap()[12..16], [3, 2, 1, 0].map(serde_json::Value::from));
        assert_eq!(
            (&read[2]["markers"][0]["points"][2]["x"], &read[2]["markers"][0]["action"], &read[2]["markers"][1]["action"]),
            (&2.0.into(), &0.into(), &2.into())
        );
        assert!((read[2]["markers"][0]["colors"][0]["b"].as_f64().unwrap() - 0.2).abs() < 1e-6);
        assert_eq!(read[3]["data"], serde_json::json!([1, 2, -1]));
        assert_eq!((&read[4]["data"], &read[4]["info"]["height"]), (&serde_json::json!([0, 100, -1, 0]), &2.into()));
        assert_eq!((&read[5]["poses"][0]["pose"]["position"]["y"], &read[5]["poses"][1]["header"]["stamp"]["sec"]), (&(-2.0).into(), &6.into()));
        assert_eq!(read[7]["transforms"][0]["transform"]["translation"]["z"], 3.0);
        assert_eq!((&read[8]["status"][0]["level"], &read[8]["status"][0]["values"][0]["value"]), (&1.into(), &"12".into()));
        assert_eq!((&read[9]["fields"][3]["name"], &read[9]["data"][15], &read[9]["data"][14]), (&"intensity".into(), &0x3e.into(), &0x80.into()));
        assert_eq!((&read[10]["pose"]["position"]["z"], &read[10]["header"]["frame_id"]), (&3.0.into(), &"map".into()));
        assert_eq!(["x", "y", "width", "height"].map(|key| read[11][key].as_u64()), [7, 9, 3, 2].map(Some));
        assert_eq!(read[11]["data"], serde_json::json!([0, 100, -1, 0, 0, 100]));
        let markers = read[12]["markers"].as_array().unwrap();
        let of = |key: &str| markers.iter().map(|marker| marker[key].as_i64().unwrap()).collect::<Vec<_>>();
        assert_eq!((of("action"), of("type")[1..].to_vec(), of("id")), (vec![3, 0, 0], vec![1, 0], vec![0, 0, 1]));
        assert_eq!(
            (&markers[1]["scale"]["y"], &markers[2]["scale"]["x"], &markers[1]["pose"]["position"]["y"]),
            (&2.0.into(), &1.5.into(), &(-2.0).into())
        );
    }
}
