//! Files of distances: arrays, which are written layer by layer, clouds and pictures.

use super::grid::Grid;
use anyhow::Context;
use std::io::{self, Write};
use std::path::Path;
use voxelastic::field::occupancy::State;
use voxelastic::query::AtlasQuery;
use voxelastic_esdf::EsdfSample;
use voxelastic_eval::colour::{Ramp, Rgb};
use voxelastic_eval::grid_view::GridView;

const OCCUPIED: Rgb = [20, 20, 24];
const UNKNOWN: Rgb = [176, 180, 186];

/// Writes an array of distances (z, y, x) in NumPy's format; returns the number of points.
pub fn array(path: &Path, grid: &Grid, sample: impl Fn(&[[f64; 3]]) -> Vec<EsdfSample>) -> anyhow::Result<usize> {
    let [x, y, z] = grid.shape;
    voxelastic_files::write(path, |out| {
        // Magic, version, length of the description, the description; padded so that the numbers begin at a multiple of 64 bytes.
        let mut description = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({z}, {y}, {x}), }}");
        let padding = (64 - (10 + description.len() + 1) % 64) % 64;
        description.push_str(&" ".repeat(padding));
        description.push('\n');
        out.write_all(b"\x93NUMPY\x01\x00")?;
        out.write_all(&(description.len() as u16).to_le_bytes())?;
        out.write_all(description.as_bytes())?;
        for z in 0..z {
            let bytes: Vec<u8> = sample(&grid.layer(z)).iter().flat_map(|sample| sample.distance.to_le_bytes()).collect();
            out.write_all(&bytes)?;
        }
        Ok::<(), io::Error>(())
    })?;
    Ok(grid.points())
}

/// Writes the points that are free, or all where that is not known, and nearer to an obstacle than `max_distance` as a cloud; returns their number.
pub fn cloud(
    path: &Path,
    grid: &Grid,
    max_distance: f64,
    sample: impl Fn(&[[f64; 3]]) -> Vec<EsdfSample>,
    states: impl Fn(&[[f64; 3]]) -> Option<Vec<State>>,
) -> anyhow::Result<usize> {
    const RECORD: usize = 7 * 4 + 3;
    let (mut records, mut count) = (Vec::new(), 0usize);
    for z in 0..grid.shape[2] {
        let points = grid.layer(z);
        let states = states(&points);
        for (i, (p, sample)) in points.iter().zip(sample(&points)).enumerate() {
            let is_free = states.as_ref().is_none_or(|states| states[i] == State::Free);
            if is_free && f64::from(sample.distance) < max_distance {
                let [gx, gy, gz] = sample.gradient;
                [p[0] as f32, p[1] as f32, p[2] as f32, sample.distance, gx, gy, gz].iter().for_each(|v| records.extend_from_slice(&v.to_le_bytes()));
                records.extend_from_slice(&colour(sample.distance, max_distance));
                count += 1;
            }
        }
    }
    debug_assert_eq!(records.len(), count * RECORD);
    voxelastic_files::write(path, |out| {
        write!(
            out,
            "ply\nformat binary_little_endian 1.0\ncomment distances to the nearest obstacle and their gradients, metres\nelement vertex {count}\n"
        )?;
        for name in ["x", "y", "z", "distance", "gradient_x", "gradient_y", "gradient_z"] {
            writeln!(out, "property float {name}")?;
        }
        for name in ["red", "green", "blue"] {
            writeln!(out, "property uchar {name}")?;
        }
        writeln!(out, "end_header")?;
        out.write_all(&records)
    })?;
    Ok(count)
}

/// Draws the first layer; returns the number of its points.
pub fn picture(
    path: &Path,
    grid: &Grid,
    max_distance: f64,
    sample: impl Fn(&[[f64; 3]]) -> Vec<EsdfSample>,
    space: &AtlasQuery<'_>,
) -> anyhow::Result<usize> {
    let points = grid.layer(0);
    let states = if space.is_empty() { vec![State::Free; points.len()] } else { space.states(&points) };
    let cell = |(state, sample): (&State, EsdfSample)| match state {
        State::Occupied => OCCUPIED,
        State::Unknown => UNKNOWN,
        State::Free => colour(sample.distance, max_distance),
    };
    let cells: Vec<Rgb> = states.iter().zip(sample(&points)).map(cell).collect();
    let mark = |share: f64| (colour((share * max_distance) as f32, max_distance), format!("{:.2} m", share * max_distance));
    let legend = [(OCCUPIED, "occupied".to_owned()), (UNKNOWN, "unknown".to_owned())].into_iter().chain([0.0, 0.5, 1.0].map(mark)).collect();
    let view = GridView {
        title: format!("distance to the nearest obstacle at z = {:.2} m", grid.origin[2]),
        labels: ["x [m]", "y [m]"],
        origin: [0, 1].map(|k| grid.origin[k] - 0.5 * grid.spacing),
        pixel: grid.spacing,
        size: [grid.shape[0], grid.shape[1]],
        cells: &cells,
        legend,
        ..GridView::default()
    };
    view.write_png(path).with_context(|| format!("cannot draw {}", path.display()))?;
    Ok(points.len())
}

fn colour(distance: f32, max_distance: f64) -> Rgb {
    Ramp::Violet.at(distance / max_distance as f32)
}
