//! Sensors known by name.
//!
//! Angles are the nominal ones of the makers' data sheets and user manuals; units differ by up to a few tenths of a
//! degree, so that a recognised model ([`crate::sensor::detect`]) is better wherever the clouds allow it.

use super::beam_model::{BeamModel, BeamTables};
use super::error::SensorError;

/// How a sensor's rows are spread over its field of view.
enum Rows {
    /// `count` rows, equal angles from `top` to `bottom`, degrees.
    Even { count: usize, top: f32, bottom: f32 },
    /// `count` rows, equal steps of the tangent from `+half` to `-half` degrees: a flat row of detectors behind a lens.
    Lens { count: usize, half: f32 },
    /// Several even blocks, top to bottom.
    Blocks(&'static [(usize, f32, f32)]),
}

/// One sensor.
struct Preset {
    name: &'static str,
    rows: Rows,
    columns: usize,
    /// Azimuth offsets, degrees counter-clockwise, repeated down the rows.
    stagger: &'static [f32],
    clockwise: bool,
    /// Beam origin from the axis, millimetres.
    origin_mm: f32,
}

// Ouster: four columns of detectors side by side make the stagger; the lidar-origin-to-beam-origin distance is in the
// sensor's metadata. Signs are counter-clockwise here, the metadata's are clockwise.
const OS0: [f32; 4] = [-8.7, -2.95, 2.85, 8.65];
const OS1_GEN1: [f32; 4] = [-3.164, -1.055, 1.055, 3.164];
const OS1: [f32; 4] = [-4.22, -1.41, 1.41, 4.22];
const OS2: [f32; 4] = [-2.11, -0.70, 0.70, 2.11];
/// HDL-64E S2: two stacked heads, thirds of a degree above, halves below.
const HDL64: [(usize, f32, f32); 2] = [(32, 2.0, -8.333), (32, -8.833, -24.333)];
/// Pandar64: dense around the horizon.
const PANDAR64: [(usize, f32, f32); 9] = [
    (1, 14.882, 14.882),
    (1, 11.032, 11.032),
    (1, 8.059, 8.059),
    (1, 5.057, 5.057),
    (1, 3.04, 3.04),
    (49, 2.028, -5.972),
    (8, -7.0, -14.0),
    (1, -19.0, -19.0),
    (1, -25.0, -25.0),
];

const fn ouster(name: &'static str, rows: Rows, stagger: &'static [f32], origin_mm: f32) -> Preset {
    Preset { name, rows, columns: 1024, stagger, clockwise: true, origin_mm }
}

const fn plain(name: &'static str, rows: Rows, columns: usize, clockwise: bool) -> Preset {
    Preset { name, rows, columns, stagger: &[], clockwise, origin_mm: 0.0 }
}

static PRESETS: [Preset; 17] = [
    ouster("os0-32", Rows::Even { count: 32, top: 45.0, bottom: -45.0 }, &OS0, 27.67),
    ouster("os0-64", Rows::Even { count: 64, top: 45.0, bottom: -45.0 }, &OS0, 27.67),
    ouster("os0-128", Rows::Even { count: 128, top: 45.0, bottom: -45.0 }, &OS0, 27.67),
    ouster("os1-32", Rows::Lens { count: 32, half: 21.2 }, &OS1, 15.806),
    // The 64-row sensor of the paper and of the Newer College data is the first generation.
    ouster("os1-64", Rows::Even { count: 64, top: 16.611, bottom: -16.611 }, &OS1_GEN1, 12.163),
    ouster("os1-64-gen2", Rows::Lens { count: 64, half: 21.2 }, &OS1, 15.806),
    ouster("os1-128", Rows::Lens { count: 128, half: 21.2 }, &OS1, 15.806),
    ouster("os2-32", Rows::Lens { count: 32, half: 11.25 }, &OS2, 13.762),
    ouster("os2-64", Rows::Lens { count: 64, half: 11.25 }, &OS2, 13.762),
    ouster("os2-128", Rows::Lens { count: 128, half: 11.25 }, &OS2, 13.762),
    plain("vlp-16", Rows::Even { count: 16, top: 15.0, bottom: -15.0 }, 1800, true),
    plain("hdl-32e", Rows::Even { count: 32, top: 10.667, bottom: -30.667 }, 2170, true),
    plain("hdl-64e", Rows::Blocks(&HDL64), 2083, false),
    plain("pandar-64", Rows::Blocks(&PANDAR64), 1800, true),
    plain("pandarxt-16", Rows::Even { count: 16, top: 15.0, bottom: -15.0 }, 2000, true),
    plain("pandarxt-32", Rows::Even { count: 32, top: 15.0, bottom: -16.0 }, 2000, true),
    plain("pandarqt-64", Rows::Even { count: 64, top: 52.1, bottom: -52.1 }, 600, true),
];

/// Names of all presets.
pub fn names() -> impl Iterator<Item = &'static str> {
    PRESETS.iter().map(|p| p.name)
}

