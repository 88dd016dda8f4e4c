//! `voxelastic render`: draws a picture of a map or a mesh.

use crate::args::LoadArgs;
use crate::failure::Failure;
use crate::meshing::{Colour, LayerArgs, SurfaceArgs, colours, default_colour, height_range, map_mesh};
use crate::{failure, output};
use anyhow::Context;
use clap::{Args, Parser, ValueEnum};
use serde::Serialize;
use std::path::{Path, PathBuf};
use voxelastic::Pose;
use voxelastic::surface::{Mesh, MeshOptions};
use voxelastic_eval::colour::Ramp;
use voxelastic_eval::render::{Camera, Colouring, Faces, Legend, MeshItem, Polyline, Scene, Size, Style, render as render_picture, render_png};
use voxelastic_eval::{MeshView, Picture};
use voxelastic_io::Origin;
use voxelastic_run::map_files;
use voxelastic_run::surfaces::MapMesh;

/// Draw a picture of a map or a mesh
///
/// Needs no graphics card and no window, and draws the same pixels on every machine.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic render hall.vox -o hall.png                               from above, without ceilings
  voxelastic render hall.vox -o hall.png --view orbit --yaw 30         from the side
  voxelastic render hall.vox -o in.png --eye 1,2,1.7 --target 9,2,1    from a point in the map
  voxelastic render street.ply -o street.png --size 3840x2160 --dark
  voxelastic render hall.vox -o submaps.png --colour submap")]
pub struct RenderArgs {
    /// A map, or a mesh in a PLY file
    #[arg(value_name = "MAP.vox|MESH.ply")]
    input: PathBuf,
    #[command(flatten)]
    load: LoadArgs,
    /// The picture to write
    #[arg(short, long, value_name = "FILE.png")]
    output: PathBuf,
    /// The view
    #[arg(long, value_enum, default_value_t = View::Top)]
    view: View,
    /// Direction of the view, counter-clockwise about the vertical, degrees; 0 looks along map y
    #[arg(long, value_name = "DEG", default_value_t = 30.0, allow_negative_numbers = true)]
    yaw: f64,
    /// Elevation of the camera for --view orbit and perspective, degrees
    #[arg(long, value_name = "DEG", default_value_t = 35.0, allow_negative_numbers = true)]
    pitch: f64,
    /// Position of the camera in the map frame, metres
    #[arg(long, value_name = "X,Y,Z", value_parser = point, requires = "target", allow_negative_numbers = true, conflicts_with = "view")]
    eye: Option<[f64; 3]>,
    /// Point in the centre of the picture, map frame, metres
    #[arg(long, value_name = "X,Y,Z", value_parser = point, requires = "eye", allow_negative_numbers = true)]
    target: Option<[f64; 3]>,
    /// Vertical field of view of perspective views, degrees
    #[arg(long, value_name = "DEG", default_value_t = 45.0, value_parser = angle)]
    fov: f64,
    /// Size of the picture, pixels
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "1600x1200", value_parser = size)]
    size: Size,
    /// Colouring of the surface [default: the colours of the scans or of the mesh file if there are any, else height]
    #[arg(long, value_enum)]
    colour: Option<Colour>,
    /// Remove everything above this height in the map frame, metres
    #[arg(long, value_name = "Z", allow_negative_numbers = true)]
    cut_above: Option<f64>,
    /// Draw the back sides of surfaces, too (from above, ceilings then hide rooms)
    #[arg(long)]
    both_sides: bool,
    /// Draw the path of the sensor
    #[arg(long)]
    path: bool,
    /// Use a dark background
    #[arg(long)]
    dark: bool,
    /// A line of text at the top left
    #[arg(long, value_name = "TEXT", default_value = "")]
    title: String,
    /// Print one JSON object on stdout: file, width, height, triangles
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    layers: LayerArgs,
    #[command(flatten)]
    surface: SurfaceArgs,
}

/// Views that fit the whole map into the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum View {
    /// From above, map y up, to scale
    Top,
    /// From the side and above, parallel projection
    Orbit,
    /// From the side and above, perspective projection
    Perspective,
}

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    #[serde(serialize_with = "crate::output::path")]
    file: &'a Path,
    /// Submaps that were left out because they are damaged.
    submaps_damaged: usize,
    width: u32,
    height: u32,
    triangles: usize,
}

/// The mesh and the path to draw.
struct Subject {
    mesh: MapMesh,
    path: Vec<[f64; 3]>,
    /// Where coordinates are counted from.
    origin: Origin,
    /// Submaps that were left out because they are damaged.
    damaged: usize,
}

