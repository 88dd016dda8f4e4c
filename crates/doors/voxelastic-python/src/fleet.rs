//! What a map that is made by many processes needs: recordings in pieces, places that recordings share, one graph, parts of the map on their own.

use crate::dataset::{Events, Scan};
use crate::map::Map;
use crate::{errors, job};
use pyo3::types::PyBytes;
use pyo3::{Bound, PyErr, PyResult, Python, pyclass, pyfunction, pymethods};
use std::collections::{BTreeMap, HashMap};
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};
use voxelastic::Pose;
use voxelastic::event::{Edge, Event, NodeId, Scan as CoreScan};
use voxelastic::geometry::PoseExt;
use voxelastic::meshing::SurfaceTiles;
use voxelastic::surface::MeshOptions;
use voxelastic_io::Origin;
use voxelastic_io::store::join_manifests as join_texts;
use voxelastic_io::tiles::{Cell, Part, TilesetWriter, leaves};
use voxelastic_run::poses::{Motions, OdometryStage, PoseStage, Poses};
use voxelastic_run::{Input, Warnings};
use voxelastic_slam::graph::{Options, Problem, optimise as solve};
use voxelastic_slam::loops::{Closure, LoopFinder, LoopSettings, PlaceBook, PlaceDescriptors, PlacePair, Verdict};

/// Numbers of a pose: x, y, z, qx, qy, qz, qw.
type Numbers = [f64; 7];

/// An edge: two nodes, the pose of the second in the frame of the first, and the upper triangle of its information, if it is known.
type EdgeRow = (NodeId, NodeId, Numbers, Option<Vec<f64>>);

/// Cuts a recording into pieces of some metres of path.
#[pyclass(frozen, module = "voxelastic._native")]
pub struct Splitter {
    state: Mutex<State>,
}

struct State {
    first_node: NodeId,
    metres: f64,
    /// What lengths are multiplied by, for recordings in other units.
    scale: f64,
    /// Gives scans their poses; from the first input on.
    poses: Option<PoseStage>,
    warnings: Warnings,
    finder: LoopFinder,
    numbers: HashMap<NodeId, NodeId>,
    /// The scan whose odometry edge may come.
    pending: Option<CoreScan>,
    last: Option<(NodeId, Pose)>,
    travelled: f64,
    piece: Vec<CoreScan>,
    done: Vec<Vec<CoreScan>>,
    nodes: Vec<(NodeId, f64, Pose)>,
    odometry: Vec<Edge>,
    loops: Vec<Edge>,
    corrected: HashMap<NodeId, Pose>,
    problems: Vec<String>,
    is_over: bool,
}

/// A piece: its scans as bytes, and how many there are.
type Piece<'py> = (Bound<'py, PyBytes>, usize);

/// Nodes with times and poses, odometry edges, loop edges, places, their descriptors, the size of their voxels, what was wrong with scans, and what poses count from.
type Track<'py> = (Vec<(NodeId, f64, Numbers)>, Vec<EdgeRow>, Vec<EdgeRow>, Bound<'py, PyBytes>, Bound<'py, PyBytes>, f64, Vec<String>, [f64; 3]);

#[pymethods]
impl Splitter {
    /// `first_node` is what nodes are numbered from; `place_voxel` the edge of voxels in which places are compared, metres, or none to choose it by the first scan.
    #[new]
    fn new(first_node: NodeId, metres: f64, scale: f64, place_voxel: Option<f64>) -> Self {
        let mut settings = LoopSettings::default();
        settings.voxel_size = place_voxel;
        Self {
            state: Mutex::new(State {
                first_node,
                metres,
                scale,
                poses: None,
                warnings: Warnings::default(),
                finder: LoopFinder::new(settings),
                numbers: HashMap::new(),
                pending: None,
                last: None,
                travelled: 0.0,
                piece: Vec::new(),
                done: Vec::new(),
                nodes: Vec::new(),
                odometry: Vec::new(),
                loops: Vec::new(),
                corrected: HashMap::new(),
                problems: Vec::new(),
                is_over: false,
            }),
        }
    }

