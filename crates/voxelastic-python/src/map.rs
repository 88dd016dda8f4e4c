//! A map: its submaps, surface and distances.

use crate::{arrays, errors, job};
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::types::PyTuple;
use pyo3::{Bound, PyAny, PyResult, Python, pyclass, pymethods};
use rayon::prelude::*;
use std::path::PathBuf;
use std::sync::Arc;
use voxelastic::Settings;
use voxelastic::atlas::Atlas;
use voxelastic::field::occupancy::State;
use voxelastic::field::tsdf::{TsdfField, WEIGHT_ONE};
use voxelastic::geometry::{Aabb, Rigid};
use voxelastic::octree::{BLOCK_EDGE, SCALES, block_coords};
use voxelastic::query::DistanceQuery;
use voxelastic::surface::{Mesh, MeshOptions, OccupancySurface, extract_occupancy};
use voxelastic_io::store::{MapDetails, MapStore, MapWriter};

/// Points queried between two looks for Ctrl-C.
const QUERIES_AT_ONCE: usize = 1 << 20;

/// Points that a thread takes at a time.
const QUERIES_PER_TASK: usize = 1 << 10;

/// A map. It does not change, so threads share it.
#[pyclass(frozen, module = "voxelastic._native")]
pub struct Map {
    content: Arc<Content>,
}

/// What a map is made of.
pub struct Content {
    /// The submaps.
    pub atlas: Atlas,
    /// The settings that it was made with.
    pub settings: Settings,
    /// Description of the sensor, if known.
    pub sensor: Option<String>,
}

impl From<Content> for Map {
    fn from(content: Content) -> Self {
        Self { content: Arc::new(content) }
    }
}

impl Content {
    /// The surface of a kind, in the map frame. `surface` is `measured`, `occupied`, `free` or `frontier`.
    fn mesh(&self, surface: &str, options: &MeshOptions, shells: bool) -> Mesh {
        let kind = match surface {
            "occupied" => Some(OccupancySurface::Occupied),
            "free" => Some(OccupancySurface::FreeHull),
            "frontier" => Some(OccupancySurface::Frontier),
            _ => self.atlas.tsdfs().is_empty().then_some(OccupancySurface::Occupied),
        };
        match kind {
            Some(kind) => {
                let mut mesh = Mesh::default();
                for submap in self.atlas.submaps() {
                    let part = extract_occupancy(submap.occupancy(), self.atlas.voxel_size(), kind, options.lod);
                    mesh.append(&part, &Rigid::from(&submap.t_map_submap()));
                }
                mesh
            }
            None if shells => self.atlas.shells(options),
            None => self.atlas.mesh(options),
        }
    }

    fn bounds(&self) -> Option<Aabb> {
        let mut bounds = Aabb::default();
        let (surfaces, space) = (DistanceQuery::new(&self.atlas), self.atlas.query());
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
    /// Opens a stored map; also returns what is wrong with its settings.
    #[staticmethod]
    fn open(py: Python<'_>, path: PathBuf) -> PyResult<(Self, Vec<String>)> {
        let pool = job::shared_pool()?;
        let load = move || -> voxelastic_io::Result<_> {
            let store = MapStore::open(&path)?;
            let Some(stored) = store.manifest().details.stored_settings() else { return Ok(None) };
            Ok(Some((store.load_atlas()?, stored, store.manifest().details.sensor.get("description").cloned())))
        };
        let opened = job::run(py, move || pool.install(load))?;
        let Some((atlas, stored, sensor)) = opened.map_err(|e| errors::file(py, &e))? else {
            return Err(errors::Kind::File.exception(py, "the manifest of the map does not contain the voxel size; map the data again".to_owned()));
        };
        let refused = stored.refused.iter().map(ToString::to_string).collect();
        Ok((Content { atlas, settings: stored.settings, sensor }.into(), refused))
    }

    /// Saves the map to a directory. A save that has begun is completed.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let (content, pool) = (&self.content, job::shared_pool()?);
        let details = MapDetails::describe(&content.settings, content.sensor.as_deref());
        let saved = job::run_short(py, || pool.install(|| MapWriter::create(&path)?.save(&content.atlas, &details)))?;
        saved.map(|_| ()).map_err(|e| errors::file(py, &e))
    }

    /// The settings that it was made with, as text.
    fn settings(&self) -> Vec<(&'static str, String)> {
        self.content.settings.pairs()
    }

