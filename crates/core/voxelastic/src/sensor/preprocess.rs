//! Scan preprocessing: from a cloud to a range image and a list of returns.

use super::beam_model::BeamModel;
use super::cloud_layout::CloudLayout;
use super::normals::{NormalSettings, PlaneFitter};
use super::prepared_scan::{Counts, PreparedScan};
use super::project::{BEYOND, NO_RETURN, OUTSIDE, Projector, TOO_NEAR, project};
use super::range_image::{NO_POINT, RangeImage};
use super::range_limits::RangeLimits;
use super::scattered::ScatteredFitter;
use crate::Cloud;
use rayon::prelude::*;

/// Points of one task: fewer are not worth the overhead.
const POINTS_PER_TASK: usize = 8192;

/// Turns clouds of one sensor into [`PreparedScan`]s. Holds scratch memory, so one preprocessor should serve all scans.
#[derive(Clone, Debug)]
pub struct ScanPreprocessor {
    model: BeamModel,
    limits: RangeLimits,
    projector: Projector,
    fitter: Fitter,
    scan: PreparedScan,
    /// Pixel and range of each point of the cloud; the codes of [`crate::sensor::project`] where a point has no pixel.
    pixels: Vec<u32>,
    ranges: Vec<f32>,
    /// End of the returns of each pixel; scratch memory of the counting sort.
    ends: Vec<u32>,
    /// Undistorted points of a cloud taken in motion.
    moved: Vec<[f32; 3]>,
    /// Position of the lidar at each of them.
    origins: Vec<[f32; 3]>,
}

impl ScanPreprocessor {
    /// A preprocessor for clouds of `model` with the given layout, with the default plane fit.
    pub fn new(model: BeamModel, layout: CloudLayout, limits: RangeLimits) -> Self {
        Self::with_normals(model, layout, limits, NormalSettings::default())
    }

    /// As [`ScanPreprocessor::new`], with settings for the plane fit.
    pub fn with_normals(model: BeamModel, layout: CloudLayout, limits: RangeLimits, normals: NormalSettings) -> Self {
        let fitter = match layout {
            CloudLayout::Scattered => Fitter::Space(ScatteredFitter::new(normals)),
            _ => Fitter::Image(Box::new(PlaneFitter::new(&model, normals))),
        };
        let projector = Projector::new(layout, &model);
        Self {
            model,
            limits,
            projector,
            fitter,
            scan: PreparedScan::default(),
            pixels: Vec::new(),
            ranges: Vec::new(),
            ends: Vec::new(),
            moved: Vec::new(),
            origins: Vec::new(),
        }
    }

    /// Adds points at most `step` metres apart between returns of scattered clouds that lie on one plane, when planes are fitted; see [`Returns::measured`].
    ///
    /// [`Returns::measured`]: super::Returns::measured
    pub fn fill_between(&mut self, step: f32) {
        if let Fitter::Space(fitter) = &mut self.fitter {
            fitter.set_step(step);
        }
    }

    /// The sensor.
    pub fn model(&self) -> &BeamModel {
        &self.model
    }

    /// The layout of the clouds.
    pub fn layout(&self) -> &CloudLayout {
        self.projector.layout()
    }

    /// Prepares `cloud` (lidar frame), planes included. Pixels are those that the points were measured in; if the lidar moved, the points are then undistorted by
    /// their times. A cloud without what the layout needs (the grid's size, a ring channel) is projected.
    ///
    /// The result does not depend on the number of threads.
    pub fn prepare(&mut self, cloud: &Cloud) -> &PreparedScan {
        self.prepare_returns(cloud);
        LazyScan { preprocessor: &mut *self, cloud }.fit_planes();
        &self.scan
    }

    /// As [`prepare`](Self::prepare), but planes are fitted on demand.
    pub fn prepare_lazily<'a>(&'a mut self, cloud: &'a Cloud) -> LazyScan<'a> {
        self.prepare_returns(cloud);
        LazyScan { preprocessor: self, cloud }
    }