    /// The next piece; none at the end.
    fn next<'py>(&self, py: Python<'py>, events: &Events) -> PyResult<Option<Piece<'py>>> {
        let (events, setup, pool) = (events.shared(), events.setup(), job::shared_pool()?);
        let threads = pool.current_num_threads();
        let piece = job::run_short(py, || {
            let mut events = events.lock().unwrap_or_else(PoisonError::into_inner);
            let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
            // Guards stay in this thread.
            let (events, state) = (&mut *events, &mut *state);
            if state.poses.is_none() {
                let stage = setup.map(|setup| OdometryStage::new((*setup).clone(), Motions::default(), threads)).transpose()?;
                let poses = stage.map_or(Poses::Given, |stage| Poses::Estimated(Box::new(stage)));
                state.poses = Some(PoseStage::new(poses, None));
            }
            pool.install(|| {
                while state.done.is_empty() && !state.is_over {
                    match events.next() {
                        Some(input) => state.take(input),
                        None => state.end(),
                    }
                }
            });
            Ok::<_, voxelastic_run::Error>((!state.done.is_empty()).then(|| state.done.remove(0)))
        })?;
        let piece = piece.map_err(|e| errors::run(py, &e))?;
        let packed = |scans: Vec<CoreScan>| -> PyResult<Piece<'py>> {
            let bytes = postcard::to_stdvec(&scans).map_err(|e| errors::bug(&e.to_string()))?;
            Ok((PyBytes::new(py, &bytes), scans.len()))
        };
        piece.map(packed).transpose()
    }

    /// What is known of the whole recording, after its last piece.
    fn track<'py>(&self, py: Python<'py>) -> PyResult<Track<'py>> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let finder = std::mem::replace(&mut state.finder, LoopFinder::new(LoopSettings::default()));
        let book = PlaceBook::of(finder);
        let voxel = book.as_ref().map_or(0.0, PlaceBook::voxel_size);
        let (places, descriptors) = book.map_or_else(Default::default, |book| (book.to_bytes(), book.descriptors().to_bytes()));
        let pose = |(node, time, pose): &(NodeId, f64, Pose)| (*node, *time, numbers(state.corrected.get(node).unwrap_or(pose)));
        Ok((
            state.nodes.iter().map(pose).collect(),
            state.odometry.iter().map(row).collect(),
            state.loops.iter().map(row).collect(),
            PyBytes::new(py, &places),
            PyBytes::new(py, &descriptors),
            voxel,
            state.problems.clone(),
            state.poses.as_ref().map_or([0.0; 3], |poses| poses.origin().coordinates()),
        ))
    }
}

impl State {
    fn take(&mut self, mut input: Input) {
        rescale(&mut input, self.scale);
        let Some(poses) = &mut self.poses else { return };
        let (posed, has_pieces) = (poses.take(input, &mut self.warnings), poses.is_raw() == Some(true));
        match posed {
            Ok(events) => events.into_iter().for_each(|event| self.event(event, has_pieces)),
            Err(problem) => self.problems.push(problem),
        }
    }

    /// Takes an event. With `has_pieces`, a scan without an odometry edge from the one before begins a piece of its own.
    fn event(&mut self, event: Event, has_pieces: bool) {
        let numbered =
            |numbers: &HashMap<NodeId, NodeId>, edge: Edge| Some(Edge { from: *numbers.get(&edge.from)?, to: *numbers.get(&edge.to)?, ..edge });
        match event {
            Event::Scan(mut scan) => {
                self.settle(has_pieces);
                let number = self.first_node + self.numbers.len() as NodeId;
                if self.numbers.insert(scan.node, number).is_none() {
                    scan.node = number;
                    self.pending = Some(scan);
                }
            }
            Event::OdometryEdge(edge) => {
                if let Some(edge) = numbered(&self.numbers, edge) {
                    self.odometry.push(edge);
                }
            }
            Event::LoopEdge(edge) => self.loops.extend(numbered(&self.numbers, edge)),
            Event::PoseUpdate(poses) => {
                for (node, pose) in poses {
                    if let Some(number) = self.numbers.get(&node) {
                        self.corrected.insert(*number, pose);
                    }
                }
            }
            _ => {}
        }
    }

