//! Shading: the colour of a surface and the light on it.

use super::camera::{Camera, Lens};
use super::geometry::{Part, ViewSpace};
use super::scene::{Colouring, Scene};
use crate::colour::to_linear;
use crate::vec3;
use voxelastic::geometry::Rigid;

/// A shaded sample.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shaded {
    /// Linear light, red green blue.
    pub colour: [f32; 3],
    /// Unit normal towards the viewer, view coordinates.
    pub normal: [f32; 3],
    /// Whether ambient occlusion applies (not to lines).
    pub solid: bool,
}

/// Inputs of shading.
pub(super) struct Shader<'a> {
    pub scene: &'a Scene<'a>,
    pub view: &'a ViewSpace,
    pub lens: Lens,
    /// Per mesh, mesh to view coordinates (for normals), and map up in view coordinates.
    rotations: Vec<Rigid>,
    up: [f32; 3],
    /// Per mesh and per cloud, the row that gives map height from item coordinates.
    mesh_height: Vec<[f32; 4]>,
    cloud_height: Vec<[f32; 4]>,
}

impl<'a> Shader<'a> {
    pub fn new(scene: &'a Scene<'a>, view: &'a ViewSpace, camera: &Camera, lens: Lens) -> Self {
        let height_row = |t: &voxelastic::Pose| {
            let r = Rigid::from(t);
            [r.rotation[2][0], r.rotation[2][1], r.rotation[2][2], r.translation[2]]
        };
        Self {
            rotations: scene.meshes.iter().map(|m| Rigid::from(&(camera.t_view_map * m.t_map_mesh))).collect(),
            up: Rigid::from(&camera.t_view_map).rotate([0.0, 0.0, 1.0]),
            mesh_height: scene.meshes.iter().map(|m| height_row(&m.t_map_mesh)).collect(),
            cloud_height: scene.clouds.iter().map(|c| height_row(&c.t_map_cloud)).collect(),
            scene,
            view,
            lens,
        }
    }

    /// Shades primitive `id` at the sample position (`x`, `y`) of the picture, seen at `q`.
    pub fn shade(&self, id: u32, x: f32, y: f32, q: f32) -> Shaded {
        match self.view.part(id) {
            Part::Segment(s) => {
                let line = self.view.segments[s].2 as usize;
                let colour = self.scene.polylines[line].colour.map(to_linear);
                Shaded { colour, normal: [0.0, 0.0, -1.0], solid: false }
            }
            Part::Point { cloud, point } => {
                let item = &self.scene.clouds[cloud];
                let albedo = colour_of(&item.colouring, [(point, 1.0); 1], || height(self.cloud_height[cloud], item.points[point]));
                Shaded { colour: albedo.map(|c| c * 0.95), normal: self.lens.viewer_direction(self.view.clouds[cloud][point]), solid: true }
            }
            Part::Triangle { mesh, triangle } => self.surface(mesh, triangle, self.lens.unproject(x, y, q)),
        }
    }

    fn surface(&self, mesh: usize, triangle: usize, at: [f32; 3]) -> Shaded {
        let item = &self.scene.meshes[mesh];
        let t = item.mesh.triangles()[triangle].map(|v| v as usize);
        let v = t.map(|k| self.view.meshes[mesh][k]);
        let face = vec3::cross(vec3::sub(v[1], v[0]), vec3::sub(v[2], v[0]));
        let weights = barycentric(v, face, at);
        let to_viewer = self.lens.viewer_direction(at);
        let back = vec3::dot(face, to_viewer) < 0.0;
        let mut normal = vec3::unit(face);
        if let Some(normals) = item.mesh.normals() {
            let n = std::array::from_fn(|k| (0..3).map(|c| weights[c] * normals[t[c]][k]).sum());
            let n = vec3::unit(self.rotations[mesh].rotate(n));
            normal = if n == [0.0; 3] || !n.iter().all(|c| c.is_finite()) { normal } else { n };
        }
        // Vertex normals are turned to the visible side of the face.
        if vec3::dot(normal, to_viewer) < 0.0 {
            normal = vec3::scale(normal, -1.0);
        }
        let corners = std::array::from_fn::<_, 3, _>(|c| (t[c], weights[c]));
        let mut albedo = colour_of(&item.colouring, corners, || {
            let p = item.mesh.vertices();
            height(self.mesh_height[mesh], std::array::from_fn(|k| (0..3).map(|c| weights[c] * p[t[c]][k]).sum()))
        });
        if back {
            let grey = (albedo[0] + albedo[1] + albedo[2]) / 3.0;
            albedo = albedo.map(|c| 0.62 * (0.55 * c + 0.45 * grey));
        }
        let light = self.light(normal, to_viewer);
        Shaded { colour: std::array::from_fn(|k| albedo[k] * light[k]), normal, solid: true }
    }

    /// Light on a surface: a warm key light from behind the viewer's left, a headlight, and a cool sky.
    fn light(&self, n: [f32; 3], to_viewer: [f32; 3]) -> [f32; 3] {
        const KEY: [f32; 3] = [-0.48, -0.62, -0.62];
        let key = vec3::dot(n, KEY).max(0.0);
        let head = vec3::dot(n, to_viewer).max(0.0);
        let sky = 0.5 + 0.5 * vec3::dot(n, self.up);
        std::array::from_fn(|k| [0.62, 0.60, 0.56][k] * key + [0.20, 0.20, 0.20][k] * head + [0.34, 0.37, 0.42][k] * (0.35 + 0.65 * sky))
    }
}

fn height(row: [f32; 4], p: [f32; 3]) -> f32 {
    row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3]
}

/// Weights of the corners at a point of the triangle's plane, inside the triangle.
fn barycentric(v: [[f32; 3]; 3], face: [f32; 3], at: [f32; 3]) -> [f32; 3] {
    let area2 = vec3::dot(face, face);
    if area2 <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let weight = |a: usize, b: usize| vec3::dot(vec3::cross(vec3::sub(v[b], v[a]), vec3::sub(at, v[a])), face) / area2;
    let w = [weight(1, 2), weight(2, 0), weight(0, 1)].map(|w| w.clamp(0.0, 1.0));
    let sum = (w[0] + w[1] + w[2]).max(1e-9);
    w.map(|w| w / sum)
}

/// Linear colour from weighted vertices. Colours of unequal vertices blend after the ramp only for [`Colouring::Vertex`].
fn colour_of<const N: usize>(colouring: &Colouring<'_>, corners: [(usize, f32); N], height: impl Fn() -> f32) -> [f32; 3] {
    let on_ramp = |value: f32, low: f32, high: f32| (value - low) / (high - low).max(1e-9);
    match colouring {
        Colouring::Flat(c) => c.map(to_linear),
        Colouring::Height { ramp, low, high } => ramp.at(on_ramp(height(), *low, *high)).map(to_linear),
        Colouring::Scalar { values, ramp, low, high } => {
            let value = corners.iter().map(|(v, w)| w * values[*v]).sum();
            ramp.at(on_ramp(value, *low, *high)).map(to_linear)
        }
        Colouring::Vertex(colours) => std::array::from_fn(|k| corners.iter().map(|(v, w)| w * to_linear(colours[*v][k])).sum()),
    }
}