    /// Makes the image and the list of returns, without planes.
    fn prepare_returns(&mut self, cloud: &Cloud) {
        let in_pixel_order = self.projector.pixels_of(cloud, &self.model, self.limits, &mut self.pixels, &mut self.ranges);
        self.scan.image.reset(self.model.rows(), self.model.columns());
        self.scan.counts = Counts::default();
        self.scan.returns.smallest_angle = self.model.smallest_angle();
        let has_moved = cloud.undistort_into(&mut self.moved, &mut self.origins);
        let moved = std::mem::take(&mut self.moved);
        let points = if has_moved { &moved } else { &cloud.points };
        if matches!(self.fitter, Fitter::Space(_)) {
            self.fill_scattered(points);
        } else if in_pixel_order {
            self.fill_in_order(points);
        } else {
            self.fill_sorted(points);
        }
        self.moved = moved;
        let PreparedScan { single_view, returns, .. } = &mut self.scan;
        returns.origins.clear();
        if has_moved {
            gather_into(&self.origins, &returns.source, &mut returns.origins);
        }
        returns.normals.clear();
        returns.roughness.clear();
        returns.spacing.clear();
        returns.measured = returns.points.len();
        let old = single_view.take();
        self.scan.single_view = has_moved.then(|| self.project_moved(old));
    }

    /// The range image of the undistorted points, as seen from the lidar's pose at the time stamp.
    fn project_moved(&self, single_view: Option<RangeImage>) -> RangeImage {
        let mut image = single_view.unwrap_or_default();
        image.reset(self.model.rows(), self.model.columns());
        let (mut pixels, mut ranges) = (vec![0; self.moved.len()], vec![0.0; self.moved.len()]);
        project(&self.moved, None, &self.model, self.limits, &mut pixels, &mut ranges);
        for (i, (&pixel, &range)) in pixels.iter().zip(&ranges).enumerate().filter(|(_, (pixel, _))| **pixel < OUTSIDE) {
            let at = pixel as usize;
            if range.is_finite() {
                image.show(at, range, i as u32);
            } else if image.ranges[at] == 0.0 {
                image.ranges[at] = f32::INFINITY;
            }
        }
        image
    }

    /// Fills image and returns from a cloud in which the index of a point is its pixel.
    fn fill_in_order(&mut self, points: &[[f32; 3]]) {
        let PreparedScan { image, returns, counts, .. } = &mut self.scan;
        let shown = (image.ranges.par_chunks_mut(POINTS_PER_TASK), image.points.par_chunks_mut(POINTS_PER_TASK));
        let tasks = (self.pixels.par_chunks(POINTS_PER_TASK), self.ranges.par_chunks(POINTS_PER_TASK), shown.0, shown.1).into_par_iter();
        let show = tasks.map(|(pixels, ranges, shown, points)| {
            let mut counts = Counts::default();
            for (((&pixel, &range), shown), point) in pixels.iter().zip(ranges).zip(shown).zip(points) {
                if pixel < OUTSIDE {
                    (*shown, *point) = (range, pixel);
                    counts.usable += 1;
                } else {
                    count(&mut counts, pixel);
                    *shown = if pixel == BEYOND { f32::INFINITY } else { *shown };
                }
            }
            counts
        });
        let parts: Vec<Counts> = show.collect();
        parts.iter().for_each(|part| counts.add(part));
        returns.source.resize(counts.usable, 0);
        let mut remaining = &mut returns.source[..];
        let sources: Vec<&mut [u32]> = parts.iter().filter_map(|part| remaining.split_off_mut(..part.usable)).collect();
        sources.into_par_iter().zip(self.pixels.par_chunks(POINTS_PER_TASK)).for_each(|(sources, pixels)| {
            sources.iter_mut().zip(pixels.iter().filter(|pixel| **pixel < OUTSIDE)).for_each(|(source, &pixel)| *source = pixel);
        });
        returns.pixel.clone_from(&returns.source);
        gather_into(points, &returns.source, &mut returns.points);
        gather_into(&self.ranges, &returns.source, &mut returns.ranges);
    }