    /// Adds the scan that waited for its edge.
    fn settle(&mut self, has_pieces: bool) {
        let Some(scan) = self.pending.take() else { return };
        let (node, pose) = (scan.node, scan.t_map_lidar);
        let edge = self.odometry.last().filter(|edge| edge.to == node || edge.from == node).cloned();
        let step = self.last.map_or(0.0, |(_, last)| last.translation_distance(&pose));
        let is_cut = self.last.is_some() && edge.is_none() && has_pieces;
        if let Some((last, t_map_last)) = self.last.filter(|_| edge.is_none() && !has_pieces) {
            self.odometry.push(Edge { from: last, to: node, t_from_to: t_map_last.inv_mul(&pose), information: None });
        }
        self.travelled += step;
        if (is_cut || self.travelled > self.metres) && !self.piece.is_empty() {
            self.done.push(std::mem::take(&mut self.piece));
            self.travelled = 0.0;
        }
        self.last = Some((node, pose));
        self.nodes.push((node, scan.time, pose));
        let mut found = self.finder.take(&Event::Scan(scan.clone()));
        if let Some(edge) = self.odometry.last().filter(|_| !is_cut).cloned() {
            found.extend(self.finder.take(&Event::OdometryEdge(edge)));
        }
        self.loops.extend(found);
        self.piece.push(scan);
    }

    fn end(&mut self) {
        let has_pieces = self.poses.as_ref().and_then(PoseStage::is_raw) == Some(true);
        let waiting = self.poses.as_mut().map(|poses| poses.finish(&mut self.warnings)).unwrap_or_default();
        waiting.into_iter().for_each(|event| self.event(event, has_pieces));
        self.settle(has_pieces);
        let found = self.finder.finish();
        self.loops.extend(found);
        if !self.piece.is_empty() {
            self.done.push(std::mem::take(&mut self.piece));
        }
        self.is_over = true;
    }
}

/// Multiplies all lengths of an input.
fn rescale(input: &mut Input, scale: f64) {
    if scale == 1.0 {
        return;
    }
    match input {
        Input::Event(Event::Scan(scan)) => {
            scan.t_map_lidar.translation.vector *= scale;
            rescale_points(&mut scan.cloud, scale);
        }
        Input::RawScan(scan, _) => rescale_points(&mut scan.cloud, scale),
        Input::Event(Event::OdometryEdge(edge) | Event::LoopEdge(edge)) => edge.t_from_to.translation.vector *= scale,
        Input::Event(Event::PoseUpdate(poses)) => poses.iter_mut().for_each(|(_, pose)| pose.translation.vector *= scale),
        _ => {}
    }
}

fn rescale_points(cloud: &mut voxelastic::Cloud, scale: f64) {
    cloud.points.iter_mut().flatten().for_each(|c| *c *= scale as f32);
    // In the units of the recording, too.
    cloud.motion = None;
}

/// The scans of a piece, each with its pose.
#[pyfunction]
pub fn unpack_scans(py: Python<'_>, piece: &[u8]) -> PyResult<Vec<Scan>> {
    let scans = job::run_short(py, || postcard::from_bytes::<Vec<CoreScan>>(piece).ok())?;
    Ok(scans.ok_or_else(|| damaged("the scans of a piece"))?.into_iter().map(Scan::with_pose).collect())
}

/// Pairs of places that look alike in two recordings, by their descriptors: numbers of both, and how alike, at most 1.
#[pyfunction]
pub fn alike_places(py: Python<'_>, first: &[u8], second: &[u8], most: usize) -> PyResult<Vec<(usize, usize, f32)>> {
    let pool = job::shared_pool()?;
    let read = |bytes: &[u8]| PlaceDescriptors::from_bytes(bytes).ok_or_else(|| damaged("the descriptors of places"));
    let (first, second) = (read(first)?, read(second)?);
    let pairs = job::run_short(py, || pool.install(|| first.alike(&second, most)))?;
    Ok(pairs.iter().map(|pair| (pair.first, pair.second, pair.likeness)).collect())
}

