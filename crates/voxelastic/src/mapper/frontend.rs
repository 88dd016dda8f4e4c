//! The way from a cloud to a prepared scan: the sensor, the returns, their intensities on a common scale, and their colours.

use crate::Cloud;
use crate::sensor::{BeamModel, CloudLayout, LazyScan, PreparedScan, RangeLimits, ScanPreprocessor, SensorError, detect, layout_for, preset};
use crate::settings::Settings;

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
        let (preprocessor, has_tsdf) = (ScanPreprocessor::new(model, layout, limits), settings.field.has_tsdf());
        Ok(Self { preprocessor, has_tsdf, description, intensity_scale, intensities: Vec::new(), colours: Vec::new() })
    }

    /// Prepares `cloud`, all but its planes, which are fitted when they are needed.
    pub fn prepare<'a>(&'a mut self, cloud: &'a Cloud) -> FrontendScan<'a> {
        let fills_gaps = !matches!(self.preprocessor.layout(), CloudLayout::Grid(_));
        let Self { preprocessor, has_tsdf, intensity_scale, intensities, colours, .. } = self;
        let scan = preprocessor.prepare_lazily(cloud);
        let source = &scan.scan().returns.source;
        intensities.clear();
        if let (Some(scale), Some(intensity)) = (*intensity_scale, &cloud.intensity) {
            intensities.extend(source.iter().map(|&i| (intensity[i as usize] * scale).clamp(1.0, 255.0) as u8));
        }
        colours.clear();
        // A colour field that was never filled is all black.
        if let Some(all) = cloud.colours.as_ref().filter(|colours| colours.iter().any(|c| *c != [0; 3])) {
            colours.extend(source.iter().map(|&i| all[i as usize]));
        }
        FrontendScan { scan, has_tsdf: *has_tsdf, fills_gaps, intensities, colours }
    }

    /// A description of the sensor in words.
    pub fn description(&self) -> &str {
        &self.description
    }

    /// The sensor.
    pub fn model(&self) -> &BeamModel {
        self.preprocessor.model()
    }
}

/// A scan that a [`Frontend`] has prepared.
#[derive(Debug)]
pub struct FrontendScan<'a> {
    scan: LazyScan<'a>,
    has_tsdf: bool,
    fills_gaps: bool,
    intensities: &'a [u8],
    colours: &'a [[u8; 3]],
}

impl FrontendScan<'_> {
    /// The prepared scan; its normals are empty until planes are fitted.
    pub fn scan(&self) -> &PreparedScan {
        self.scan.scan()
    }

    /// Fits the planes, unless that has been done, and returns the scan with them.
    pub fn fit_planes(&mut self) -> &PreparedScan {
        self.scan.fit_planes()
    }

    /// Fits the planes if the map has a TSDF; occupancy does not use them.
    pub fn fit_planes_for_map(&mut self) {
        if self.has_tsdf {
            self.fit_planes();
        }
    }

    /// Intensity of each return, 1 to 255; empty when the scan has none.
    pub fn intensities(&self) -> &[u8] {
        self.intensities
    }

    /// Colour of each return, sRGB; empty when the scan has none.
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