/// The sensor called `name` (`os1-64`, `vlp-16`, ..), in its usual number of columns.
///
/// # Errors
/// [`SensorError::UnknownPreset`], with the names that exist.
pub fn preset(name: &str) -> Result<BeamModel, SensorError> {
    find(name).and_then(|p| build(p, p.columns))
}

/// As [`preset`], with `columns` to a turn (Ouster: 512, 1024 or 2048; others by their rate of rotation).
///
/// # Errors
/// [`SensorError::UnknownPreset`], or [`SensorError::Size`] for an impossible number of columns.
pub fn preset_with_columns(name: &str, columns: usize) -> Result<BeamModel, SensorError> {
    find(name).and_then(|p| build(p, columns))
}

fn find(name: &str) -> Result<&'static Preset, SensorError> {
    let wanted = name.to_ascii_lowercase().replace('_', "-");
    let known = || names().collect::<Vec<_>>().join(", ");
    PRESETS.iter().find(|p| p.name == wanted).ok_or_else(|| SensorError::UnknownPreset { name: name.into(), known: known() })
}

fn build(preset: &Preset, columns: usize) -> Result<BeamModel, SensorError> {
    let elevations = elevations(&preset.rows);
    let azimuth_offsets = match preset.stagger {
        [] => Vec::new(),
        stagger => (0..elevations.len()).map(|row| stagger[row % stagger.len()].to_radians()).collect(),
    };
    BeamModel::from_tables(BeamTables {
        name: preset.name.into(),
        elevations,
        azimuth_offsets,
        columns,
        clockwise: preset.clockwise,
        azimuth_of_first: 0.0,
        origin_radius: preset.origin_mm * 1e-3,
        origin_height: 0.0,
    })
}

fn even(count: usize, top: f32, bottom: f32) -> impl Iterator<Item = f32> {
    (0..count).map(move |row| top + (bottom - top) * row as f32 / (count.max(2) - 1) as f32)
}

fn elevations(rows: &Rows) -> Vec<f32> {
    match *rows {
        Rows::Even { count, top, bottom } => even(count, top, bottom).map(f32::to_radians).collect(),
        Rows::Lens { count, half } => {
            let edge = half.to_radians().tan();
            even(count, edge, -edge).map(f32::atan).collect()
        }
        Rows::Blocks(blocks) => blocks.iter().flat_map(|&(count, top, bottom)| even(count, top, bottom)).map(f32::to_radians).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_has_the_rows_of_its_name() -> Result<(), SensorError> {
        for name in names() {
            let model = preset(name)?;
            let rows: usize = name.split('-').nth(1).and_then(|n| n.trim_end_matches('e').parse().ok()).unwrap_or(0);
            assert_eq!(model.rows(), rows, "{name}");
            assert!(model.elevations().windows(2).all(|w| w[0] > w[1]), "{name}");
        }
        Ok(())
    }

    #[test]
    fn the_papers_sensor_has_its_cone() -> Result<(), SensorError> {
        assert!((preset("os1-64")?.smallest_angle().to_degrees() - 0.3516).abs() < 1e-3);
        assert_eq!(preset_with_columns("OS1_64", 2048)?.columns(), 2048);
        assert!(preset("os9-64").is_err_and(|e| e.to_string().contains("os1-64")));
        Ok(())
    }
}
