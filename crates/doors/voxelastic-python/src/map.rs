//! A map: its submaps, surface and distances.

use crate::{arrays, errors, job};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::{PyMemoryError, PyValueError};
use pyo3::types::PyTuple;
use pyo3::{Bound, PyAny, PyResult, Python, pyclass, pyfunction, pymethods};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use voxelastic::Settings;
use voxelastic::atlas::{Atlas, Submap};
use voxelastic::field::occupancy::State;
use voxelastic::field::tsdf::{TsdfField, WEIGHT_ONE};
use voxelastic::geometry::{Aabb, Rigid};
use voxelastic::octree::{BLOCK_EDGE, SCALES, block_coords};
use voxelastic::query::{AtlasQuery, DistanceQuery};
use voxelastic::surface::{Mesh, MeshOptions, OccupancySurface};
use voxelastic_earth::Georeference;
use voxelastic_esdf::{EsdfError, EsdfSettings, LocalEsdf};
use voxelastic_io::Origin;
use voxelastic_io::mesh_io::{self, MeshRef};
use voxelastic_io::store::{MapDetails, MapStore, MapWriter, SessionEntry};
use voxelastic_run::surfaces::{self, SurfaceOptions};
use voxelastic_run::{Warnings, joining, precision};

/// Points queried between two looks for Ctrl-C.
const QUERIES_AT_ONCE: usize = 1 << 20;

/// A map. It does not change, so threads share it; closing it frees the memory when no call uses it any more.
#[pyclass(frozen, module = "voxelastic._native")]
pub struct Map {
    /// None once it is closed.
    content: Mutex<Option<Arc<Content>>>,
}

/// What a map is made of.
pub struct Content {
    /// The submaps.
    pub atlas: Atlas,
    /// The settings that it was made with.
    pub settings: Settings,
    /// Description of the sensor, if known.
    pub sensor: Option<String>,
    /// Where coordinates are counted from; zero unless the command made the map of poses far from zero.
    pub origin: Origin,
    /// Where it lies on Earth, if it was georeferenced.
    pub place: Option<Georeference>,
    /// Its sessions, if it was saved.
    pub sessions: Vec<SessionEntry>,
    /// What was made of distance fields, by their settings: of those asked for last.
    distance_fields: Mutex<Vec<(EsdfSettings, DistanceField)>>,
}

/// A distance field around the points that it was asked about.
type DistanceField = Arc<Mutex<LocalEsdf>>;

/// Distance fields that a map keeps.
const FIELDS_KEPT: usize = 2;

impl From<Content> for Map {
    fn from(content: Content) -> Self {
        Self { content: Mutex::new(Some(Arc::new(content))) }
    }
}

impl Content {
    /// A map of these submaps.
    pub fn new(atlas: Atlas, settings: Settings, sensor: Option<String>, origin: Origin) -> Self {
        Self { atlas, settings, sensor, origin, place: None, sessions: Vec::new(), distance_fields: Mutex::default() }
    }

    /// The distance field of these settings, which is kept for the next points.
    pub fn distance_field(&self, settings: EsdfSettings) -> Result<DistanceField, EsdfError> {
        let mut fields = self.distance_fields.lock().unwrap_or_else(PoisonError::into_inner);
        let at = fields.iter().position(|(of, _)| *of == settings);
        let field = match at.map(|at| fields.remove(at)) {
            Some((_, field)) => field,
            None => Arc::new(Mutex::new(LocalEsdf::new(settings, self.atlas.voxel_size())?)),
        };
        fields.truncate(FIELDS_KEPT - 1);
        fields.insert(0, (settings, Arc::clone(&field)));
        Ok(field)
    }

    /// The surface of a kind, in the map frame, of one submap or of all. `surface` is `measured`, `occupied`, `free` or `frontier`.
    pub fn mesh(&self, surface: &str, mesh: &MeshOptions, unfused: bool, only: Option<u32>) -> voxelastic_run::Result<Mesh> {
        let occupancy = match surface {
            "occupied" => Some(OccupancySurface::Occupied),
            "free" => Some(OccupancySurface::FreeHull),
            "frontier" => Some(OccupancySurface::Frontier),
            _ => None,
        };
        let options = SurfaceOptions { occupancy, mesh: mesh.clone(), unfused };
        let Some(id) = only else { return Ok(surfaces::of_map(&self.atlas, &options, &mut Warnings::default())?.mesh) };
        precision::check(&self.atlas, self.atlas.voxel_size(), &mut Warnings::default())?;
        let Some(submap) = self.atlas.submap(id) else { return Ok(Mesh::default()) };
        let mut mesh = options.extract(submap);
        mesh.transform(&Rigid::from(&submap.t_map_submap()));
        Ok(mesh)
    }