/// `render` alone, to have its arguments with their defaults.
#[derive(Debug, Parser)]
struct Alone {
    #[command(flatten)]
    args: RenderArgs,
}

/// Draws a map from the side, as `voxelastic render MAP.vox -o FILE.png --view orbit` does.
pub fn draw_from_the_side(map: &Path, picture: &Path) -> anyhow::Result<()> {
    let words = ["render".as_ref(), map.as_os_str(), "-o".as_ref(), picture.as_os_str(), "--view".as_ref(), "orbit".as_ref()];
    draw(&Alone::try_parse_from(words)?.args).map(drop)
}

/// Height above the lowest part of a map at which [`draw_beside`] cuts it, metres: above doors, below roofs.
const CUT_M: f64 = 4.0;

/// Draws two maps from above, cut above the ground so that walls are lines, side by side in the same view, each under its title.
pub fn draw_beside(maps: [(&Path, &str); 2], picture: &Path) -> anyhow::Result<()> {
    let mesh = |map: &Path| Ok::<_, Failure>(map_files::load_surfaces(map, LoadArgs::default().into())?.atlas.mesh(&MeshOptions::default()));
    let meshes = [mesh(maps[0].0)?, mesh(maps[1].0)?];
    let heights = height_range(&meshes[1].positions);
    let scenes = [cut_scene(&meshes[0], heights, maps[0].1)?, cut_scene(&meshes[1], heights, maps[1].1)?];
    let camera = Camera::top(&scenes[1].bounds());
    let half = Size { width: 1000, height: 1000 };
    let [left, right] = [render_picture(&scenes[0], &camera, half)?, render_picture(&scenes[1], &camera, half)?];
    let rows = left.pixels.chunks(half.width as usize).zip(right.pixels.chunks(half.width as usize));
    let pixels = rows.flat_map(|(left, right)| [left, right]).flatten().copied().collect();
    let both = Picture { size: Size { width: 2 * half.width, height: half.height }, pixels };
    both.write_png(picture).with_context(|| format!("cannot draw {}", picture.display()))
}

/// A mesh without what is higher than [`CUT_M`], coloured by heights in a range.
fn cut_scene<'a>(mesh: &'a Mesh, (low, high): (f32, f32), title: &str) -> anyhow::Result<Scene<'a>> {
    let view = MeshView::new(&mesh.positions, &mesh.triangles)?.with_normals(&mesh.normals)?;
    let colouring = Colouring::Height { ramp: Ramp::Land, low, high };
    let style = Style { cut_above: Some(f64::from(low) + CUT_M), title: title.to_owned(), ..Style::default() };
    Ok(Scene { meshes: vec![MeshItem { mesh: view, t_map_mesh: Pose::identity(), colouring }], style, ..Scene::default() })
}

/// Runs the command.
pub fn run(args: &RenderArgs) -> anyhow::Result<u8> {
    let pool = args.surface.pool()?;
    pool.install(|| draw(args))
}

fn draw(args: &RenderArgs) -> anyhow::Result<u8> {
    let subject = load(args)?;
    let mesh = &subject.mesh.mesh;
    let by = args.colour.unwrap_or_else(|| default_colour(&subject.mesh));
    let colours = if by == Colour::Height { None } else { colours(&subject.mesh, by)? };
    let (low, high) = height_range(&mesh.positions);
    let colouring = match &colours {
        Some(colours) => Colouring::Vertex(colours),
        None if by == Colour::Height => Colouring::Height { ramp: Ramp::Land, low, high },
        None => Colouring::Flat([190, 192, 198]),
    };
    let legend = matches!(colouring, Colouring::Height { .. }).then(|| Legend { ramp: Ramp::Land, low, high, label: "height [m]".to_owned() });
    let mut style = if args.dark { Style::dark() } else { Style::default() };
    style.faces = if args.both_sides { Faces::Both } else { Faces::Front };
    (style.cut_above, style.legend, style.title) = (args.cut_above, legend, args.title.clone());
    let view = MeshView::new(&mesh.positions, &mesh.triangles)?.with_normals(&mesh.normals)?;
    let line = Polyline { points: subject.path, colour: [214, 60, 48], width: 2.5, on_top: true };
    let polylines = if args.path { vec![line] } else { Vec::new() };
    let scene = Scene { meshes: vec![MeshItem { mesh: view, t_map_mesh: Pose::identity(), colouring }], polylines, style, ..Scene::default() };
    let camera = camera(args, &scene, subject.origin);
    render_png(&args.output, &scene, &camera, args.size).with_context(|| format!("cannot draw {}", args.output.display()))?;
    tracing::info!("{} triangles drawn in {}", mesh.triangles.len(), args.output.display());
    if args.json {
        let Size { width, height } = args.size;
        output::print_json(&Summary { file: &args.output, submaps_damaged: subject.damaged, width, height, triangles: mesh.triangles.len() })?;
    }
    Ok(failure::DONE)
}

