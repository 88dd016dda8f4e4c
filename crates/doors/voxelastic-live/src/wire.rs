//! Messages to viewers. Little-endian; each begins with its kind as a `u32`, and its number as a `u64`, which the scene sets.
//!
//! | kind | what follows |
//! | --- | --- |
//! | 0 hello | JSON as UTF-8: `session`, whether it is `resumed`, and the number of the last of the `tiles` that there are, as text; number 0 |
//! | 1 tile | `u32` submap that it moves with, in whose frame it is, or the largest number for the map frame; `i32` x 3 place of the tile, which replaces what was there, `u32` scans in the map when it was made, `u32` flags (1 colours, 2 intensities), `f32` x 3 origin, `f32` step, `u32` chunks; for each `u32` vertices, `u32` triangles; the packed chunks |
//! | 2 submaps | `u32` count; for each `u32` id, `f64` x 7 pose in the map (x y z qx qy qz qw). Submaps that are not named are gone |
//! | 3 path | `u32` part, `u32` count; for each `u32` submap, `f32` x 3 position in its frame, metres |
//! | 4 loops | `u32` count; for each twice `u32` submap, `f32` x 3 position |
//! | 5 scan | `u32` scans in the map, `f64` time stamp, `u32` submap, `f32` x 7 pose in its frame, `u32` count; for each point `f32` x 3, lidar frame, metres |
//! | 6 statistics | JSON as UTF-8 |

use voxelastic::Pose;
use voxelastic::atlas::SubmapId;
use voxelastic::surface::Mesh;
use voxelastic_report::pack_surface;
use voxelastic_report::surface::Surface;

/// A position in the frame of a submap, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// The submap.
    pub submap: SubmapId,
    /// The position in its frame.
    pub position: [f32; 3],
}

/// Of a tile that moves with no submap.
pub const NO_SUBMAP: SubmapId = SubmapId::MAX;

/// Bytes of kind and number, before the content of a message.
pub const HEAD: usize = 12;

/// The kind of a scan.
const SCAN: u32 = 5;

/// Whether a message is a scan.
pub fn is_scan(message: &[u8]) -> bool {
    message.starts_with(&SCAN.to_le_bytes())
}

/// Sets the number of a message; what is too short to be one stays as it is.
pub fn set_number(message: &mut [u8], number: u64) {
    if let Some(bytes) = message.get_mut(4..HEAD) {
        bytes.copy_from_slice(&number.to_le_bytes());
    }
}

/// A message under construction.
#[derive(Default)]
struct Message(Vec<u8>);

impl Message {
    fn new(kind: u32) -> Self {
        let mut bytes = kind.to_le_bytes().to_vec();
        bytes.resize(HEAD, 0);
        Self(bytes)
    }

    fn u32(mut self, value: u32) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    fn f64(mut self, value: f64) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    fn f32s(mut self, values: &[f32]) -> Self {
        values.iter().for_each(|v| self.0.extend(v.to_le_bytes()));
        self
    }

    fn place(self, place: &Place) -> Self {
        self.u32(place.submap).f32s(&place.position)
    }
}

/// Position and quaternion.
fn numbers(pose: &Pose) -> [f64; 7] {
    let (t, q) = (pose.translation.vector, pose.rotation.coords);
    [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
}

/// The surface of the map in a tile, which moves with a submap and is in its frame, made when `scans` scans were in the map. `place` is that of the tile among all.
pub fn tile(submap: SubmapId, place: [i32; 3], scans: u32, mesh: Mesh) -> Vec<u8> {
    let flags = u32::from(!mesh.colours.is_empty()) | u32::from(!mesh.intensities.is_empty()) << 1;
    let Mesh { positions, normals, intensities, colours, scales, triangles } = mesh;
    let packed = pack_surface(&Surface { positions, normals, intensities, colours, scales, triangles, ..Surface::default() });
    let mut message = Message::new(1).u32(submap);
    place.iter().for_each(|c| message.0.extend(c.to_le_bytes()));
    message = message.u32(scans).u32(flags).f32s(&packed.origin).f32s(&[packed.step]).u32(packed.chunks.len() as u32);
    for chunk in &packed.chunks {
        message = message.u32(chunk.v as u32).u32(chunk.t as u32);
    }
    message.0.extend(packed.bytes);
    message.0
}

/// The poses of all submaps.
pub fn submaps(poses: &[(SubmapId, Pose)]) -> Vec<u8> {
    let message = Message::new(2).u32(poses.len() as u32);
    poses.iter().fold(message, |message, (id, pose)| numbers(pose).into_iter().fold(message.u32(*id), Message::f64)).0
}

/// A part of the trajectory.
pub fn path(part: u32, places: &[Place]) -> Vec<u8> {
    places.iter().fold(Message::new(3).u32(part).u32(places.len() as u32), Message::place).0
}

/// Closed loops.
pub fn loops(pairs: &[[Place; 2]]) -> Vec<u8> {
    pairs.iter().flatten().fold(Message::new(4).u32(pairs.len() as u32), Message::place).0
}

/// The last scan, taken at `pose` in the frame of a submap.
pub fn scan(scans: u32, time: f64, submap: SubmapId, pose: &Pose, points: &[[f32; 3]]) -> Vec<u8> {
    let message = Message::new(SCAN).u32(scans).f64(time).u32(submap).f32s(&numbers(pose).map(|c| c as f32)).u32(points.len() as u32);
    message.f32s(points.as_flattened()).0
}

/// Figures as JSON.
pub fn statistics(json: &str) -> Vec<u8> {
    text(6, json)
}

/// The first message on a connection; `tiles` is the number of the last tile that there is.
pub fn hello(session: u64, resumed: bool, tiles: u64) -> Vec<u8> {
    text(0, &format!("{{\"session\":\"{session}\",\"resumed\":{resumed},\"tiles\":\"{tiles}\"}}"))
}

fn text(kind: u32, text: &str) -> Vec<u8> {
    let mut message = Message::new(kind);
    message.0.extend(text.as_bytes());
    message.0
}