    fn bounds(&self) -> Option<Aabb> {
        let mut bounds = Aabb::default();
        let (surfaces, space) = (DistanceQuery::new(&self.atlas), AtlasQuery::new(&self.atlas));
        let parts = [(!surfaces.is_empty()).then(|| surfaces.bounds()), (!space.is_empty()).then(|| space.bounds())];
        for part in parts.iter().flatten() {
            bounds.add(part.min);
            bounds.add(part.max);
        }
        parts.iter().any(Option::is_some).then_some(bounds)
    }
}

#[pymethods]
impl Map {
    /// Closes the map: its memory is free when no call uses it any more. Whether that is now.
    fn close(&self, py: Python<'_>) -> bool {
        let content = self.content.lock().unwrap_or_else(PoisonError::into_inner).take();
        py.detach(|| content.and_then(Arc::into_inner).is_some())
    }

    /// Another map of the same memory: each is closed by itself.
    fn copy(&self) -> PyResult<Self> {
        Ok(Self { content: Mutex::new(Some(self.content()?)) })
    }

    /// Whether it was closed.
    fn is_closed(&self) -> bool {
        self.content.lock().unwrap_or_else(PoisonError::into_inner).is_none()
    }

    /// Opens a stored map; also returns what is to be said about its settings.
    #[staticmethod]
    fn open(py: Python<'_>, path: PathBuf, keep_vanished: bool) -> PyResult<(Self, Vec<String>)> {
        let pool = job::shared_pool()?;
        let load = move || -> voxelastic_io::Result<_> {
            let store = MapStore::open(&path)?;
            let Some(stored) = store.manifest().details.stored_settings() else { return Ok(None) };
            let details = &store.manifest().details;
            let origin = details.origin().map_err(str::to_owned);
            let place = details.georeference();
            let atlas = store.load_atlas()?;
            let atlas = if keep_vanished { atlas } else { store.without_vanished(atlas, &stored.settings).0 };
            Ok(Some((atlas, stored, details.sensor.get("description").cloned(), origin, place, joining::listed_sessions(&store))))
        };
        let opened = job::run(py, move || pool.install(load))?;
        let Some((atlas, stored, sensor, origin, place, sessions)) = opened.map_err(|e| errors::file(py, &e))? else {
            return Err(errors::Kind::File.exception(py, "the manifest of the map does not contain the voxel size; map the data again".to_owned()));
        };
        let damaged = |words: String| errors::Kind::File.exception(py, format!("the manifest of the map has an origin that is none: {words:?}"));
        let origin = origin.map_err(damaged)?;
        let place = place.map_err(|e| errors::Kind::File.exception(py, format!("the manifest of the map: {e}; {}", e.remedy())))?;
        let remarks: Vec<String> =
            stored.refused.iter().map(|problem| format!("the map has a setting that this version does not know: {problem}")).collect();
        Ok((Content { sessions, place, ..Content::new(atlas, stored.settings, sensor, origin) }.into(), remarks))
    }

