//! The scene: what is rendered, and how.

use crate::colour::{Ramp, Rgb};
use crate::mesh::{MeshView, bounds};
use nalgebra::Point3;
use voxelastic::Pose;
use voxelastic::geometry::{Aabb, Rigid};

/// Points of an item sampled for [`Scene::main_bounds`].
const SAMPLE: usize = 200_000;

/// How a mesh or cloud is coloured.
#[derive(Clone, Copy, Debug)]
pub enum Colouring<'a> {
    /// One colour.
    Flat(Rgb),
    /// By height in the map frame: metres at the low and the high end of the ramp.
    Height {
        /// Colours to use.
        ramp: Ramp,
        /// Height of the lowest colour, metres.
        low: f32,
        /// Height of the highest colour, metres.
        high: f32,
    },
    /// By one value per vertex or point (intensity, error, scale, age).
    Scalar {
        /// One value per vertex or point.
        values: &'a [f32],
        /// Colours to use.
        ramp: Ramp,
        /// Value of the lowest colour.
        low: f32,
        /// Value of the highest colour.
        high: f32,
    },
    /// One colour per vertex or point.
    Vertex(&'a [Rgb]),
}

/// Size of the disc that a point is drawn as.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PointSize {
    /// Diameter in pixels of the picture.
    Pixels(f32),
    /// Diameter in metres.
    Metres(f32),
}

/// A mesh in the scene.
#[derive(Clone, Copy, Debug)]
pub struct MeshItem<'a> {
    /// The mesh, in its own frame (for instance a submap's).
    pub mesh: MeshView<'a>,
    /// Maps the mesh's frame to the map frame.
    pub t_map_mesh: Pose,
    /// Its colours.
    pub colouring: Colouring<'a>,
}

/// A cloud in the scene.
#[derive(Clone, Copy, Debug)]
pub struct CloudItem<'a> {
    /// The points, in their own frame, metres.
    pub points: &'a [[f32; 3]],
    /// Maps the cloud's frame to the map frame.
    pub t_map_cloud: Pose,
    /// Its colours.
    pub colouring: Colouring<'a>,
    /// Size of the discs.
    pub size: PointSize,
}

/// A line through points of the map frame: a trajectory, a loop edge, a path, the edges of a box.
#[derive(Clone, Debug)]
pub struct Polyline {
    /// The corners, map frame, metres.
    pub points: Vec<[f64; 3]>,
    /// Colour.
    pub colour: Rgb,
    /// Width in pixels of the picture.
    pub width: f32,
    /// Drawn over everything, without depth test.
    pub on_top: bool,
}

/// Which sides of triangles are drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Faces {
    /// Both; back faces are darker and greyer.
    #[default]
    Both,
    /// Front faces only (the free side): from above, rooms appear without their ceilings.
    Front,
}

/// A colour bar with numbers.
#[derive(Clone, Debug)]
pub struct Legend {
    /// Colours of the bar.
    pub ramp: Ramp,
    /// Number at its low end.
    pub low: f32,
    /// Number at its high end.
    pub high: f32,
    /// Quantity and unit.
    pub label: String,
}

/// Appearance of a picture.
#[derive(Clone, Debug)]
pub struct Style {
    /// Background colour; text and scale bar are black or white, whichever contrasts.
    pub background: Rgb,
    /// Which sides of triangles are drawn.
    pub faces: Faces,
    /// Removes everything above this height of the map frame, metres (a roof).
    pub cut_above: Option<f64>,
    /// Strength of ambient occlusion, 0 (none) to about 2.
    pub occlusion: f32,
    /// Draws a scale bar; only in orthographic views.
    pub scale_bar: bool,
    /// A colour bar.
    pub legend: Option<Legend>,
    /// Title at the top left; none when empty.
    pub title: String,
}

impl Default for Style {
    fn default() -> Self {
        Self { background: [255, 255, 255], faces: Faces::Both, cut_above: None, occlusion: 1.0, scale_bar: true, legend: None, title: String::new() }
    }
}

impl Style {
    /// A dark background.
    pub fn dark() -> Self {
        Self { background: [18, 20, 26], ..Self::default() }
    }
}

/// Everything that is rendered.
#[derive(Clone, Debug, Default)]
pub struct Scene<'a> {
    /// Triangle meshes.
    pub meshes: Vec<MeshItem<'a>>,
    /// Point clouds.
    pub clouds: Vec<CloudItem<'a>>,
    /// Lines.
    pub polylines: Vec<Polyline>,
    /// Appearance.
    pub style: Style,
}

impl Scene<'_> {
    /// Box around everything in the map frame, cut at [`Style::cut_above`]. It is computed from the items' own boxes, so it is a little large for rotated
    /// items.
    pub fn bounds(&self) -> Aabb {
        let mut all = Aabb::default();
        let items = self.meshes.iter().map(|m| (m.mesh.bounds(), m.t_map_mesh));
        for (b, t) in items.chain(self.clouds.iter().map(|c| (bounds(c.points), c.t_map_cloud))).filter(|(b, _)| !b.is_empty()) {
            for i in 0..8 {
                let at = |k: usize| f64::from(if i >> k & 1 == 0 { b.min[k] } else { b.max[k] });
                let p = t * Point3::new(at(0), at(1), at(2));
                all.add([p.x as f32, p.y as f32, p.z as f32]);
            }
        }
        for p in self.polylines.iter().flat_map(|l| &l.points).filter(|p| p.iter().all(|c| c.is_finite())) {
            all.add(p.map(|c| c as f32));
        }
        if let Some(cut) = self.style.cut_above.filter(|_| !all.is_empty()) {
            all.max[2] = all.max[2].min(cut as f32).max(all.min[2]);
        }
        all
    }

    /// Box around most of the scene in the map frame: along each axis without the share `outliers` (0 to 0.4) of vertices and points at either end, then
    /// enlarged by a tenth, so that a few stray returns do not shrink the picture. Lines are always inside. Also useful for the range of a height ramp.
    pub fn main_bounds(&self, outliers: f64) -> Aabb {
        let mut values: [Vec<f32>; 3] = Default::default();
        let meshes = self.meshes.iter().map(|m| (m.mesh.vertices(), m.t_map_mesh));
        for (points, t) in meshes.chain(self.clouds.iter().map(|c| (c.points, c.t_map_cloud))) {
            let rigid = Rigid::from(&t);
            // A fixed sample represents large items.
            for p in points.iter().step_by(points.len() / SAMPLE + 1).map(|p| rigid.apply(*p)) {
                let shown = self.style.cut_above.is_none_or(|cut| f64::from(p[2]) <= cut);
                if shown && p.iter().all(|c| c.is_finite()) {
                    (0..3).for_each(|k| values[k].push(p[k]));
                }
            }
        }
        let mut all = Aabb::default();
        if !values[0].is_empty() {
            let last = values[0].len() - 1;
            let skip = ((last as f64 * outliers.clamp(0.0, 0.4)) as usize).min(last / 2);
            let ends = values.each_mut().map(|v| {
                let lo = *v.select_nth_unstable_by(skip, f32::total_cmp).1;
                let hi = *v.select_nth_unstable_by(last - skip, f32::total_cmp).1;
                (lo - 0.05 * (hi - lo), hi + 0.05 * (hi - lo))
            });
            all = Aabb { min: ends.map(|e| e.0), max: ends.map(|e| e.1) };
        }
        for p in self.polylines.iter().flat_map(|l| &l.points).filter(|p| p.iter().all(|c| c.is_finite())) {
            all.add(p.map(|c| c as f32));
        }
        all
    }
}
