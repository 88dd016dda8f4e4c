//! `voxelastic eval`: measures accuracy, completeness, free space and poses of a map against a truth.

mod args;
mod measured;
pub mod path;
mod summary;
mod surface;
mod table;
pub mod truth;

pub use args::{EvalArgs, Field};
pub use summary::Summary;

use crate::failure::{self, Failure};
use crate::output;
use anyhow::Context;
use measured::Measured;
use nalgebra::Point3;
use std::path::Path;
use std::time::Instant;
use surface::Surface;
use truth::{TrueSurface, Truth};
use voxelastic::Pose;
use voxelastic::query::AtlasQuery;
use voxelastic_eval::MeshView;
use voxelastic_eval::align::{AlignSettings, align};
use voxelastic_eval::colour::error_colours;
use voxelastic_eval::layers::{LAYER_PLACES, LAYER_REACH, Layers, layers};
use voxelastic_eval::metrics::{CompareSettings, Comparison, compare};
use voxelastic_eval::occupancy::{self, OccupancyScores};
use voxelastic_ground::{Body, FloorScores, Ground, TrueWorld, compare_floor};
use voxelastic_io::mesh_io::{MeshRef, write_ply};
use voxelastic_run::map_files::LoadedMap;
use voxelastic_sim::{Simulation, World};

/// Runs the command.
pub fn run(args: &EvalArgs) -> anyhow::Result<u8> {
    let clock = Instant::now();
    let pool = args.surface.pool()?;
    let mut summary = pool.install(|| measure(args))?;
    summary.total_s = clock.elapsed().as_secs_f64();
    if args.json {
        output::print_json(&summary)?;
    } else {
        output::print(&table::table(&summary))?;
    }
    Ok(failure::DONE)
}

fn measure(args: &EvalArgs) -> anyhow::Result<Summary> {
    let measured = Measured::open(args)?;
    let truth = Truth::open(&args.truth, args.poses.as_deref(), &args.limits())?;
    against_truth(args, measured, &truth)
}

/// Measures the map of `args` against a truth that is open already.
pub fn measure_against(args: &EvalArgs, truth: &Truth) -> anyhow::Result<Summary> {
    against_truth(args, Measured::open(args)?, truth)
}

fn against_truth(args: &EvalArgs, mut measured: Measured, truth: &Truth) -> anyhow::Result<Summary> {
    let mut summary = Summary {
        map: args.map.clone(),
        submaps_damaged: measured.map().map_or(0, |map| map.damaged),
        truth: args.truth.clone(),
        truth_kind: truth.kind,
        measured: None,
        surface: None,
        layers: None,
        max_range_m: truth.simulation.as_ref().map(|_| args.max_range),
        occupancy: None,
        floor: None,
        trajectory: None,
        error_ply: None,
        total_s: 0.0,
        t_truth_map: Pose::identity(),
    };
    if let Some(map) = measured.map() {
        summary.trajectory = path::compare(&map.atlas, truth)?;
    }
    if let Some(surface) = &truth.surface {
        let points = measured.surface(args)?;
        let found = compare_surfaces(&points, surface, truth.simulation.is_some(), args)?;
        summary.t_truth_map = found.t_truth_map;
        summary.measured = Some(points.what);
        summary.layers = layers_of(&points)?;
        if let Some(path) = &args.error_ply {
            write_errors(path, &points, &found.errors, args.error_max)?;
            summary.error_ply = Some(path.clone());
        }
        summary.surface = Some(found);
    } else if args.error_ply.is_some() {
        let what = format!("{}: there is no surface to measure errors against, only poses", args.truth.display());
        return Err(Failure::usage(what, "leave out --error-ply, or use a cloud, a mesh or a simulated folder as --truth").into());
    }
    let with_occupancy = args.field != Some(Field::Tsdf);
    if let (Some(simulation), Some(map)) =
        (truth.simulation.as_ref().filter(|_| with_occupancy), measured.map().filter(|m| measured::has_occupancy(&m.atlas)))
    {
        summary.occupancy = Some(occupancy_scores(simulation, map, summary.t_truth_map, args.max_range));
        // Heights are compared along the world's vertical.
        if summary.t_truth_map == Pose::identity() {
            summary.floor = floor_scores(simulation.world(), map);
        }
    }
    Ok(summary)
}

/// Compares free and occupied space with the world along true beams.
fn occupancy_scores(simulation: &Simulation, map: &LoadedMap, t_truth_map: Pose, max_range: f32) -> OccupancyScores {
    let points = simulation.probes(f64::from(max_range.min(map.settings.max_range)), map.settings.voxel_size);
    tracing::info!("comparing free and occupied space at {} points", points.len());
    let (query, t_map_truth) = (AtlasQuery::new(&map.atlas), t_truth_map.inverse());
    let state = |p: [f32; 3]| query.state((t_map_truth * Point3::from(p.map(f64::from))).coords.into());
    occupancy::score(&points, state, |p| simulation.world().distance(p.map(f64::from)) as f32, map.settings.voxel_size)
}

/// Compares the floor of a map, whose frame is that of the world; none where no floor is found.
fn floor_scores(world: &World, map: &LoadedMap) -> Option<FloorScores> {
    let (voxel, body) = (f64::from(map.settings.voxel_size), Body::default());
    let ground = Ground::of(&map.atlas, voxel, &body).map_err(|why| tracing::warn!("the floor is not measured: {why}")).ok()?;
    let (distance, cast) = (|p| world.distance(p), |from, direction, length| world.cast(from, direction, length).map(|hit| hit.range));
    Some(compare_floor(TrueWorld { distance: &distance, cast: &cast }, &ground, body, voxel))
}

/// Surfaces of a mesh on top of each other.
fn layers_of(points: &Surface) -> anyhow::Result<Option<Layers>> {
    let mesh = MeshView::new(&points.positions, &points.triangles)?;
    Ok(layers(&mesh, LAYER_PLACES, LAYER_REACH))
}

/// Compares surfaces.
fn compare_surfaces(points: &Surface, truth: &TrueSurface, is_world: bool, args: &EvalArgs) -> anyhow::Result<Comparison> {
    let aligned = if is_world { args.align } else { !args.no_align };
    let context = || format!("cannot compare {} (the source, or map) with {} (the target, or truth)", args.map.display(), args.truth.display());
    if !aligned {
        // One step whose result is discarded, for the checks of units and overlap.
        let check = AlignSettings { voxels: vec![1.0], max_iterations: 1, ..AlignSettings::default() };
        align(&points.positions, &truth.points, &check).with_context(context)?;
    }
    let settings = CompareSettings {
        align: aligned.then(AlignSettings::default),
        truth_voxel: args.truth_voxel,
        max_points: args.max_points,
        thresholds: args.thresholds.clone(),
        ..CompareSettings::default()
    };
    tracing::info!("measuring {} {} against {} points of the truth", points.positions.len(), points.what, truth.points.len());
    compare(points.as_map()?, &truth.as_truth(), &settings).with_context(context)
}

fn write_errors(path: &Path, points: &Surface, errors: &[f32], worst: f32) -> anyhow::Result<()> {
    let colours = error_colours(errors, worst);
    let file = MeshRef { positions: &points.positions, colours: Some(&colours), triangles: &points.triangles, ..MeshRef::default() };
    write_ply(path, &file).with_context(|| format!("cannot write the coloured errors to {}", path.display()))?;
    tracing::info!("errors in colour, up to {worst} m: {}", path.display());
    Ok(())
}
