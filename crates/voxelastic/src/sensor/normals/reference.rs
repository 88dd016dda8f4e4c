//! The plane fit in its slow and obvious form: one pixel at a time, from the points of its window, in double precision. For tests.
//!
//! The rule: a plane is fitted around a pixel whose depth is its own, or that of the pixel after it or before it in the row where it is empty. Its window is found
//! by walking from pixel to linked pixel: down and up the pixel's column, and in each row that this reaches to both sides. In each row the walk goes as far as a
//! window at the depth found there is wide.

use super::covariance::{MAX_REACH, Width, WindowRule};
use super::settings::NormalSettings;
use crate::sensor::beam_model::BeamModel;

/// Points of an image, by pixel, and what is known of the scan.
pub(super) struct Reference<'a> {
    pub(super) model: &'a BeamModel,
    pub(super) points: &'a [Option<[f32; 3]>],
    pub(super) noise: f64,
    pub(super) settings: NormalSettings,
}

impl Reference<'_> {
    fn size(&self) -> [isize; 2] {
        [self.model.rows() as isize, self.model.columns() as isize]
    }

    fn step(&self) -> f64 {
        let sign = if self.model.is_clockwise() { -1.0 } else { 1.0 };
        sign * std::f64::consts::TAU / self.model.columns() as f64
    }

    /// A pixel's point from a column's axis, as (1 / X, Y / X, Z / X); columns go around.
    fn seen(&self, [row, column]: [isize; 2], from: isize) -> Option<[f64; 3]> {
        let [rows, columns] = self.size();
        let inside = (0..rows).contains(&row);
        let p = self.points[if inside { row * columns + column.rem_euclid(columns) } else { 0 } as usize].filter(|_| inside)?.map(f64::from);
        let (sin, cos) = (f64::from(self.model.azimuth(0.0, 0.0)) + from as f64 * self.step()).sin_cos();
        let (x, y) = (p[0] * cos + p[1] * sin, p[1] * cos - p[0] * sin);
        Some([1.0 / x, y / x, (p[2] - f64::from(self.model.origin_height())) / x])
    }

    fn own(&self, at: [isize; 2]) -> Option<[f64; 3]> {
        self.seen(at, at[1])
    }

    /// A pixel's inverse depth at its centre.
    fn centred(&self, [row, column]: [isize; 2]) -> Option<f64> {
        let [w, across, _] = self.own([row, column])?;
        let slope = |side: isize| self.own([row, column + side]).map_or(0.0, |[other, ..]| (other - w) * side as f64);
        let [left, right] = [slope(-1), slope(1)];
        let gentle = if left * right <= 0.0 { 0.0 } else { left.abs().min(right.abs()) * left.signum() };
        Some((w - gentle * across / self.step()).max(0.0))
    }

    /// Whether a surface goes on from the third of six pixels to the fourth, given as inverse depth and place; where one of the two is empty, beyond it.
    fn goes_on(&self, six: [Option<(f64, f64)>; 6]) -> bool {
        let four = match (six[2], six[3]) {
            (Some(_), Some(_)) => [1, 2, 3, 4],
            (Some(_), None) => [1, 2, 4, 5],
            (None, _) => [0, 1, 3, 4],
        };
        let [before, here, next, after] = four.map(|k| six[k]);
        let (Some(here), Some(next)) = (here, next) else { return false };
        let length = |a: (f64, f64), b: (f64, f64)| (b.1 - a.1).max(1e-4);
        let step = |a: (f64, f64), b: (f64, f64)| (b.0 - a.0) * length(here, next) / length(a, b);
        let mut steps = [before.map_or(0.0, |before| step(before, here)), next.0 - here.0, after.map_or(0.0, |after| step(next, after))];
        let middle = steps[1];
        steps.sort_by(f64::total_cmp);
        (middle - steps[1]).abs() <= 5.0 * self.noise * here.0.max(next.0).powi(2)
    }

    fn links_right(&self, [row, column]: [isize; 2]) -> bool {
        self.goes_on([-2, -1, 0, 1, 2, 3].map(|k| self.own([row, column + k]).map(|[w, ..]| (w, k as f64))))
    }

    fn links_down(&self, [row, column]: [isize; 2]) -> bool {
        let last = self.size()[0] - 1;
        // The first and the last row repeat beyond the image.
        let at = |k: isize| [(row + k).clamp(0, last), column];
        row < last && self.goes_on([-2, -1, 0, 1, 2, 3].map(|k| Some((self.centred(at(k)).filter(|w| *w > 0.0)?, -self.own(at(k))?[2]))))
    }

    /// The inverse depth that a window around a pixel has.
    fn depth(&self, [row, column]: [isize; 2]) -> Option<f64> {
        [0, 1, -1].iter().find_map(|k| self.own([row, column + k])).map(|[w, ..]| w)
    }

    /// The pixels of a window, and how many rows they are in.
    fn window(&self, [row, column]: [isize; 2], rule: &WindowRule, width: Width) -> Option<(Vec<[isize; 2]>, usize)> {
        let reach = |row: isize, w: f64, which: usize| (rule.reach(row as usize, width)[which].at(w as f32) + 0.5) as isize;
        let (mut pixels, mut rows) = (Vec::new(), 0);
        let mut add_row = |row: isize| {
            let Some(w) = self.depth([row, column]) else { return };
            let before = pixels.len();
            pixels.push([row, column]);
            let along = reach(row, w, 0);
            pixels.extend((1..=along).take_while(|k| self.links_right([row, column + k - 1])).map(|k| [row, column + k]));
            pixels.extend((1..=along).take_while(|k| self.links_right([row, column - k])).map(|k| [row, column - k]));
            pixels.retain(|at| self.own(*at).is_some());
            rows += usize::from(pixels.len() > before);
        };
        let down = reach(row, self.depth([row, column])?, 1);
        add_row(row);
        (1..=down).take_while(|k| self.links_down([row + k - 1, column])).for_each(|k| add_row(row + k));
        (1..=down).take_while(|k| row >= *k && self.links_down([row - k, column])).for_each(|k| add_row(row - k));
        assert!(pixels.len() <= (2 * MAX_REACH[0] + 1) * (2 * MAX_REACH[1] + 1));
        Some((pixels, rows))
    }

    /// Normal and distance of the plane at a pixel, if one is accepted.
    pub(super) fn plane(&self, at: [isize; 2], rule: &WindowRule) -> Option<[f64; 4]> {
        self.fit(at, rule, Width::Wide).or_else(|| self.fit(at, rule, Width::Narrow))
    }

    fn fit(&self, at: [isize; 2], rule: &WindowRule, width: Width) -> Option<[f64; 4]> {
        let (pixels, rows) = self.window(at, rule, width)?;
        let samples: Vec<[f64; 3]> = pixels.iter().filter_map(|pixel| self.seen(*pixel, at[1])).collect();
        let n = samples.len() as f64;
        let mean: [f64; 3] = std::array::from_fn(|k| samples.iter().map(|s| s[k]).sum::<f64>() / n.max(1.0));
        let moment = |i: usize, j: usize| samples.iter().map(|s| (s[i] - mean[i]) * (s[j] - mean[j])).sum::<f64>();
        let (xx, xt, tt, xu, tu, uu) = (moment(1, 1), moment(1, 2), moment(2, 2), moment(1, 0), moment(2, 0), moment(0, 0));
        let determinant = xx * tt - xt * xt;
        if n < 6.0 || determinant <= 0.05 * xx * tt {
            return None;
        }
        let (b, c) = ((xu * tt - tu * xt) / determinant, (tu * xx - xu * xt) / determinant);
        let a = mean[0] - b * mean[1] - c * mean[2];
        let length = (a * a + b * b + c * c).sqrt();
        let freedom = (n - 3.0).max(1.0);
        let variance = (uu - b * xu - c * tu).max(0.0) / freedom;
        let ray2 = 1.0 + f64::from(self.model.elevation(at[0] as f32).tan()).powi(2);
        let expected = self.noise.powi(2) / ray2 * mean[0].powi(4);
        let along_normal = variance / (length * mean[0]).powi(2);
        let most_rough = if width == Width::Narrow { f64::from(self.settings.roughness) } else { 0.0 };
        let is_flat = variance <= expected * (1.5 + 3.0 * (2.0 / freedom).sqrt()) || along_normal <= most_rough * most_rough;
        let uncertainty = expected.max(variance) / determinant * (tt + xx * ray2) / (length * length);
        let has_rows = rows >= 3 || mean[0] / length >= 0.05 * ray2.sqrt();
        let (sin, cos) = (f64::from(self.model.azimuth(0.0, 0.0)) + at[1] as f64 * self.step()).sin_cos();
        let accepted = is_flat && has_rows && uncertainty <= f64::from(self.settings.max_uncertainty).powi(2);
        accepted.then_some([(b * sin - a * cos) / length, -(a * sin + b * cos) / length, -c / length, 1.0 / length])
    }
}
