//! A camera beside the LiDAR, and colours of worlds.
//!
//! Each solid has a colour of its own that varies smoothly from place to place, so that the true colour of every point is known. Images have an exposure
//! and a white balance of their own, as those of a camera that adapts. Bodies of [`crate::traffic`] are not in them.

mod files;
mod lens;

pub use lens::{Lens, t_lidar_camera};

use crate::random::Stream;
use crate::{Simulation, World};
use nalgebra::Vector3;
use rayon::prelude::*;
use voxelastic::Pose;
use voxelastic_colour::{Picture, to_srgb};

/// Images are taken so long after a scan, as a share of the time to the next.
const DELAY: f64 = 0.25;
/// How far the logarithm of an exposure may be from zero, and that of a channel from it.
const EXPOSURE: (f64, f64) = (0.4, 0.06);
/// Light of the sky, linear.
const SKY: [f64; 3] = [0.35, 0.5, 0.75];
/// Farther away everything is sky, metres.
const FARTHEST: f64 = 500.0;

impl World {
    /// Colour of a solid's surface at `p`, linear light from 0 to 1, red green blue.
    pub fn light(&self, solid: u32, p: [f64; 3]) -> [f64; 3] {
        let mut random = Stream::new(self.seed(), &[0xc0, u64::from(solid)]);
        std::array::from_fn(|k| {
            let (base, phase) = (random.range(0.1, 0.45), random.range(0.0, 6.3));
            // Smooth checks of 1.5 m, each channel turned a little.
            let wave = |c: f64| (c * std::f64::consts::TAU / 3.0 + phase).sin();
            base * (1.0 + 0.25 * (wave(p[0] + 0.3 * p[2]) + wave(p[1] - 0.4 * p[2]) * [1.0, -1.0, 0.5][k]))
        })
    }

    /// The true colour of the surface nearest to `p`, sRGB; `None` in an empty world.
    pub fn colour_at(&self, p: [f64; 3]) -> Option<[u8; 3]> {
        let (_, solid) = self.nearest(p)?;
        Some(self.light(solid, p).map(|c| to_srgb(c as f32)))
    }

    /// What a camera with `lens` at `t_map_camera` sees, each channel times its exposure.
    pub fn image(&self, lens: Lens, t_map_camera: &Pose, exposure: [f64; 3]) -> Picture {
        let (camera, all) = (lens.model(), lens.rays());
        let (width, height) = (camera.width(), camera.height());
        let origin = t_map_camera.translation.vector;
        let row = |v: usize| {
            let rays: Vec<Option<Vector3<f64>>> = all[v * width..][..width].iter().map(|ray| ray.map(|ray| t_map_camera.rotation * ray)).collect();
            let cast: Vec<_> = rays.iter().flatten().map(|ray| (origin, *ray)).collect();
            let mut hits = vec![None; cast.len()];
            self.cast_all(&cast, FARTHEST, &mut hits);
            let mut hits = hits.into_iter();
            let pixel = |ray: &Option<Vector3<f64>>| {
                let light = match (ray, ray.and_then(|_| hits.next().flatten())) {
                    (Some(ray), Some(hit)) => self.light(hit.solid, (origin + ray * hit.range).into()),
                    (Some(_), None) => SKY,
                    // Beyond the lens.
                    (None, _) => [0.0; 3],
                };
                std::array::from_fn(|k| to_srgb((light[k] * exposure[k]) as f32))
            };
            rays.iter().map(pixel).collect::<Vec<[u8; 3]>>()
        };
        Picture { width, height, pixels: (0..height).into_par_iter().flat_map_iter(row).collect() }
    }
}

impl Simulation {
    /// When image `k` is taken, seconds: between scan `k` and the next. `None` without a camera, and beyond the last scan.
    pub fn image_time(&self, k: usize) -> Option<f64> {
        self.options().camera?;
        Some(self.times().get(k)? + DELAY * self.step())
    }

    /// Exposure of image `k`, red green blue.
    pub fn exposure(&self, k: usize) -> [f64; 3] {
        let mut random = Stream::new(self.options().seed, &[0xe0, k as u64]);
        let common = random.range(-EXPOSURE.0, EXPOSURE.0);
        std::array::from_fn(|_| (common + random.range(-EXPOSURE.1, EXPOSURE.1)).exp())
    }

    /// Image `k`, taken at [`image_time`](Self::image_time).
    pub fn image(&self, k: usize) -> Option<Picture> {
        let (lens, time) = (self.options().camera?, self.image_time(k)?);
        let t_map_camera = self.scene().trajectory.pose(time) * t_lidar_camera();
        Some(self.world().image(lens, &t_map_camera, self.exposure(k)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SimError, SimOptions};

    #[test]
    fn images_show_the_colours_of_what_is_there() -> Result<(), SimError> {
        for lens in [Lens::Wide, Lens::Fisheye] {
            let simulation = Simulation::new(SimOptions { scans: Some(2), camera: Some(lens), ..SimOptions::of("room") })?;
            let (Some(picture), Some(time)) = (simulation.image(1), simulation.image_time(1)) else { panic!("no image") };
            let t_map_camera = simulation.scene().trajectory.pose(time) * t_lidar_camera();
            let (camera, exposure) = (lens.model(), simulation.exposure(1));
            for (u, v) in [(20usize, 200usize), (320, 240), (600, 300), (300, 460)] {
                let ray = t_map_camera.rotation * Vector3::from(camera.unproject([u as f64, v as f64]).unwrap());
                let hit = simulation.world().cast(t_map_camera.translation.vector.into(), ray.into(), 100.0).unwrap();
                let p = t_map_camera.translation.vector + ray * hit.range;
                let light = simulation.world().light(hit.solid, p.into());
                let expected = std::array::from_fn(|k| to_srgb((light[k] * exposure[k]) as f32));
                assert_eq!(picture.pixels[v * 640 + u], expected, "{lens:?} {u} {v}");
                let truth = simulation.world().colour_at(p.into()).unwrap();
                assert!((0..3).all(|k| truth[k].abs_diff(to_srgb(light[k] as f32)) <= 1));
            }
        }
        Ok(())
    }

    #[test]
    fn the_camera_looks_ahead() {
        let ahead = t_lidar_camera().rotation * Vector3::z();
        assert!(ahead.x > 0.98 && ahead.z < 0.0, "{ahead}");
        assert!((t_lidar_camera().rotation * Vector3::y()).z < -0.98, "down in the image is down");
    }
}
