//! Screen-space ambient occlusion: darkens corners, gaps and outlines, which makes the geometry readable.
//!
//! For each pixel, neighbours are sampled along a spiral from 1.5 pixels (edges) to a twentieth of the picture (rooms). Those above the pixel's
//! tangent plane occlude it, less so when they are far in front. After Bavoil and Sainz 2008 and McGuire et al. 2011, with
//! radii in pixels so that one setting serves all scales.

use super::camera::Lens;
use crate::vec3;
use rayon::prelude::*;

/// Depth and normal of a pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surface {
    /// `q` of the nearest solid sample; minus infinity where there is none.
    pub q: f32,
    /// Its normal, view coordinates.
    pub normal: [f32; 3],
}

impl Surface {
    pub const NONE: Self = Self { q: f32::NEG_INFINITY, normal: [0.0; 3] };
}

const TAPS: usize = 18;
/// Turns of the spiral: the golden angle spreads the taps evenly.
const TURN: f32 = 2.399_963;

/// Brightness of each pixel, 1 for open surfaces. `lens` is that of pixels.
pub(super) fn occlusion(surfaces: &[Surface], width: usize, lens: &Lens, strength: f32) -> Vec<f32> {
    if strength <= 0.0 || width == 0 {
        return vec![1.0; surfaces.len()];
    }
    let height = surfaces.len() / width;
    let reach = (height.max(width) as f32 / 20.0).clamp(6.0, 120.0);
    let mut raw = vec![1.0f32; surfaces.len()];
    raw.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for (x, out) in row.iter_mut().enumerate() {
            *out = 1.0 - shadow(surfaces, (width, height), lens, reach, (x, y));
        }
    });
    let mut smooth = vec![1.0f32; surfaces.len()];
    smooth.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for (x, out) in row.iter_mut().enumerate() {
            *out = smoothed(surfaces, &raw, (width, height), (x, y)).powf(1.6 * strength);
        }
    });
    smooth
}

fn shadow(surfaces: &[Surface], (width, height): (usize, usize), lens: &Lens, reach: f32, (x, y): (usize, usize)) -> f32 {
    let here = surfaces[y * width + x];
    if here.q == f32::NEG_INFINITY {
        return 0.0;
    }
    let p = lens.unproject(x as f32 + 0.5, y as f32 + 0.5, here.q);
    let metres = 1.0 / lens.pixels_per_metre(p[2]);
    let phase = ((x & 3) * 4 + (y & 3)) as f32;
    // 16 interleaved phases: neighbours differ much, and the 4 x 4 mean averages all of them.
    let (turn, shift) = (phase * 0.618_034 * std::f32::consts::TAU, (phase * 0.381_966).fract());
    let mut sum = 0.0;
    for i in 0..TAPS {
        let f = (i as f32 + shift) / TAPS as f32;
        let r = 1.5 * (reach / 1.5).powf(f);
        let (s, c) = (turn + i as f32 * TURN).sin_cos();
        let (tx, ty) = ((x as f32 + 0.5 + r * c).floor(), (y as f32 + 0.5 + r * s).floor());
        if tx < 0.0 || ty < 0.0 || tx >= width as f32 || ty >= height as f32 {
            continue;
        }
        let there = surfaces[ty as usize * width + tx as usize];
        if there.q == f32::NEG_INFINITY {
            continue;
        }
        let v = vec3::sub(lens.unproject(tx + 0.5, ty + 0.5, there.q), p);
        let (d2, r_m) = (vec3::dot(v, v).max(1e-12), r * metres);
        let rise = vec3::dot(v, here.normal) / d2.sqrt();
        // A surface more than a few radii in front belongs to another object and occludes less.
        sum += (rise - 0.08).max(0.0) / (1.0 + 0.12 * d2 / (r_m * r_m));
    }
    (1.5 * sum / TAPS as f32).min(0.95)
}

/// Mean over 4 x 4 pixels at about the same depth.
fn smoothed(surfaces: &[Surface], raw: &[f32], (width, height): (usize, usize), (x, y): (usize, usize)) -> f32 {
    let here = surfaces[y * width + x];
    let (mut sum, mut weight) = (0.0, 0.0);
    for dy in 0..4 {
        for dx in 0..4 {
            let (tx, ty) = ((x + dx).saturating_sub(1), (y + dy).saturating_sub(1));
            if tx >= width || ty >= height {
                continue;
            }
            let there = surfaces[ty * width + tx];
            let w = if vec3::dot(there.normal, here.normal) > 0.7 { 1.0 } else { 0.05 };
            sum += w * raw[ty * width + tx];
            weight += w;
        }
    }
    if weight > 0.0 { sum / weight } else { raw[y * width + x] }
}
