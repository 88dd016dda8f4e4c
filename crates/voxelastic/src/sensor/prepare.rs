//! From a cloud to beams: the scan as the integrators take it.

use super::assign::{Assigner, BEYOND, NO_RETURN, OUTSIDE, TOO_NEAR, project};
use super::image::{NO_POINT, RangeImage};
use super::layout::Layout;
use super::model::BeamModel;
use super::normals::{NormalSettings, PlaneFitter};
use crate::Cloud;
use rayon::prelude::*;

/// Ranges outside of which returns are not used, metres from the beam's origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Nearer returns are the sensor's carrier or dust on its window.
    pub near: f32,
    /// Farther returns are not mapped; their beams are known to be free up to here.
    pub max: f32,
}

impl Default for Limits {
    fn default() -> Self {
        Self { near: 0.5, max: 60.0 }
    }
}

/// Points that one task takes: fewer are not worth handing out.
const PER_TASK: usize = 8192;

/// The usable returns of one scan, one entry a return in all vectors, pixel by pixel (row-major) and within a pixel in the
/// order of the cloud. Points that lost their pixel to a nearer one are there too.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Beams {
    /// The measured points, lidar frame at the cloud's time stamp, metres.
    pub points: Vec<[f32; 3]>,
    /// Unit normals of the local surface, facing the sensor, lidar frame; zero where no plane could be trusted. Empty until planes are fitted.
    pub normals: Vec<[f32; 3]>,
    /// How far the neighbours are off the local plane along its normal, metres (1 sigma); zero where there is no plane.
    pub roughness: Vec<f32>,
    /// Distances from the beams' origins to the points, metres.
    pub ranges: Vec<f32>,
    /// Where the lidar was when it measured each point, lidar frame at the cloud's time stamp, metres; empty when it stood still.
    pub origins: Vec<[f32; 3]>,
    /// Index of each point in the cloud.
    pub source: Vec<u32>,
    /// Pixel of the range image (row * columns + column) that each point falls into.
    pub pixel: Vec<u32>,
    /// Smallest angle between adjacent rays, radians.
    pub smallest_angle: f32,
}

impl PreparedScan {
    /// The scan as seen from one place, the lidar's pose at the time stamp, and whether empty pixels are accidents of projection.
    pub fn from_one_place(&self, fills_gaps: bool) -> (&RangeImage, bool) {
        self.still.as_ref().map_or((&self.image, fills_gaps), |still| (still, true))
    }
}

impl Beams {
    /// Number of usable returns.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether the scan has no usable return.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}

/// What became of a cloud's points. All but `hidden` add up to the points of the cloud.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Returns that became beams.
    pub usable: usize,
    /// Points that are no return (NaN or the origin).
    pub no_return: usize,
    /// Returns nearer than the near limit.
    pub too_near: usize,
    /// Returns farther than the maximum range.
    pub beyond_max: usize,
    /// Returns that no row of the model looks at.
    pub outside: usize,
    /// Usable returns that a nearer one hides in the range image.
    pub hidden: usize,
}

impl Counts {
    /// Counts those of a part of the cloud, too.
    fn add(&mut self, part: &Self) {
        self.usable += part.usable;
        self.no_return += part.no_return;
        self.too_near += part.too_near;
        self.beyond_max += part.beyond_max;
        self.outside += part.outside;
        self.hidden += part.hidden;
    }
}

/// A scan ready to be integrated.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PreparedScan {
    /// The scan as an image, each column as the lidar saw it.
    pub image: RangeImage,
    /// The scan as it would look from the lidar's pose at the time stamp, where the lidar moved during the sweep.
    pub still: Option<RangeImage>,
    /// The scan as beams.
    pub beams: Beams,
    /// What became of its points.
    pub counts: Counts,
}

/// Turns clouds of one sensor into [`PreparedScan`]s; keeps its memory, so use one for all scans.
#[derive(Clone, Debug)]
pub struct Preparer {
    model: BeamModel,
    limits: Limits,
    assigner: Assigner,
    fitter: PlaneFitter,
    scan: PreparedScan,
    /// Pixel and range of each point of the cloud; the codes of [`super::assign`] where a point has no pixel.
    pixels: Vec<u32>,
    ranges: Vec<f32>,
    /// Where the beams of each pixel end; scratch of the counting sort.
    ends: Vec<u32>,
    /// The points of a cloud taken in motion, set right.
    moved: Vec<[f32; 3]>,
    /// Where the lidar was at each of them.
    origins: Vec<[f32; 3]>,
}

impl Preparer {
    /// A preparer for clouds of `model` laid out as `layout`, with the default plane fit.
    pub fn new(model: BeamModel, layout: Layout, limits: Limits) -> Self {
        Self::with_normals(model, layout, limits, NormalSettings::default())
    }

    /// As [`Preparer::new`], with settings for the plane fit.
    pub fn with_normals(model: BeamModel, layout: Layout, limits: Limits, normals: NormalSettings) -> Self {
        let fitter = PlaneFitter::new(&model, normals);
        let assigner = Assigner::new(layout, &model);
        Self {
            model,
            limits,
            assigner,
            fitter,
            scan: PreparedScan::default(),
            pixels: Vec::new(),
            ranges: Vec::new(),
            ends: Vec::new(),
            moved: Vec::new(),
            origins: Vec::new(),
        }
    }

    /// The sensor.
    pub fn model(&self) -> &BeamModel {
        &self.model
    }

    /// How clouds are read.
    pub fn layout(&self) -> &Layout {
        self.assigner.layout()
    }