    /// Description of the sensor, if known.
    fn sensor(&self) -> Option<String> {
        self.content.sensor.clone()
    }

    /// Memory of the fields, bytes.
    fn nbytes(&self) -> usize {
        self.content.atlas.bytes()
    }

    /// Whether it has signed distances, and whether it has occupancy.
    fn fields(&self) -> (bool, bool) {
        (!self.content.atlas.tsdfs().is_empty(), !self.content.atlas.query().is_empty())
    }

    /// Each submap: identifier, the pose in the map frame as a 4 x 4 matrix, its nodes.
    fn submaps(&self) -> Vec<(u32, [[f64; 4]; 4], Vec<u64>)> {
        let nodes = |submap: &voxelastic::atlas::Submap| submap.scans().iter().map(|scan| scan.node).collect();
        self.content.atlas.submaps().iter().map(|submap| (submap.id(), arrays::matrix_of_pose(&submap.t_map_submap()), nodes(submap))).collect()
    }

    /// Smallest and largest coordinates of what was observed, map frame; none for an empty map.
    fn bounds(&self, py: Python<'_>) -> PyResult<Option<([f32; 3], [f32; 3])>> {
        let content = &self.content;
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
        shells: bool,
    ) -> PyResult<Bound<'py, PyTuple>> {
        let content = Arc::clone(&self.content);
        let options = MeshOptions { min_weight, lod, close_gaps, keep_all };
        let pool = job::shared_pool()?;
        let mesh = job::run(py, move || pool.install(|| content.mesh(&surface, &options, shells)))?;
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
        let content = &self.content;
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
        let answers = match points.cast::<PyArray2<f64>>() {
            Ok(points) => self.answer(py, arrays::rows(&points.try_readonly()?)?),
            Err(_) => self.answer(py, arrays::rows(&points.cast::<PyArray2<f32>>()?.try_readonly()?)?),
        }?;
        PyTuple::new(
            py,
            [
                PyArray1::from_vec(py, answers.distances).into_any(),
                arrays::from_rows(py, answers.gradients)?.into_any(),
                PyArray1::from_vec(py, answers.states).into_any(),
            ],
        )
    }
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

/// What is known about some points: signed distances or NaN, gradients, states.
struct Answers {
    distances: Vec<f32>,
    gradients: Vec<[f32; 3]>,
    states: Vec<u8>,
}

impl Map {
    /// Its submaps.
    pub fn atlas(&self) -> &Atlas {
        &self.content.atlas
    }

    /// Its content, for work that may outlive a call.
    pub fn share(&self) -> Arc<Content> {
        Arc::clone(&self.content)
    }

    fn answer<T: Copy + Into<f64> + Sync>(&self, py: Python<'_>, points: &[[T; 3]]) -> PyResult<Answers> {
        let atlas = &self.content.atlas;
        let pool = job::shared_pool()?;
        let (surfaces, space) = (DistanceQuery::new(atlas), atlas.query());
        let mut all = Answers { distances: vec![f32::NAN; points.len()], gradients: vec![[0.0; 3]; points.len()], states: vec![0; points.len()] };
        let parts = all
            .distances
            .chunks_mut(QUERIES_AT_ONCE)
            .zip(all.gradients.chunks_mut(QUERIES_AT_ONCE))
            .zip(all.states.chunks_mut(QUERIES_AT_ONCE))
            .zip(points.chunks(QUERIES_AT_ONCE));
        for (((distances, gradients), states), points) in parts {
            let answer = || {
                let places = distances.par_iter_mut().zip(gradients).with_min_len(QUERIES_PER_TASK);
                places.zip(surfaces.sample_many(points)).for_each(|((distance, gradient), sample)| {
                    if let Some(sample) = sample {
                        (*distance, *gradient) = (sample.distance, sample.gradient);
                    }
                });
                if !space.is_empty() {
                    let found = space.states(points);
                    states.par_iter_mut().zip(found).with_min_len(QUERIES_PER_TASK).for_each(|(state, found)| *state = number_of(found));
                }
            };
            job::run_short(py, || pool.install(answer))?;
            py.check_signals()?;
        }
        Ok(all)
    }
}

/// The numbers of `voxelastic.State`.
pub fn number_of(state: State) -> u8 {
    match state {
        State::Unknown => 0,
        State::Free => 1,
        State::Occupied => 2,
    }
}
