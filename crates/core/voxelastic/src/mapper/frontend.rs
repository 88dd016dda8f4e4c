//! The way from a cloud to a prepared scan: the sensor, the returns, their intensities on a common scale, and their colours.

use crate::Cloud;
use crate::geometry::{Pose, Rigid};
use crate::integrate::{ReturnsView, SubmapScan};
use crate::sensor::{
    BeamModel, CloudLayout, LazyScan, PreparedScan, RangeImage, RangeLimits, Returns, ScanPreprocessor, SensorError, detect, layout_for, preset,
};
use crate::settings::{Dynamic, Settings};
use std::borrow::Cow;

/// Distance between points that are added between scattered returns, voxels: with nearer ones maps are not better, and take longer
/// (docs/experiments/scans/scattered-clouds.md).
const BETWEEN: f32 = 2.0;

/// Prepares the scans of one sensor.
#[derive(Debug)]
pub struct Frontend {
    preprocessor: ScanPreprocessor,
    has_tsdf: bool,
    description: String,
    intensity_scale: Option<f32>,
    intensities: Vec<u8>,
    colours: Vec<[u8; 3]>,
}

impl Frontend {
    /// A frontend for the sensor that the settings name, else for the `known` one if the first cloud has its pixels, else for the one recognised from this cloud.
    ///
    /// # Errors
    /// An unknown name, or a cloud from which no sensor can be recognised.
    pub fn open(settings: &Settings, known: Option<&BeamModel>, first: &Cloud) -> Result<Self, SensorError> {
        let limits = RangeLimits { near: settings.min_range, max: settings.max_range };
        let known = known.filter(|model| first.is_organised() && (first.height, first.width) == (model.rows(), model.columns()));
        let (model, layout, description) = if settings.sensor != "auto" {
            let model = preset(&settings.sensor)?;
            let layout = layout_for(&model, first);
            let description = format!("{}: {} rows x {} columns, as named in the settings; {layout}", model.name(), model.rows(), model.columns());
            (model, layout, description)
        } else if let Some(model) = known {
            let description = format!("{}: {} rows x {} columns, by the sensor's own tables", model.name(), model.rows(), model.columns());
            (model.clone(), CloudLayout::grid_of(model), description)
        } else {
            let found = detect(&[first])?;
            (found.model, found.layout, found.description)
        };
        let intensity_scale = first.intensity.as_deref().and_then(scale_of);
        let (mut preprocessor, has_tsdf) = (ScanPreprocessor::new(model, layout, limits), settings.field.has_tsdf());
        preprocessor.fill_between(BETWEEN * settings.voxel_size);
        Ok(Self { preprocessor, has_tsdf, description, intensity_scale, intensities: Vec::new(), colours: Vec::new() })
    }

    /// Prepares `cloud`, all but its planes, which are fitted when they are needed.
    pub fn prepare<'a>(&'a mut self, cloud: &'a Cloud) -> FrontendScan<'a> {
        let fills_gaps = !matches!(self.preprocessor.layout(), CloudLayout::Grid(_));
        let Self { preprocessor, has_tsdf, intensity_scale, intensities, colours, .. } = self;
        let scan = preprocessor.prepare_lazily(cloud);
        let source = &scan.scan().returns.source;
        colours.clear();
        // A colour field that was never filled is all black.
        if let Some(all) = cloud.colours.as_ref().filter(|colours| colours.iter().any(|c| *c != [0; 3])) {
            colours.extend(source.iter().map(|&i| all[i as usize]));
        }
        intensities.clear();
        let intensity = intensity_scale.zip(cloud.intensity.as_deref());
        let mut prepared = FrontendScan { scan, has_tsdf: *has_tsdf, fills_gaps, intensity, intensities, colours };
        prepared.add_intensities();
        prepared
    }

    /// A description of the sensor in words.
    pub fn description(&self) -> &str {
        &self.description
    }

    /// The sensor.
    pub fn model(&self) -> &BeamModel {
        self.preprocessor.model()
    }

    /// How its clouds are laid out.
    pub fn layout(&self) -> &CloudLayout {
        self.preprocessor.layout()
    }
}

/// A scan that a [`Frontend`] has prepared.
#[derive(Debug)]
pub struct FrontendScan<'a> {
    scan: LazyScan<'a>,
    has_tsdf: bool,
    fills_gaps: bool,
    /// Intensities of the cloud, and the factor that brings them to the common scale.
    intensity: Option<(f32, &'a [f32])>,
    intensities: &'a mut Vec<u8>,
    colours: &'a [[u8; 3]],
}