    /// The limits of use.
    pub fn limits(&self) -> Limits {
        self.limits
    }

    /// The scan prepared last.
    pub fn scan(&self) -> &PreparedScan {
        &self.scan
    }

    /// Prepares `cloud` (lidar frame). Pixels are those that the points were measured in; if the lidar moved, the points are then set right
    /// by their times. A cloud that lacks what the layout needs (another grid, no ring channel) is projected.
    ///
    /// The result is the same whatever the number of threads.
    pub fn prepare(&mut self, cloud: &Cloud) -> &PreparedScan {
        self.prepare_without_planes(cloud);
        self.fit_planes(cloud)
    }

    /// As [`prepare`](Self::prepare), without normals and roughness: those who do not ask for planes need not wait for them.
    pub fn prepare_without_planes(&mut self, cloud: &Cloud) -> &PreparedScan {
        let in_pixel_order = self.assigner.assign(cloud, &self.model, self.limits, &mut self.pixels, &mut self.ranges);
        self.scan.image.reset(self.model.rows(), self.model.columns());
        self.scan.counts = Counts::default();
        self.scan.beams.smallest_angle = self.model.smallest_angle();
        if in_pixel_order {
            self.fill_in_order();
        } else {
            self.fill_sorted();
        }
        let has_moved = cloud.motion.as_ref().is_some_and(|motion| motion.undistort(cloud, &mut self.moved, &mut self.origins));
        let points = if has_moved { &self.moved } else { &cloud.points };
        let PreparedScan { still, beams, .. } = &mut self.scan;
        pick(points, &beams.source, &mut beams.points);
        beams.origins.clear();
        if has_moved {
            pick(&self.origins, &beams.source, &mut beams.origins);
        }
        pick(&self.ranges, &beams.source, &mut beams.ranges);
        beams.normals.clear();
        beams.roughness.clear();
        let old = still.take();
        self.scan.still = has_moved.then(|| self.look_again(old));
        &self.scan
    }

    /// Adds the planes to the scan that was made last, from the same `cloud`.
    pub fn fit_planes(&mut self, cloud: &Cloud) -> &PreparedScan {
        let PreparedScan { image, still, beams, .. } = &mut self.scan;
        let points = if still.is_some() { &self.moved } else { &cloud.points };
        let times = cloud.time.as_deref().filter(|times| times.len() == cloud.len());
        self.fitter.fit(points, times, image, beams);
        &self.scan
    }

    /// The image that the points, set right, make from the lidar's pose at the time stamp.
    fn look_again(&self, still: Option<RangeImage>) -> RangeImage {
        let mut image = still.unwrap_or_default();
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

    /// Image and beam list of a cloud whose index is the pixel.
    fn fill_in_order(&mut self) {
        let PreparedScan { image, beams, counts, .. } = &mut self.scan;
        let shown = (image.ranges.par_chunks_mut(PER_TASK), image.points.par_chunks_mut(PER_TASK));
        let tasks = (self.pixels.par_chunks(PER_TASK), self.ranges.par_chunks(PER_TASK), shown.0, shown.1).into_par_iter();
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
        beams.source.resize(counts.usable, 0);
        let mut rest = &mut beams.source[..];
        let sources: Vec<&mut [u32]> = parts.iter().filter_map(|part| rest.split_off_mut(..part.usable)).collect();
        sources.into_par_iter().zip(self.pixels.par_chunks(PER_TASK)).for_each(|(sources, pixels)| {
            sources.iter_mut().zip(pixels.iter().filter(|pixel| **pixel < OUTSIDE)).for_each(|(source, &pixel)| *source = pixel);
        });
        beams.pixel.clone_from(&beams.source);
    }

    /// Image and beam list of a cloud in any order: a counting sort by pixel.
    fn fill_sorted(&mut self) {
        let PreparedScan { image, beams, counts, .. } = &mut self.scan;
        self.ends.clear();
        self.ends.resize(image.ranges.len() + 1, 0);
        for (i, (&pixel, &range)) in self.pixels.iter().zip(&self.ranges).enumerate() {
            if pixel < OUTSIDE {
                let at = pixel as usize;
                if range.is_finite() {
                    image.show(at, range, i as u32);
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
        // From counts to the start of each pixel; the scatter then turns starts into ends.
        let mut sum = 0;
        for end in &mut self.ends {
            sum += *end;
            *end = sum;
        }
        beams.source.clear();
        beams.source.resize(counts.usable, 0);
        beams.pixel.clear();
        beams.pixel.resize(counts.usable, 0);
        for (i, (&pixel, &range)) in self.pixels.iter().zip(&self.ranges).enumerate() {
            if pixel < OUTSIDE && range.is_finite() {
                let slot = &mut self.ends[pixel as usize];
                beams.source[*slot as usize] = i as u32;
                beams.pixel[*slot as usize] = pixel;
                *slot += 1;
            }
        }
        counts.hidden = counts.usable - image.points.iter().filter(|&&p| p != NO_POINT).count();
    }
}

/// Those of `all` that `which` names, side by side.
fn pick<T: Copy + Send + Sync>(all: &[T], which: &[u32], picked: &mut Vec<T>) {
    which.par_iter().with_min_len(PER_TASK).map(|&i| all[i as usize]).collect_into_vec(picked);
}

fn count(counts: &mut Counts, code: u32) {
    match code {
        NO_RETURN => counts.no_return += 1,
        TOO_NEAR => counts.too_near += 1,
        BEYOND => counts.beyond_max += 1,
        _ => counts.outside += 1,
    }
}