    /// Fills image and returns from a cloud in any order, by a counting sort by pixel.
    fn fill_sorted(&mut self, points: &[[f32; 3]]) {
        let PreparedScan { image, returns, counts, .. } = &mut self.scan;
        self.ends.clear();
        self.ends.resize(image.ranges.len() + 1, 0);
        for (i, (&pixel, &range)) in self.pixels.iter().zip(&self.ranges).enumerate() {
            if pixel < OUTSIDE {
                let at = pixel as usize;
                if range.is_finite() {
                    image.show(at, range, i as u32);
                    counts.hidden += usize::from(self.ends[at + 1] > 0);
                    self.ends[at + 1] += 1;
                    counts.usable += 1;
                } else {
                    counts.beyond_max += 1;
                    if image.ranges[at] == 0.0 {
                        image.ranges[at] = f32::INFINITY;
                    }
                }
            } else {
                count(counts, pixel);
            }
        }
        // Prefix sums turn counts into the start of each pixel; writing the returns moves starts to ends.
        let mut sum = 0;
        for end in &mut self.ends {
            sum += *end;
            *end = sum;
        }
        returns.source.resize(counts.usable, 0);
        returns.pixel.resize(counts.usable, 0);
        returns.ranges.resize(counts.usable, 0.0);
        returns.points.resize(counts.usable, [0.0; 3]);
        let all = self.pixels.iter().zip(&self.ranges).zip(points).zip(0u32..);
        for (((&pixel, &range), &point), i) in all {
            if pixel < OUTSIDE && range.is_finite() {
                let end = &mut self.ends[pixel as usize];
                let slot = *end as usize;
                *end += 1;
                (returns.source[slot], returns.pixel[slot]) = (i, pixel);
                (returns.points[slot], returns.ranges[slot]) = (point, range);
            }
        }
    }

    /// Fills image and returns from a cloud that fits no image. Returns outside of the image are used, too.
    fn fill_scattered(&mut self, points: &[[f32; 3]]) {
        let Self { fitter, scan: PreparedScan { image, returns, counts, .. }, pixels, ranges, .. } = self;
        returns.source.clear();
        for ((&pixel, &range), i) in pixels.iter().zip(&*ranges).zip(0u32..) {
            if pixel > OUTSIDE {
                count(counts, pixel);
            } else if !range.is_finite() {
                counts.beyond_max += 1;
                if let Some(shown) = image.ranges.get_mut(pixel as usize).filter(|shown| **shown == 0.0) {
                    *shown = f32::INFINITY;
                }
            } else {
                counts.usable += 1;
                returns.source.push(i);
                if pixel < OUTSIDE {
                    counts.hidden += usize::from(image.points[pixel as usize] != NO_POINT);
                    image.show(pixel as usize, range, i);
                }
            }
        }
        if let Fitter::Space(fitter) = fitter {
            fitter.sort(points, &mut returns.source);
        }
        gather_into(points, &returns.source, &mut returns.points);
        gather_into(pixels, &returns.source, &mut returns.pixel);
        gather_into(ranges, &returns.source, &mut returns.ranges);
    }
}

/// Where the planes come from.
#[derive(Clone, Debug)]
enum Fitter {
    /// From neighbours in the image.
    Image(Box<PlaneFitter>),
    /// From neighbours in space.
    Space(ScatteredFitter),
}

/// A scan whose planes are fitted on demand.
#[derive(Debug)]
pub struct LazyScan<'a> {
    preprocessor: &'a mut ScanPreprocessor,
    cloud: &'a Cloud,
}

impl LazyScan<'_> {
    /// The scan; its normals are empty until [`fit_planes`](Self::fit_planes).
    pub fn scan(&self) -> &PreparedScan {
        &self.preprocessor.scan
    }

    /// The sensor.
    pub fn model(&self) -> &BeamModel {
        &self.preprocessor.model
    }

    /// Fits the local planes, unless that has been done, and returns the scan with them.
    pub fn fit_planes(&mut self) -> &PreparedScan {
        let ScanPreprocessor { scan, fitter, moved, .. } = &mut *self.preprocessor;
        let PreparedScan { image, single_view, returns, .. } = scan;
        if returns.normals.len() < returns.len() {
            let points = if single_view.is_some() { &*moved } else { &self.cloud.points };
            let times = self.cloud.time.as_deref().filter(|times| times.len() == self.cloud.len());
            match fitter {
                Fitter::Image(fitter) => fitter.fit(points, times, image, returns),
                Fitter::Space(fitter) => fitter.fit(returns),
            }
        }
        &self.preprocessor.scan
    }
}

/// Gathers `all[which]` in parallel.
fn gather_into<T: Copy + Send + Sync>(all: &[T], which: &[u32], picked: &mut Vec<T>) {
    which.par_iter().with_min_len(POINTS_PER_TASK).map(|&i| all[i as usize]).collect_into_vec(picked);
}

/// Counts a point without a pixel.
fn count(counts: &mut Counts, code: u32) {
    match code {
        NO_RETURN => counts.no_return += 1,
        TOO_NEAR => counts.too_near += 1,
        BEYOND => counts.beyond_max += 1,
        _ => counts.outside += 1,
    }
}
