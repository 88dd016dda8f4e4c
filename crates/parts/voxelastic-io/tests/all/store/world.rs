//! Small atlases to store: integrated from scans of a box-shaped room, and made up block by block.

use voxelastic::Pose;
use voxelastic::atlas::{Atlas, Submap, SubmapScan};
use voxelastic::field::occupancy::{OccupancyField, Summary};
use voxelastic::field::tsdf::{ColourVoxel, TsdfField, Voxel};
use voxelastic::field::{BlockHead, OccupancyBuilder, OctantRecord, TsdfBuilder};
use voxelastic::geometry::Rigid;
use voxelastic::integrate::{ReturnsView, TsdfIntegrator, TsdfSettings};
use voxelastic::octree::voxels_at;
use voxelastic_io::store::MapDetails;

/// A sequence of numbers that is the same everywhere.
pub struct Numbers(pub u64);

impl Numbers {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    /// A number in 0..1.
    pub fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Integrates scans of a room in a walk back and forth, so that blocks change scale in both directions.
pub struct Walk {
    pub integrator: TsdfIntegrator,
    step: usize,
    has_intensity: bool,
    /// Rows and columns of a scan.
    rays: [usize; 2],
}

impl Walk {
    pub fn new(has_intensity: bool) -> Self {
        let settings = TsdfSettings { voxel_size: 0.1, scale_hysteresis: 1.0, ..TsdfSettings::default() };
        Self { integrator: TsdfIntegrator::new(settings), step: 0, has_intensity, rays: [64, 160] }
    }

    /// The same walk, from the same place on.
    pub fn again(&self) -> Self {
        Self { integrator: TsdfIntegrator::new(self.integrator.settings().clone()), ..*self }
    }

    pub fn scan_into(&mut self, field: &mut TsdfField) {
        const HALF: [f32; 3] = [14.0, 6.0, 2.0];
        let away = [0.0, 4.0, 8.0, 11.0, 8.0, 4.0, 0.0, -5.0][self.step % 8];
        self.step += 1;
        let origin = [away, 0.3 * self.step as f32 % 2.0, 0.1];
        let [rows, columns] = self.rays;
        let (mut points, mut intensities) = (Vec::new(), Vec::new());
        for ray in 0..rows * columns {
            let elevation = 0.5 - (ray / columns) as f32 / rows as f32;
            let azimuth = std::f32::consts::TAU * (ray % columns) as f32 / columns as f32 + 0.01 * self.step as f32;
            let d = [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()];
            let range = (0..3).map(|k| (HALF[k].copysign(d[k]) - origin[k]) / d[k]).fold(f32::INFINITY, f32::min);
            points.push(d.map(|c| c * range));
            intensities.push((ray % 251) as u8);
        }
        let normals = vec![[0.0; 3]; points.len()];
        let pose = Rigid { rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], translation: origin };
        let intensities = if self.has_intensity { &intensities[..] } else { &[] };
        self.integrator.integrate(field, &pose, &ReturnsView { intensities, ..ReturnsView::of_points(&points, &normals, 6.4 / columns as f32) });
    }
}

/// A pose with crooked numbers, the same on any machine: square roots are exact everywhere, sines are not.
pub fn pose(numbers: &mut Numbers) -> Pose {
    let mut within = |a: f64| a * (2.0 * numbers.unit() - 1.0);
    let translation = nalgebra::Translation3::new(within(1e4), within(1e-3), within(10.0));
    let rotation = nalgebra::Quaternion::new(within(1.0), within(1.0), within(1e-9), within(0.1));
    Pose::from_parts(translation, nalgebra::UnitQuaternion::new_normalize(rotation))
}

/// A field of `blocks` blocks with made-up content that depends on `seed` only, on any machine.
pub fn made_up_field(seed: u64, blocks: usize) -> TsdfField {
    let mut numbers = Numbers(seed);
    let mut builder = TsdfBuilder::default();
    let mut key = numbers.next() >> 24;
    for _ in 0..blocks {
        key += 1 + (numbers.next() >> 60).pow(2);
        let (a, b) = ((numbers.next() % 4) as u8, (numbers.next() % 4) as u8);
        let head = BlockHead { key, scale: a.max(b), finest: a.min(b), has_intensity: numbers.next() & 1 == 0 };
        let mut voxel = |_| match numbers.next() {
            n if n % 3 == 0 => Voxel { distance: (n >> 16) as i16, weight: (n >> 40) as u16 % 6400 },
            _ => Voxel::default(),
        };
        let voxels: Vec<Voxel> = (0..head.voxel_count()).map(&mut voxel).collect();
        let intensities: Vec<u8> = (0..head.intensity_count()).map(|_| (numbers.next() >> 50) as u8).collect();
        builder.push(head, &voxels, &intensities).expect("a possible block");
    }
    builder.finish()
}

/// Gives most blocks of a field colours that depend on `seed` only.
fn colour(field: &mut TsdfField, seed: u64) {
    let mut numbers = Numbers(seed ^ 2);
    for id in field.ids_in_morton_order() {
        let key = field.block(id).key;
        let scale = (numbers.next() % 5) as u8;
        if scale < 4 {
            let mut colour = |_| match numbers.next() {
                n if n.is_multiple_of(3) => {
                    ColourVoxel { rgb: [(n >> 16) as u8, (n >> 24) as u8, (n >> 32) as u8], observations: 1 + (n >> 40) as u8 % 16 }
                }
                _ => ColourVoxel::default(),
            };
            let colours: Vec<ColourVoxel> = (0..voxels_at(scale.into())).map(&mut colour).collect();
            field.set_colours(key, scale, &colours).expect("the block is there");
        }
    }
}