    /// Saves the map to a directory. A save that has begun is completed.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let (content, pool) = (self.content()?, job::shared_pool()?);
        let details = MapDetails::describe(&content.settings, content.sensor.as_deref()).with_origin(content.origin);
        let details = content.place.iter().fold(details, |details, place| details.with_georeference(place));
        let saved = job::run_short(py, || pool.install(|| MapWriter::create(&path)?.save(&content.atlas, &details)))?;
        saved.map(|_| ()).map_err(|e| errors::file(py, &e))
    }

    /// The same map with submaps numbered from `first` on, in their order, whose coordinates count from `origin`.
    fn renumbered(&self, first: u32, origin: [f64; 3]) -> PyResult<Self> {
        let origin = Origin::new(origin).ok_or_else(|| PyValueError::new_err("the origin is not finite"))?;
        let content = self.content()?;
        let Content { atlas, settings, sensor, .. } = &*content;
        let submaps = (first..).zip(atlas.submaps()).map(|(id, submap)| submap.clone().with_id(id)).collect();
        let atlas = Atlas::from_submaps(atlas.voxel_size(), submaps);
        Ok(Content::new(atlas, settings.clone(), sensor.clone(), origin).into())
    }

    /// The settings that it was made with, as text.
    fn settings(&self) -> PyResult<Vec<(&'static str, String)>> {
        Ok(self.content()?.settings.pairs())
    }

    /// Where coordinates are counted from.
    fn origin(&self) -> PyResult<[f64; 3]> {
        Ok(self.content()?.origin.coordinates())
    }

    /// Description of the sensor, if known.
    fn sensor(&self) -> PyResult<Option<String>> {
        Ok(self.content()?.sensor.clone())
    }

    /// Memory of the fields, bytes.
    fn nbytes(&self) -> PyResult<usize> {
        Ok(self.content()?.atlas.bytes())
    }

    /// Whether it has signed distances, and whether it has occupancy.
    fn fields(&self) -> PyResult<(bool, bool)> {
        let content = self.content()?;
        Ok((!content.atlas.tsdfs().is_empty(), !AtlasQuery::new(&content.atlas).is_empty()))
    }

    /// Each submap: identifier, the pose in the map frame as a 4 x 4 matrix, its nodes, the number of changes.
    fn submaps(&self) -> PyResult<Vec<SubmapFields>> {
        Ok(submaps_of(&self.content()?.atlas))
    }

    /// The nodes of the map with the present poses of their scans, 4 x 4.
    fn poses(&self) -> PyResult<Vec<(u64, [[f64; 4]; 4])>> {
        let content = self.content()?;
        let of = |submap: &Submap| {
            let t_map_submap = submap.t_map_submap();
            submap.corrected_scans().map(|(node, t)| (node, arrays::matrix_of_pose(&content.origin.to_map(t_map_submap * t)))).collect::<Vec<_>>()
        };
        let mut poses: Vec<_> = content.atlas.submaps().iter().flat_map(of).collect();
        poses.sort_by_key(|(node, _)| *node);
        Ok(poses)
    }

    /// Smallest and largest coordinates of what was observed, map frame; none for an empty map.
    fn bounds(&self, py: Python<'_>) -> PyResult<Option<([f32; 3], [f32; 3])>> {
        let content = self.content()?;
        Ok(job::run_short(py, || content.bounds())?.map(|bounds| (bounds.min, bounds.max)))
    }

    /// Vertices, triangles, normals, scales, intensities and colours of a surface.
    #[expect(clippy::too_many_arguments, reason = "called by name from Python only")]
    fn mesh<'py>(
        &self,
        py: Python<'py>,
        surface: String,
        lod: usize,
        min_weight: f32,
        close_gaps: bool,
        keep_all: bool,
        unfused: bool,
        submap: Option<u32>,
    ) -> PyResult<Bound<'py, PyTuple>> {
        let content = self.content()?;
        let options = MeshOptions { min_weight, lod, close_gaps, keep_all };
        let pool = job::shared_pool()?;
        let mesh = job::run(py, move || pool.install(|| content.mesh(&surface, &options, unfused, submap)))?.map_err(|e| errors::run(py, &e))?;
        // There are fewer than 2^31 vertices, and few programs take unsigned indices.
        let triangles: Vec<[i32; 3]> = bytemuck::allocation::cast_vec(mesh.triangles);
        let optional = |is_empty: bool, array: Bound<'py, PyAny>| if is_empty { py.None().into_bound(py) } else { array };
        PyTuple::new(
            py,
            [
                arrays::from_rows(py, mesh.positions)?.into_any(),
                arrays::from_rows(py, triangles)?.into_any(),
                arrays::from_rows(py, mesh.normals)?.into_any(),
                PyArray1::from_vec(py, mesh.scales).into_any(),
                optional(mesh.intensities.is_empty(), PyArray1::from_vec(py, mesh.intensities).into_any()),
                optional(mesh.colours.is_empty(), arrays::from_rows(py, mesh.colours)?.into_any()),
            ],
        )
    }

    /// The voxels of a submap, by number: for each scale that it has, the scale, then of each block the coordinates of its first voxel in finest voxels,
    /// and of each of its voxels, x fastest, the signed distance (NaN where it was not observed) and the weight. None if there is no such submap.
    fn blocks<'py>(&self, py: Python<'py>, submap: u32) -> PyResult<Option<Vec<BlockArrays<'py>>>> {
        let content = self.content()?;
        let Some(submap) = content.atlas.submaps().iter().find(|s| s.id() == submap) else { return Ok(None) };
        let pool = job::shared_pool()?;
        let blocks = job::run_short(py, || pool.install(|| blocks_by_scale(submap.tsdf(), content.atlas.voxel_size())))?;
        let arrays = blocks.into_iter().enumerate().filter(|(_, blocks)| !blocks.coordinates.is_empty()).map(|(scale, blocks)| {
            let coordinates = arrays::from_rows(py, blocks.coordinates)?;
            Ok((scale, coordinates, PyArray1::from_vec(py, blocks.distances), PyArray1::from_vec(py, blocks.weights)))
        });
        Ok(Some(arrays.collect::<PyResult<_>>()?))
    }

    /// Signed distances, gradients and states at the rows of an N x 3 array, float32 or float64.
    fn query<'py>(&self, py: Python<'py>, points: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyTuple>> {
        let content = self.content()?;
        let (surfaces, space) = (DistanceQuery::new(&content.atlas), AtlasQuery::new(&content.atlas));
        let samples = answer(py, points, |points| surfaces.sample_many(points), |points| surfaces.sample_many(points))?;
        let pairs = samples.into_iter().map(|sample| sample.map_or((f32::NAN, [0.0; 3]), |s| (s.distance, s.gradient)));
        let (distances, gradients): (Vec<f32>, Vec<[f32; 3]>) = job::run_short(py, || pairs.unzip())?;
        let states = states_of(py, &space, points)?;
        PyTuple::new(
            py,
            [PyArray1::from_vec(py, distances).into_any(), arrays::from_rows(py, gradients)?.into_any(), PyArray1::from_vec(py, states).into_any()],
        )
    }

    /// Signed distances at the rows of an N x 3 array, float32 or float64; NaN where none is known.
    fn distances<'py>(&self, py: Python<'py>, points: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyArray1<f32>>> {
        let content = self.content()?;
        let surfaces = DistanceQuery::new(&content.atlas);
        let distances = answer(py, points, |points| surfaces.sample_distances(points), |points| surfaces.sample_distances(points))?;
        Ok(PyArray1::from_vec(py, distances))
    }

    /// States at the rows of an N x 3 array, float32 or float64.
    fn states<'py>(&self, py: Python<'py>, points: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyArray1<u8>>> {
        let content = self.content()?;
        Ok(PyArray1::from_vec(py, states_of(py, &AtlasQuery::new(&content.atlas), points)?))
    }
}