fn load(args: &RenderArgs) -> anyhow::Result<Subject> {
    if args.input.is_dir() || map_files::is_map(&args.input) {
        let map = args.surface.load(&args.input, args.load)?;
        let place = |s: &voxelastic::atlas::Submap, t: &Pose| (s.t_map_submap() * t).translation.vector.into();
        let mut path: Vec<(u64, [f64; 3])> =
            map.atlas.submaps().iter().flat_map(|s| s.scans().iter().map(move |scan| (scan.node, place(s, &scan.t_submap_lidar)))).collect();
        path.sort_unstable_by_key(|(node, _)| *node);
        // A fused surface has no submaps to be coloured by.
        let layers = LayerArgs { unfused: args.layers.unfused || args.colour == Some(Colour::Submap) };
        let mesh = map_mesh(&map.atlas, &args.surface, layers)?;
        return Ok(Subject { mesh, path: path.into_iter().map(|(_, p)| p).collect(), origin: map.origin, damaged: map.damaged });
    }
    let read = voxelastic_io::ply::read_mesh(&args.input)?;
    if read.triangles.is_empty() {
        let remedy = "use a mesh or a map; `voxelastic info` describes a file";
        return Err(Failure::new(format!("{}: the file has no triangles", args.input.display()), remedy).into());
    }
    let view = MeshView::new(&read.positions, &read.triangles)?;
    let normals = read.normals.unwrap_or_else(|| voxelastic_eval::vertex_normals(&view));
    let colours = read.colours.unwrap_or_default();
    let mesh = Mesh { positions: read.positions, normals, colours, triangles: read.triangles, ..Mesh::default() };
    if matches!(args.colour, Some(Colour::Submap | Colour::Scale | Colour::Intensity)) {
        return Err(Failure::usage("only maps can be coloured by submap, scale or intensity", "use --colour height, or a map").into());
    }
    Ok(Subject { mesh: MapMesh { mesh, ..MapMesh::default() }, path: Vec::new(), origin: Origin::default(), damaged: 0 })
}

fn camera(args: &RenderArgs, scene: &Scene<'_>, origin: Origin) -> Camera {
    let bounds = scene.bounds();
    let aspect = f64::from(args.size.width) / f64::from(args.size.height);
    match (args.eye, args.target) {
        (Some(eye), Some(target)) => Camera::look_at(origin.point_to_local(eye), origin.point_to_local(target), args.fov),
        _ => match args.view {
            View::Top => Camera::top(&bounds),
            View::Orbit => Camera::orbit(&bounds, args.yaw, args.pitch),
            View::Perspective => Camera::perspective_orbit(&bounds, args.yaw, args.pitch, args.fov, aspect),
        },
    }
}

fn size(text: &str) -> Result<Size, String> {
    let parsed = text.split_once(['x', 'X']).and_then(|(w, h)| Some(Size { width: w.trim().parse().ok()?, height: h.trim().parse().ok()? }));
    parsed
        .filter(|s| (16..=16384).contains(&s.width) && (16..=16384).contains(&s.height))
        .ok_or_else(|| "must be like 1600x1200, each side 16 to 16384".to_owned())
}

/// Parses three coordinates.
pub fn point(text: &str) -> Result<[f64; 3], String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
    numbers.and_then(|n| n.try_into().ok()).ok_or_else(|| "must be three numbers like 1.5,-2,0.7".to_owned())
}

fn angle(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|a| (1.0..=150.0).contains(a)).ok_or_else(|| "must be 1 to 150 degrees".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_points_are_parsed_or_rejected() {
        assert_eq!(size("640x480"), Ok(Size { width: 640, height: 480 }));
        assert!(["640", "0x10", "axb", "99999x10"].iter().all(|t| size(t).is_err()));
        assert_eq!(point("1, -2,3.5"), Ok([1.0, -2.0, 3.5]));
        assert!(["1,2", "1,2,3,4", "1,2,x", "1,2,inf"].iter().all(|t| point(t).is_err()));
    }
}
