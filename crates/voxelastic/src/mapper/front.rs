//! The way from a cloud to beams: which sensor it is, the strengths of its returns on one scale, and their colours.

use crate::Cloud;
use crate::sensor::{BeamModel, Layout, Limits, PreparedScan, Preparer, SensorError, detect, layout_for, preset};
use crate::settings::Settings;

/// Prepares the scans of one sensor.
#[derive(Debug)]
pub struct Front {
    preparer: Preparer,
    wants_planes: bool,
    description: String,
    shade_scale: Option<f32>,
    shades: Vec<u8>,
    colours: Vec<[u8; 3]>,
}

impl Front {
    /// Takes the sensor that the settings name, else the `known` one if the first cloud has its pixels, else the one that this cloud shows.
    ///
    /// # Errors
    /// An unknown name, or a cloud from which no sensor can be made out.
    pub fn open(settings: &Settings, known: Option<&BeamModel>, first: &Cloud) -> Result<Self, SensorError> {
        let limits = Limits { near: settings.min_range, max: settings.max_range };
        let known = known.filter(|model| first.is_organised() && (first.height, first.width) == (model.rows(), model.columns()));
        let (model, layout, description) = if settings.sensor != "auto" {
            let model = preset(&settings.sensor)?;
            let layout = layout_for(&model, first);
            let description = format!("{}: {} rows x {} columns, as told; {layout}", model.name(), model.rows(), model.columns());
            (model, layout, description)
        } else if let Some(model) = known {
            let description = format!("{}: {} rows x {} columns, by the sensor's own tables", model.name(), model.rows(), model.columns());
            (model.clone(), Layout::grid_of(model), description)
        } else {
            let found = detect(&[first])?;
            (found.model, found.layout, found.description)
        };
        let shade_scale = first.intensity.as_deref().and_then(scale_of);
        let preparer = Preparer::new(model, layout, limits);
        Ok(Self { preparer, wants_planes: settings.field.has_tsdf(), description, shade_scale, shades: Vec::new(), colours: Vec::new() })
    }

    /// Prepares `cloud`, all but its planes; [`scan`](Self::scan), [`shades`](Self::shades) and [`colours`](Self::colours) then speak of it. Before
    /// it goes into a TSDF, [`finish`](Self::finish) it.
    pub fn prepare(&mut self, cloud: &Cloud) {
        let scan = self.preparer.prepare_without_planes(cloud);
        self.shades.clear();
        if let (Some(scale), Some(intensity)) = (self.shade_scale, &cloud.intensity) {
            self.shades.extend(scan.beams.source.iter().map(|&i| (intensity[i as usize] * scale).clamp(1.0, 255.0) as u8));
        }
        self.colours.clear();
        // A field for colours that nobody filled is all black.
        if let Some(colours) = cloud.colours.as_ref().filter(|colours| colours.iter().any(|c| *c != [0; 3])) {
            self.colours.extend(scan.beams.source.iter().map(|&i| colours[i as usize]));
        }
    }

    /// Fits the planes of `cloud`, which was prepared last, where the map is to have a TSDF: occupancy does without.
    pub fn finish(&mut self, cloud: &Cloud) {
        if self.wants_planes {
            self.fit_planes(cloud);
        }
    }

    /// Fits the planes of `cloud`, which was prepared last, if that has not been done.
    pub fn fit_planes(&mut self, cloud: &Cloud) {
        if self.scan().beams.normals.len() < self.scan().beams.len() {
            self.preparer.fit_planes(cloud);
        }
    }

    /// The scan prepared last.
    pub fn scan(&self) -> &PreparedScan {
        self.preparer.scan()
    }

    /// Strength of each beam's return, 1 to 255; empty when the scan has none.
    pub fn shades(&self) -> &[u8] {
        &self.shades
    }

    /// Colour of each beam's return, sRGB; empty when the scan has none.
    pub fn colours(&self) -> &[[u8; 3]] {
        &self.colours
    }

    /// The sensor.
    pub fn model(&self) -> &BeamModel {
        self.preparer.model()
    }

    /// What the sensor was taken for, in words.
    pub fn description(&self) -> &str {
        &self.description
    }

    /// Whether single empty pixels are accidents of projection and not beams without return.
    pub fn fills_gaps(&self) -> bool {
        !matches!(self.preparer.layout(), Layout::Grid(_))
    }
}

/// Factor that brings all but the brightest fiftieth of the returns below 255; none when all are dark.
fn scale_of(intensity: &[f32]) -> Option<f32> {
    let mut seen: Vec<f32> = intensity.iter().copied().filter(|i| i.is_finite() && *i > 0.0).collect();
    if seen.is_empty() {
        return None;
    }
    let place = (seen.len() - 1) * 49 / 50;
    let (_, bright, _) = seen.select_nth_unstable_by(place, f32::total_cmp);
    Some(255.0 / *bright)
}