/// Writes a mesh in the format that the ending of its name says; `colours` and `intensity` may be none.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "called by name from Python only")]
pub fn write_mesh(
    py: Python<'_>,
    path: PathBuf,
    vertices: PyReadonlyArray2<'_, f32>,
    triangles: PyReadonlyArray2<'_, u32>,
    normals: PyReadonlyArray2<'_, f32>,
    colours: Option<PyReadonlyArray2<'_, u8>>,
    intensity: Option<PyReadonlyArray1<'_, f32>>,
    origin: [f64; 3],
) -> PyResult<()> {
    let (positions, triangles, normals) = (arrays::rows(&vertices)?, arrays::rows(&triangles)?, arrays::rows(&normals)?);
    let colours = colours.as_ref().map(arrays::rows).transpose()?;
    let intensity = intensity.as_ref().map(|values| values.as_slice()).transpose()?;
    let mesh = MeshRef { positions, origin, normals, colours, intensity, triangles };
    job::run_short(py, || mesh_io::write(&path, &mesh))?.map_err(|e| errors::file(py, &e))
}

/// Identifier, pose, nodes, number of changes.
pub type SubmapFields = (u32, [[f64; 4]; 4], Vec<u64>, u64);

/// The submaps of an atlas.
pub fn submaps_of(atlas: &Atlas) -> Vec<SubmapFields> {
    let nodes = |submap: &Submap| submap.scans().iter().map(|scan| scan.node).collect();
    atlas.submaps().iter().map(|submap| (submap.id(), arrays::matrix_of_pose(&submap.t_map_submap()), nodes(submap), submap.revision())).collect()
}

