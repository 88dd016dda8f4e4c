//! Two rooms with a doorway of 1 m between them, scanned and mapped.

use std::sync::OnceLock;
use voxelastic::event::{Event, Scan};
use voxelastic::mapper::Mapper;
use voxelastic::query::AtlasQuery;
use voxelastic::sensor::preset_with_columns;
use voxelastic::{Pose, Settings, atlas::Atlas};
use voxelastic_sim::random::Stream;
use voxelastic_sim::route::Route;
use voxelastic_sim::sensor::{Lidar, LidarSettings};
use voxelastic_sim::{World, WorldBuilder};

pub const VOXEL: f32 = 0.08;
/// A position in the west room.
pub const WEST: [f64; 3] = [-4.5, -2.0, 1.0];
/// A position in the east room.
pub const EAST: [f64; 3] = [4.5, -2.0, 1.3];

pub struct Rooms {
    pub world: World,
    pub atlas: Atlas,
}

impl Rooms {
    pub fn query(&self) -> AtlasQuery<'_> {
        self.atlas.query().unwrap()
    }
}

fn world() -> World {
    let mut b = WorldBuilder::new("rooms", 1);
    b.cuboid([-7.0, -4.0, -1.0], [7.0, 4.0, 0.0], 0.3);
    b.cuboid([-7.0, -4.0, 3.0], [7.0, 4.0, 4.0], 0.3);
    for (low, high) in [([-7.0, -4.0], [-6.0, 4.0]), ([6.0, -4.0], [7.0, 4.0]), ([-7.0, -4.0], [7.0, -3.0]), ([-7.0, 3.0], [7.0, 4.0])] {
        b.cuboid([low[0], low[1], -1.0], [high[0], high[1], 4.0], 0.4);
    }
    // The wall, left and right of the doorway and above it.
    b.cuboid([0.0, -3.5, -0.5], [0.15, 1.0, 3.5], 0.4);
    b.cuboid([0.0, 2.0, -0.5], [0.15, 3.5, 3.5], 0.4);
    b.cuboid([0.0, 0.5, 2.1], [0.15, 2.5, 3.5], 0.4);
    b.build().unwrap()
}

/// A mapper for [`scans`], which give several submaps.
pub fn mapper() -> Mapper {
    let mut settings = Settings { voxel_size: VOXEL, max_range: 30.0, lambda_odom: 4.0, min_overlap: 1.0, ..Settings::default() };
    settings.set("field", "occupancy").unwrap();
    Mapper::new(settings).unwrap()
}

/// The scans of a loop through both rooms and the doorway, one every 0.8 m, at alternating heights.
pub fn scans(world: &World) -> impl Iterator<Item = Event> {
    let lidar = Lidar::new(preset_with_columns("os0-64", 1024).unwrap(), LidarSettings::default()).unwrap();
    let route = Route::rounded(&[[-4.5, 1.5], [-4.5, -1.8], [-1.0, -1.8], [-1.0, 1.5], [1.2, 1.5], [1.2, -1.8], [4.5, -1.8], [4.5, 1.5]], 0.5);
    (0..(route.length() / 0.8) as u64).map(move |node| {
        let ([x, y], heading) = route.at(0.8 * node as f64);
        let z = if node % 2 == 0 { 1.0 } else { 1.4 };
        let pose = Pose::from_parts([x, y, z].into(), nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, heading));
        let cloud = lidar.scan(world, |_| pose, &Stream::new(5, &[node]));
        Event::Scan(Scan { node: node as _, time: node as f64, t_map_lidar: pose, cloud })
    })
}

/// The rooms, mapped once for all tests.
pub fn rooms() -> &'static Rooms {
    static ROOMS: OnceLock<Rooms> = OnceLock::new();
    ROOMS.get_or_init(|| {
        let world = world();
        let mut mapper = mapper();
        for event in scans(&world) {
            mapper.handle(event).unwrap();
        }
        Rooms { world, atlas: mapper.into_atlas() }
    })
}