/// The edge, the verdict, the overlap and the share of surfaces in free space of a closure that was tried.
type ClosureRow = (EdgeRow, &'static str, Option<f64>, Option<f64>);

/// Registers places of two recordings to each other: all closures that were tried.
#[pyfunction]
pub fn verify_places(py: Python<'_>, first: &[u8], second: &[u8], pairs: Vec<(usize, usize, f32)>) -> PyResult<Vec<ClosureRow>> {
    let pool = job::shared_pool()?;
    let read = |bytes: &[u8]| PlaceBook::from_bytes(bytes).ok_or_else(|| damaged("the places of a recording"));
    let (first, second) = (read(first)?, read(second)?);
    let pairs: Vec<PlacePair> = pairs.into_iter().map(|(first, second, likeness)| PlacePair { first, second, likeness }).collect();
    let rows = job::run_short(py, || {
        pool.install(|| {
            let closures = first.verify(&second, &pairs, &LoopSettings::default());
            closures.iter().map(|closure| closure_row(&first, closure)).collect::<Vec<_>>()
        })
    })?;
    Ok(rows)
}

fn closure_row(book: &PlaceBook, closure: &Closure) -> ClosureRow {
    let verdict = match closure.verdict {
        Verdict::Accepted => "accepted",
        Verdict::NotRegistered => "not registered",
        Verdict::PoorFit => "poor fit",
        Verdict::FreeSpace => "in free space",
        _ => "refused",
    };
    let edge = book.edge(closure).unwrap_or(Edge { from: closure.from, to: closure.to, t_from_to: Pose::identity(), information: None });
    (row(&edge), verdict, closure.fit.map(|fit| fit.overlap), closure.fit.and_then(|fit| fit.contradiction))
}

/// Optimises a pose graph: the nodes with their new poses, in order, and whether it converged.
#[pyfunction]
pub fn optimise_graph(py: Python<'_>, nodes: Vec<(NodeId, Numbers)>, edges: Vec<EdgeRow>, fixed: Vec<NodeId>) -> PyResult<(Vec<Numbers>, bool)> {
    let nodes: Vec<(NodeId, Pose)> = nodes.iter().map(|(node, numbers)| (*node, pose(numbers))).collect();
    let edges: Vec<Edge> = edges.iter().map(edge).collect();
    let pool = job::shared_pool()?;
    let solved = job::run(py, move || pool.install(|| solve(&Problem { nodes: &nodes, edges: &edges, fixed: &fixed }, &Options::default())))?;
    let solved = solved.map_err(|e| errors::Kind::Refused.exception(py, e.to_string()))?;
    Ok((solved.poses.iter().map(|(_, pose)| numbers(pose)).collect(), solved.is_converged))
}

/// The manifest of the map of the submaps of several maps, around `origin`: see `voxelastic_io::store::join_manifests`.
#[pyfunction]
pub fn join_manifests(py: Python<'_>, texts: Vec<String>, poses: BTreeMap<u32, Numbers>, only_posed: bool, origin: [f64; 3]) -> PyResult<String> {
    let poses = poses.iter().map(|(id, numbers)| (*id, pose(numbers))).collect();
    join_texts(&texts, &poses, only_posed, Some(origin_at(origin)?)).map_err(|e| errors::file(py, &e))
}

/// The cells of tiles of a level that a box of the map frame touches: coordinates, in the order in which tiles are joined.
#[pyfunction]
pub fn cells_of_box(low: [f64; 3], high: [f64; 3], voxel: f64, level: u8) -> PyResult<Vec<[u32; 3]>> {
    let corner = |point| Cell::containing(point, voxel).map(|cell| cell.above(level).coordinates());
    let (Some(low), Some(high)) = (corner(low), corner(high)) else {
        return Err(pyo3::exceptions::PyValueError::new_err("the box is too far from the origin of the map"));
    };
    let mut cells: Vec<Cell> = Vec::new();
    for x in low[0]..=high[0] {
        for y in low[1]..=high[1] {
            cells.extend((low[2]..=high[2]).filter_map(|z| Cell::new(level, [x, y, z])));
        }
    }
    cells.sort_by_key(Cell::order);
    Ok(cells.iter().map(Cell::coordinates).collect())
}

/// Writes the tiles of the part of a map in one cell to a folder: what the next level is made of, as bytes, and the names of the files. None without a surface
/// there. `heights`: those between which colours range where scans have no colours, metres.
#[pyfunction]
pub fn write_tiles<'py>(
    py: Python<'py>,
    map: &Map,
    cell: (u8, [u32; 3]),
    heights: (f32, f32),
    folder: PathBuf,
) -> PyResult<Option<(Bound<'py, PyBytes>, Vec<String>)>> {
    let (content, pool) = (map.content()?, job::shared_pool()?);
    let (level, coordinates) = cell;
    let region = Cell::new(level, coordinates).filter(|_| level > 0).ok_or_else(|| pyo3::exceptions::PyValueError::new_err("no such cell"))?;
    let write = move || -> voxelastic_io::Result<Option<(Vec<u8>, Vec<String>)>> {
        let voxel = f64::from(content.atlas.voxel_size());
        let (low, high) = region.bounds(voxel);
        let mut writer = TilesetWriter::create(folder, voxel)?;
        pool.install(|| {
            let surface = SurfaceTiles::within(&content.atlas, MeshOptions::default(), low, high);
            leaves(&surface, voxel, |cell, mut mesh| {
                if cell.above(level) == region {
                    colour_by_height(&mut mesh, heights);
                    writer.leaf(cell, mesh)?;
                }
                Ok(())
            })
        })?;
        let parts = pool.install(|| writer.parts(level))?;
        Ok(parts.first().map(|part| (part.to_bytes(), part.files().to_vec())))
    };
    let written = job::run(py, write)?.map_err(|e| errors::file(py, &e))?;
    Ok(written.map(|(bytes, files)| (PyBytes::new(py, &bytes), files)))
}

