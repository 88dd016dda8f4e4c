//! Recognising a sensor from its clouds (`--sensor auto`).
//!
//! The methods are tried in the order of how much they need: an organised cloud is the sensor's grid ([`grid`]); a ring channel, or points that come ring by ring,
//! give the rows ([`rings`]); otherwise rows and columns are estimated from the angles between neighbouring points ([`lattice`]). The model is then tested on the
//! clouds and described in words. If that last one fits badly, no image fits, and pixels are as large as the beams are far apart ([`density`]).

mod angles;
mod density;
mod grid;
mod lattice;
mod rings;

use crate::Cloud;
use crate::sensor::beam_model::BeamModel;
use crate::sensor::cloud_layout::CloudLayout;
use crate::sensor::error::SensorError;
use crate::sensor::prepared_scan::PreparedScan;
use crate::sensor::preprocess::ScanPreprocessor;
use crate::sensor::range_limits::RangeLimits;

/// Least returns for a recognition.
const LEAST_RETURNS: usize = 200;
/// With fewer returns that have a pixel of their own in the best image, no image fits.
const LEAST_SHOWN: f32 = 0.75;
/// With more returns that stand alone in the best image, the cloud was thinned, and no image fits: a beam's neighbours on the same ring mostly return, too.
const MOST_ALONE: f32 = 0.3;
/// Most points that are used; more would not change the result.
const MOST_POINTS: usize = 2_000_000;

/// A recognised sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Detected {
    /// Its beams.
    pub model: BeamModel,
    /// The layout of its clouds.
    pub layout: CloudLayout,
    /// The model and how well it fits, in one line of text.
    pub description: String,
    /// How well it fits the clouds from which it was measured.
    pub fit: Fit,
}

/// How well returns fit the pixels of a model.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Fit {
    /// Share of the returns that are shown in the image: the nearest of their pixel.
    pub shown: f32,
    /// Share of the returns that are outside of the field of view.
    pub outside: f32,
    /// Share of the pixels that show a return.
    pub filled: f32,
    /// Share of the empty pixels whose left and right neighbours show returns: artefacts of projection, or dropouts.
    pub gaps: f32,
    /// Share of the pixels with a return whose left and right neighbours show none: in clouds that were thinned.
    pub alone: f32,
}

/// Recognises the sensor that took `clouds`. One cloud is enough, a few from different places are better.
///
/// # Errors
/// [`SensorError::TooFewReturns`] or [`SensorError::NoSpread`] when the clouds hold no scan.
pub fn detect(clouds: &[&Cloud]) -> Result<Detected, SensorError> {
    let returns: usize = clouds.iter().map(|c| c.points.iter().filter(|p| Cloud::is_return(p)).count()).sum();
    if returns < LEAST_RETURNS {
        return Err(SensorError::TooFewReturns { returns, clouds: clouds.len(), needed: LEAST_RETURNS });
    }
    let mut taken = 0;
    let is_wanted = |cloud: &&Cloud| {
        let is_wanted = taken < MOST_POINTS;
        taken += cloud.len();
        is_wanted
    };
    let few: Vec<&Cloud> = clouds.iter().copied().take_while(is_wanted).collect();
    let found = grid::recognise(&few).or_else(|| rings::recognise_field(&few)).or_else(|| rings::recognise_order(&few));
    if let Some((model, layout)) = found {
        return Ok(Detected::new(model, layout, &few, describe));
    }
    let of_lattice = lattice::recognise(&few)?.map(|model| Detected::new(model, CloudLayout::Projected, &few, describe));
    let why = match of_lattice {
        Some(found) if found.fit.shown >= LEAST_SHOWN && found.fit.alone <= MOST_ALONE => return Ok(found),
        Some(Detected { fit, .. }) if fit.alone > MOST_ALONE => {
            format!("in the best image, {:.0} % of the returns would have no neighbour beside them: the cloud was thinned", 100.0 * fit.alone)
        }
        Some(Detected { fit, .. }) => format!("in the best image, {:.0} % of the returns would have a pixel of their own", 100.0 * fit.shown),
        None => "the cloud was thinned".to_owned(),
    };
    let describe = |model: &BeamModel, layout: &CloudLayout, _: &Fit| {
        format!("unorganised, beams about {:.1} degrees apart; {layout} ({why})", model.smallest_angle().to_degrees())
    };
    Ok(Detected::new(density::recognise(&few)?, CloudLayout::Scattered, &few, describe))
}

impl Detected {
    fn new(model: BeamModel, layout: CloudLayout, clouds: &[&Cloud], describe: impl Fn(&BeamModel, &CloudLayout, &Fit) -> String) -> Self {
        let fit = Fit::of(&model, &layout, clouds);
        let description = describe(&model, &layout, &fit);
        Self { model, layout, description, fit }
    }
}