/// An occupancy field with about `octants` octants and made-up content that depends on `seed` only, on any machine.
pub fn made_up_occupancy(seed: u64, octants: usize) -> OccupancyField {
    let mut numbers = Numbers(seed);
    let mut octant = |linked: bool| {
        let n = numbers.next();
        OctantRecord { linked, summary: Summary { value: n as i8, max: (n >> 8) as i8, observed: n >> 16 & 1 == 1 } }
    };
    let level = 4;
    let mut builder = OccupancyBuilder::new(7 << 12, level, octant(octants > 0)).expect("a possible root");
    // Levels of the octants that are to come, the next one last.
    let mut levels = vec![level - 1; if octants > 0 { 8 } else { 0 }];
    let (mut made, mut blocks) = (levels.len(), 0);
    while let Some(level) = levels.pop() {
        let linked = made < octants && octant(false).summary.value % 3 != 0;
        builder.push_octant(octant(linked)).expect("an announced octant");
        match (linked, level) {
            (true, 0) => blocks += 1,
            (true, _) => {
                levels.extend([level - 1; 8]);
                made += 8;
            }
            (false, _) => {}
        }
    }
    let mut numbers = Numbers(seed ^ 1);
    for _ in 0..blocks {
        let scale = (numbers.next() % 4) as u8;
        let values: Vec<i8> = (0..voxels_at(usize::from(scale))).map(|_| (numbers.next() % 5) as i8 - 2).collect();
        builder.push_block(scale, &values).expect("an announced block");
    }
    builder.finish().expect("a whole field")
}

/// An atlas of `submaps` submaps with made-up content that depends on `seed` only.
pub fn made_up_atlas(seed: u64, submaps: usize, blocks: usize) -> Atlas {
    let mut numbers = Numbers(seed);
    let mut atlas = Atlas::new(0.065);
    for _ in 0..submaps {
        let id = atlas.spawn(pose(&mut numbers));
        let field_seed = numbers.next();
        let submap = atlas.submap_mut(id).expect("just made");
        // Every second and third of four has one field only.
        if id % 4 != 2 {
            *submap.tsdf_mut() = made_up_field(field_seed, blocks);
            if id % 4 == 3 {
                colour(submap.tsdf_mut(), field_seed);
            }
        }
        if id % 4 != 1 {
            *submap.occupancy_mut() = made_up_occupancy(field_seed, 4 * blocks);
        }
        let mut scans = Vec::new();
        for _ in 0..3 {
            let t_submap_lidar = pose(&mut numbers);
            scans.push(SubmapScan { node: numbers.next(), t_submap_lidar });
        }
        *submap = submap.clone().with_scans(scans, 100.0 * numbers.unit());
    }
    atlas
}

pub fn details(words: &str) -> MapDetails {
    let pairs = |key: &str| [(key.to_owned(), words.to_owned()), ("quote \" and \u{1F5FA}".to_owned(), "line\nbreak".to_owned())].into();
    MapDetails { generator: format!("tests of {words}"), settings: pairs("voxel"), sensor: pairs("model") }
}

/// A block of a TSDF: head, voxels, intensities, scale of its colours and these.
pub type BlockImage = (BlockHead, Vec<Voxel>, Vec<u8>, Option<(usize, Vec<ColourVoxel>)>);

/// Everything that a field is, without ids and slots.
pub fn image(field: &TsdfField) -> Vec<BlockImage> {
    let block = |id| {
        let colours = field.colours().block(id).map(|(scale, colours)| (scale, colours.to_vec()));
        (field.head(id), field.stored_voxels(id), field.stored_intensities(id), colours)
    };
    field.ids_in_morton_order().into_iter().map(block).collect()
}

/// Everything that an occupancy field is, without ids and slots.
pub fn occupancy_image(field: &OccupancyField) -> (u32, u64, Vec<OctantRecord>, Vec<i64>) {
    let mut blocks = Vec::new();
    for block in field.ids_in_morton_order().into_iter().map(|id| field.block(id)) {
        blocks.extend([block.key as i64, i64::from(block.scale)]);
        blocks.extend(field.values(block).iter().map(|&v| i64::from(v)));
    }
    (field.tree().root_level(), field.tree().root_key(), field.octants_in_order(), blocks)
}

fn pose_bits(pose: &Pose) -> [u64; 7] {
    let (t, q) = (&pose.translation.vector, &pose.rotation.coords);
    [t.x, t.y, t.z, q.x, q.y, q.z, q.w].map(f64::to_bits)
}

pub fn same_submap(a: &Submap, b: &Submap) -> bool {
    let scans = |s: &Submap| s.scans().iter().map(|s| (s.node, pose_bits(&s.t_submap_lidar))).collect::<Vec<_>>();
    a.id() == b.id()
        && pose_bits(&a.t_map_submap()) == pose_bits(&b.t_map_submap())
        && a.travelled().to_bits() == b.travelled().to_bits()
        && scans(a) == scans(b)
        && image(a.tsdf()) == image(b.tsdf())
        && occupancy_image(a.occupancy()) == occupancy_image(b.occupancy())
}

pub fn same_atlas(a: &Atlas, b: &Atlas) -> bool {
    a.submaps().len() == b.submaps().len() && a.submaps().iter().zip(b.submaps()).all(|(a, b)| same_submap(a, b))
}