/// Writes the upper levels of tiles, `tileset.json` and the page to a folder, from parts in the order of their cells, of a map around `origin`. Returns the number of
/// tiles written here.
#[pyfunction]
pub fn finish_tiles(py: Python<'_>, parts: Vec<PathBuf>, voxel: f64, folder: PathBuf, title: String, origin: [f64; 3]) -> PyResult<usize> {
    let (pool, origin) = (job::shared_pool()?, origin_at(origin)?);
    let write = move || -> voxelastic_io::Result<usize> {
        let mut writer = TilesetWriter::create(&folder, voxel)?.with_origin(origin);
        for path in parts {
            let bytes = std::fs::read(&path).map_err(|e| voxelastic_io::Error::Io { path: path.clone(), doing: "read", source: e })?;
            let part = Part::from_bytes(&bytes, &path)?;
            pool.install(|| writer.part(part))?;
        }
        let report = pool.install(|| writer.finish(&title))?;
        for (name, bytes) in report.iter().flat_map(|_| voxelastic_cli::TILES_PAGE) {
            let path = folder.join(name);
            std::fs::write(&path, bytes).map_err(|e| voxelastic_io::Error::Io { path: path.clone(), doing: "write", source: e })?;
        }
        Ok(report.map_or(0, |report| report.tiles))
    };
    job::run(py, write)?.map_err(|e| errors::file(py, &e))
}

fn origin_at(coordinates: [f64; 3]) -> PyResult<Origin> {
    Origin::new(coordinates).ok_or_else(|| pyo3::exceptions::PyValueError::new_err("the origin is not finite"))
}

fn colour_by_height(mesh: &mut voxelastic::surface::Mesh, (low, high): (f32, f32)) {
    if mesh.colours.is_empty() {
        let range = (high - low).max(0.01);
        mesh.colours = mesh.positions.iter().map(|p| voxelastic_eval::colour::Ramp::Land.at((p[2] - low) / range)).collect();
    }
}

fn numbers(pose: &Pose) -> Numbers {
    let (t, q) = (&pose.translation.vector, &pose.rotation.coords);
    [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
}

fn pose([x, y, z, qx, qy, qz, qw]: &Numbers) -> Pose {
    let rotation = nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::new(*qw, *qx, *qy, *qz));
    Pose::from_parts(nalgebra::Translation3::new(*x, *y, *z), rotation)
}

fn row(edge: &Edge) -> EdgeRow {
    (edge.from, edge.to, numbers(&edge.t_from_to), edge.information.map(Vec::from))
}

fn edge((from, to, numbers, information): &EdgeRow) -> Edge {
    let information = information.as_ref().and_then(|values| <[f64; 21]>::try_from(&values[..]).ok());
    Edge { from: *from, to: *to, t_from_to: pose(numbers), information }
}

fn damaged(what: &str) -> PyErr {
    pyo3::exceptions::PyValueError::new_err(format!("{what}: damaged, or of another version of voxelastic"))
}