/// The layout of clouds of a known sensor: the model's grid, or rings, if that agrees with the model's angles, else projected.
pub fn layout_for(model: &BeamModel, cloud: &Cloud) -> CloudLayout {
    /// Share of the returns that must be within a pixel and a half of where a layout puts them.
    const AGREES: f32 = 0.9;
    let rows = 0..model.rows() as u16;
    let candidates = [
        Some(CloudLayout::grid_of(model)),
        grid::recognise(&[cloud]).map(|(_, layout)| layout),
        Some(CloudLayout::Rings { row_of_ring: model.row_of_ring().to_vec() }),
        Some(CloudLayout::Rings { row_of_ring: rows.clone().collect() }),
        Some(CloudLayout::Rings { row_of_ring: rows.rev().collect() }),
    ];
    let agreeing = candidates.into_iter().flatten().find(|layout| agreement(model, layout, cloud) >= AGREES);
    agreeing.unwrap_or(CloudLayout::Projected)
}

/// Share of a cloud's returns for which the layout's pixel is the projected one; 0 if the layout does not apply to the cloud.
fn agreement(model: &BeamModel, layout: &CloudLayout, cloud: &Cloud) -> f32 {
    let applies = match layout {
        CloudLayout::Grid(grid) => grid.size_in(cloud, model).is_some(),
        CloudLayout::Rings { .. } => cloud.ring.as_ref().is_some_and(|ring| ring.len() == cloud.len()),
        _ => false,
    };
    if !applies {
        return 0.0;
    }
    let mut preprocessor = ScanPreprocessor::new(model.clone(), layout.clone(), RangeLimits { near: 0.0, max: f32::MAX });
    let scan = preprocessor.prepare(cloud);
    let columns = model.columns() as f32;
    let near = |(p, &pixel): (&[f32; 3], &u32)| {
        let (row, column) = (pixel / model.columns() as u32, pixel % model.columns() as u32);
        model.project(*p).is_some_and(|q| {
            let off = (q.column - column as f32).abs();
            (q.row - row as f32).abs() < 1.5 && off.min(columns - off) < 1.5
        })
    };
    let hits = scan.returns.points.iter().zip(&scan.returns.pixel).filter(|&pair| near(pair)).count();
    hits as f32 / (scan.counts.usable + scan.counts.outside).max(1) as f32
}

impl Fit {
    fn of(model: &BeamModel, layout: &CloudLayout, clouds: &[&Cloud]) -> Self {
        let mut preprocessor = ScanPreprocessor::new(model.clone(), layout.clone(), RangeLimits { near: 0.0, max: f32::MAX });
        let (mut usable, mut hidden, mut outside, mut empty, mut seen) = (0, 0, 0, 0, Neighbours::default());
        for cloud in clouds.iter().take(5) {
            let scan = preprocessor.prepare(cloud);
            usable += scan.counts.usable;
            hidden += scan.counts.hidden;
            outside += scan.counts.outside;
            let of_scan = Neighbours::of(scan);
            seen.add(&of_scan);
            empty += scan.image.ranges.len() - of_scan.filled;
        }
        let share = |part: usize, whole: usize| part as f32 / whole.max(1) as f32;
        Self {
            shown: share(usable - hidden, usable + outside),
            outside: share(outside, usable + outside),
            filled: share(seen.filled, seen.filled + empty),
            gaps: share(seen.gaps, empty),
            alone: share(seen.alone, seen.filled),
        }
    }
}

/// Numbers of pixels by what they and their neighbours to the left and right show.
#[derive(Clone, Copy, Debug, Default)]
struct Neighbours {
    /// With a return.
    filled: usize,
    /// With a return between two without.
    alone: usize,
    /// Without a return between two with one.
    gaps: usize,
}

impl Neighbours {
    fn of(scan: &PreparedScan) -> Self {
        let columns = scan.image.columns;
        let mut counts = Self::default();
        for row in scan.image.ranges.chunks_exact(columns) {
            for c in 0..columns {
                let [left, here, right] = [c + columns - 1, c, c + 1].map(|c| row[c % columns] > 0.0);
                counts.filled += usize::from(here);
                counts.alone += usize::from(here && !left && !right);
                counts.gaps += usize::from(!here && left && right);
            }
        }
        counts
    }

    fn add(&mut self, other: &Self) {
        self.filled += other.filled;
        self.alone += other.alone;
        self.gaps += other.gaps;
    }
}

fn describe(model: &BeamModel, layout: &CloudLayout, fit: &Fit) -> String {
    let elevations = model.elevations();
    let (top, bottom) = (elevations[0].to_degrees(), elevations[elevations.len() - 1].to_degrees());
    let origin = if model.origin_radius() + model.origin_height().abs() > 0.0 {
        format!(", beams from {:.0} mm off the axis and {:.0} mm up", 1e3 * model.origin_radius(), 1e3 * model.origin_height())
    } else {
        String::new()
    };
    format!(
        "{} rows from {top:+.1} to {bottom:+.1} degrees x {} columns{origin}; {layout}; {:.0} % of the returns have a pixel of their own",
        model.rows(),
        model.columns(),
        100.0 * fit.shown,
    )
}