impl FrontendScan<'_> {
    /// The prepared scan; its normals are empty until planes are fitted.
    pub fn scan(&self) -> &PreparedScan {
        self.scan.scan()
    }

    /// Fits the planes, unless that has been done, and returns the scan with them.
    pub fn fit_planes(&mut self) -> &PreparedScan {
        self.scan.fit_planes();
        // Points may have been added.
        self.add_intensities();
        self.scan.scan()
    }

    /// Adds the intensities of returns that have none yet.
    fn add_intensities(&mut self) {
        if let Some((scale, intensity)) = self.intensity {
            let source = self.scan.scan().returns.source.iter().skip(self.intensities.len());
            self.intensities.extend(source.map(|&i| (intensity[i as usize] * scale).clamp(1.0, 255.0) as u8));
        }
    }

    /// Fits the planes if the map has a TSDF, or what moves is to be found; occupancy does not use them.
    pub(super) fn fit_planes_for_map(&mut self, settings: &Settings) {
        if self.has_tsdf || settings.dynamic == Dynamic::Remove {
            self.fit_planes();
        }
    }

    /// Intensity of each return, 1 to 255; empty when the scan has none.
    pub fn intensities(&self) -> &[u8] {
        &self.intensities[..]
    }

    /// Colour of each measured return, sRGB; empty when the scan has none.
    pub fn colours(&self) -> &[[u8; 3]] {
        self.colours
    }

    /// The sensor.
    pub fn model(&self) -> &BeamModel {
        self.scan.model()
    }

    /// Whether single empty pixels of the range image are artefacts of projection and not rays without return.
    pub fn fills_gaps(&self) -> bool {
        self.fills_gaps
    }
}

/// A prepared scan without the returns that were set aside.
pub(super) struct KeptScan<'a> {
    model: &'a BeamModel,
    image: (&'a RangeImage, bool),
    smallest_angle: f32,
    points: Cow<'a, [[f32; 3]]>,
    normals: Cow<'a, [[f32; 3]]>,
    intensities: Cow<'a, [u8]>,
    spacing: Cow<'a, [f32]>,
    origins: Cow<'a, [[f32; 3]]>,
    colours: Cow<'a, [[u8; 3]]>,
    measured: usize,
}

impl FrontendScan<'_> {
    /// The scan without the returns of which `drops` is true; all of it if that is empty.
    pub(super) fn without<'a>(&'a self, drops: &[bool]) -> KeptScan<'a> {
        let Returns { points, normals, spacing, origins, measured, smallest_angle, .. } = &self.scan().returns;
        KeptScan {
            model: self.model(),
            image: self.scan().view_from_one_pose(self.fills_gaps),
            smallest_angle: *smallest_angle,
            points: kept(points, drops),
            normals: kept(normals, drops),
            intensities: kept(&self.intensities[..], drops),
            spacing: kept(spacing, drops),
            origins: kept(origins, drops),
            colours: kept(self.colours, drops),
            measured: measured - drops.iter().take(*measured).filter(|drops| **drops).count(),
        }
    }
}

impl KeptScan<'_> {
    /// The sensor.
    pub(super) fn model(&self) -> &BeamModel {
        self.model
    }

    /// The scan at its pose in a submap; its range image has what was set aside, too.
    pub(super) fn in_submap(&self, t_submap_lidar: &Pose) -> SubmapScan<'_> {
        let returns = ReturnsView {
            points: &self.points,
            normals: &self.normals,
            intensities: &self.intensities,
            spacing: &self.spacing,
            measured: self.measured,
            origins: &self.origins,
            smallest_angle: self.smallest_angle,
        };
        let (image, fills_gaps) = self.image;
        SubmapScan { t_submap_lidar: Rigid::from(t_submap_lidar), returns, colours: &self.colours, image, fills_gaps }
    }
}

/// The entries of `all` that are not dropped. As a rule these are nearly all, so they are copied in runs.
fn kept<'a, T: Copy>(all: &'a [T], drops: &[bool]) -> Cow<'a, [T]> {
    if drops.is_empty() {
        return Cow::Borrowed(all);
    }
    let (mut kept, mut rest) = (Vec::with_capacity(all.len()), all);
    for run in drops.split_inclusive(|drops| *drops) {
        let (now, after) = rest.split_at(run.len().min(rest.len()));
        let ends_dropped = now.len() == run.len() && run.last().is_some_and(|drops| *drops);
        kept.extend_from_slice(&now[..now.len() - usize::from(ends_dropped)]);
        rest = after;
    }
    Cow::Owned(kept)
}

/// Factor that brings all but the brightest fiftieth of the returns below 255; none when all are dark.
fn scale_of(intensity: &[f32]) -> Option<f32> {
    let mut positive: Vec<f32> = intensity.iter().copied().filter(|i| i.is_finite() && *i > 0.0).collect();
    if positive.is_empty() {
        return None;
    }
    let place = (positive.len() - 1) * 49 / 50;
    let (_, bright, _) = positive.select_nth_unstable_by(place, f32::total_cmp);
    Some(255.0 / *bright)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_not_dropped_is_kept_in_order(all in prop::collection::vec(any::<u16>(), 0..60), drops in prop::collection::vec(any::<bool>(), 1..60)) {
            let slow: Vec<u16> = all.iter().zip(&drops).filter(|(_, drops)| !**drops).map(|(value, _)| *value).collect();
            prop_assert_eq!(&*kept(&all, &drops), &slow[..]);
        }
    }
}