/// Scale, coordinates, distances, weights.
type BlockArrays<'py> = (usize, Bound<'py, PyArray2<i32>>, Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<f32>>);

/// Blocks of one scale.
#[derive(Default)]
struct Blocks {
    coordinates: Vec<[i32; 3]>,
    distances: Vec<f32>,
    weights: Vec<f32>,
}

/// The blocks of a field, by scale.
fn blocks_by_scale(field: &TsdfField, voxel_size: f32) -> [Blocks; SCALES] {
    let mut blocks: [Blocks; SCALES] = Default::default();
    for block in field.ids().map(|id| field.block(id)) {
        let scale = usize::from(block.scale);
        let Blocks { coordinates, distances, weights } = &mut blocks[scale];
        let edge = voxel_size * (1 << scale) as f32;
        coordinates.push(block_coords(block.key).map(|c| c * BLOCK_EDGE as i32));
        for voxel in field.current(block) {
            distances.push(if voxel.is_observed() { voxel.distance_in_voxels() * edge } else { f32::NAN });
            weights.push(f32::from(voxel.weight) / f32::from(WEIGHT_ONE));
        }
    }
    blocks
}

impl Map {
    /// Its content.
    ///
    /// # Errors
    /// The map is closed.
    pub fn content(&self) -> PyResult<Arc<Content>> {
        let content = self.content.lock().unwrap_or_else(PoisonError::into_inner);
        content
            .as_ref()
            .map(Arc::clone)
            .ok_or_else(|| PyValueError::new_err("the map is closed: open it again, or use it before `close()` and within its `with` block"))
    }
}

/// Answers for the rows of an N x 3 array, float32 or float64, some at a time: Ctrl-C ends it between them.
fn answer<A: Send>(
    py: Python<'_>,
    points: &Bound<'_, PyAny>,
    single: impl Fn(&[[f32; 3]]) -> Vec<A> + Sync,
    double: impl Fn(&[[f64; 3]]) -> Vec<A> + Sync,
) -> PyResult<Vec<A>> {
    match points.cast::<PyArray2<f64>>() {
        Ok(points) => in_parts(py, arrays::rows(&points.try_readonly()?)?, double),
        Err(_) => in_parts(py, arrays::rows(&points.cast::<PyArray2<f32>>()?.try_readonly()?)?, single),
    }
}

fn in_parts<T: Sync, A: Send>(py: Python<'_>, points: &[T], answer: impl Fn(&[T]) -> Vec<A> + Sync) -> PyResult<Vec<A>> {
    let pool = job::shared_pool()?;
    if points.len() <= QUERIES_AT_ONCE {
        return job::run_short(py, || pool.install(|| answer(points)));
    }
    let mut answers = Vec::new();
    if answers.try_reserve_exact(points.len()).is_err() {
        return Err(PyMemoryError::new_err(format!("there is no memory for the answers to {} points: ask for fewer at a time", points.len())));
    }
    for points in points.chunks(QUERIES_AT_ONCE) {
        answers.append(&mut job::run_short(py, || pool.install(|| answer(points)))?);
        py.check_signals()?;
    }
    Ok(answers)
}

fn states_of(py: Python<'_>, space: &AtlasQuery<'_>, points: &Bound<'_, PyAny>) -> PyResult<Vec<u8>> {
    let numbers = |states: Vec<State>| states.into_iter().map(number_of).collect();
    answer(py, points, |points| numbers(space.states(points)), |points| numbers(space.states(points)))
}

/// The numbers of `voxelastic.State`.
pub fn number_of(state: State) -> u8 {
    match state {
        State::Unknown => 0,
        State::Free => 1,
        State::Occupied => 2,
    }
}
