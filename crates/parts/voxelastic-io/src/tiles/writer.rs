//! Writing a tileset, leaf by leaf.

use super::part::Part;
use super::pyramid::{coarser, snap, weld};
use super::tileset::{CONTENT, Node, TILESET, around};
use super::{Cell, STEPS_PER_VOXEL};
use crate::file::write_atomically;
use crate::mesh_io::{Lattice, MeshRef, tile_glb};
use crate::{Error, Origin, Result};
use serde_json::json;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use voxelastic::surface::Mesh;
use xxhash_rust::xxh3::xxh3_64;

/// Trees of this many levels are files of their own.
const LEVELS_PER_FILE: u8 = 4;

/// Writes the tiles of one map to a folder.
///
/// Leaves come in the order of their cells ([`Cell::order`]). A tile of a higher level is written when the first leaf beyond it comes.
#[derive(Debug)]
pub struct TilesetWriter {
    folder: PathBuf,
    voxel: f64,
    origin: Origin,
    /// Tiles whose parts are not all there, by level.
    open: BTreeMap<u8, Open>,
    last: Option<(u8, u64)>,
    report: TilesetReport,
}

/// What was written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct TilesetReport {
    /// Tiles of all levels.
    pub tiles: usize,
    /// Levels of detail.
    pub levels: usize,
    /// Triangles at full detail.
    pub triangles: usize,
    /// Bytes of all tiles and trees.
    pub bytes: u64,
    /// Files that were there already, from an earlier run.
    pub kept: usize,
}

/// A tile of which some parts are there.
#[derive(Debug)]
struct Open {
    cell: Cell,
    mesh: Mesh,
    numbers: HashMap<[u32; 3], u32>,
    children: Vec<Node>,
    files: Vec<String>,
    /// The mesh of a part that is the only one so far.
    only: Option<Part>,
}

impl TilesetWriter {
    /// A writer of the tiles of a map with finest voxels of `voxel` metres to a folder, which is made with the first tile if it is not there.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Unwritable`] if the folder has something else than tiles.
    pub fn create(folder: impl AsRef<Path>, voxel: f64) -> Result<Self> {
        let folder = folder.as_ref();
        if !folder.join(TILESET).exists() && folder.exists() {
            let mut entries = fs::read_dir(folder).map_err(|e| Error::io(folder, "list", e))?.flatten();
            if let Some(other) = entries.find(|entry| entry.file_name() != CONTENT) {
                let problem = format!("the folder has {} and no {TILESET}; choose another one", other.file_name().to_string_lossy());
                return Err(Error::unwritable(folder, problem));
            }
        }
        let origin = Origin::default();
        Ok(Self { folder: folder.to_owned(), voxel, origin, open: BTreeMap::new(), last: None, report: TilesetReport::default() })
    }

    /// For a map with an origin: viewers place the tiles there (the `transform` of the root), in double precision.
    #[must_use]
    pub fn with_origin(self, origin: Origin) -> Self {
        Self { origin, ..self }
    }

    /// Writes a tile of level 0: a mesh in the map frame, metres, with colours if it is to be coloured. One without triangles is left out.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Unwritable`] for leaves out of order.
    pub fn leaf(&mut self, cell: Cell, mut mesh: Mesh) -> Result<()> {
        if mesh.triangles.is_empty() {
            return Ok(());
        }
        snap(&mut mesh, self.voxel);
        self.report.triangles += mesh.triangles.len();
        let part = self.finished(cell, mesh, Vec::new(), Vec::new())?;
        self.part(part)
    }

    /// Takes a part that another writer has made; its files are in the folder, or will be.
    ///
    /// # Errors
    /// As for [`leaf`](Self::leaf).
    pub fn part(&mut self, part: Part) -> Result<()> {
        let place = (part.cell.level, part.cell.order());
        if self.last.is_some_and(|(level, order)| level == place.0 && order >= place.1) {
            return Err(Error::unwritable(&self.folder, "tiles have to come in the order of their cells, each once".to_owned()));
        }
        self.last = Some(place);
        self.add(part)
    }

    fn add(&mut self, part: Part) -> Result<()> {
        let parent = part.cell.parent();
        if self.open.get(&parent.level).is_some_and(|open| open.cell != parent)
            && let Some(complete) = self.open.remove(&parent.level)
        {
            let complete = self.close(complete)?;
            self.add(complete)?;
        }
        match self.open.get_mut(&parent.level) {
            None => {
                let open =
                    Open { cell: parent, mesh: Mesh::default(), numbers: HashMap::new(), children: Vec::new(), files: Vec::new(), only: Some(part) };
                self.open.insert(parent.level, open);
            }
            Some(_) => {
                let mut open = self.open.remove(&parent.level).ok_or_else(|| Error::unwritable(&self.folder, "a tile is lost".to_owned()))?;
                if let Some(first) = open.only.take() {
                    self.join(&mut open, first)?;
                }
                self.join(&mut open, part)?;
                self.open.insert(parent.level, open);
            }
        }
        Ok(())
    }

    /// Makes a part one of an open tile.
    fn join(&mut self, open: &mut Open, part: Part) -> Result<()> {
        weld(&mut open.mesh, &mut open.numbers, &part.mesh);
        let Part { cell, mut node, mut files, .. } = part;
        if cell.level > 0 && cell.level.is_multiple_of(LEVELS_PER_FILE) {
            let text = node.tileset("", serde_json::Value::Null, Origin::default());
            let file = self.write(cell, "json", text.as_bytes())?;
            files.push(file.clone());
            node = Node { file, children: Vec::new(), ..node };
        }
        open.children.push(node);
        open.files.extend(files);
        Ok(())
    }

    /// Simplifies and writes a tile that has all its parts.
    fn close(&mut self, mut open: Open) -> Result<Part> {
        if let Some(first) = open.only.take() {
            self.join(&mut open, first)?;
        }
        let mut mesh = open.mesh;
        coarser(&mut mesh, open.cell, self.voxel);
        self.finished(open.cell, mesh, open.children, open.files)
    }

    /// Writes the mesh of a tile.
    fn finished(&mut self, cell: Cell, mesh: Mesh, children: Vec<Node>, mut files: Vec<String>) -> Result<Part> {
        let step = self.voxel / STEPS_PER_VOXEL;
        // On the lattice, from which single precision is a little off.
        let own = around(mesh.positions.iter().map(|p| p.map(|c| (f64::from(c) / step).round() * step)).map(|p| (p, p)));
        let (min, max) = around(children.iter().map(|child| (child.min, child.max)).chain([own]));
        let lattice = Lattice { origin: own.0, step };
        let colours = (!mesh.colours.is_empty()).then_some(&mesh.colours[..]);
        let shown = MeshRef { positions: &mesh.positions, normals: &mesh.normals, colours, triangles: &mesh.triangles, ..MeshRef::default() };
        let file = self.write(cell, "glb", &tile_glb(&shown, &lattice))?;
        let error = if cell.level == 0 { 0.0 } else { self.voxel * f64::from(1u32 << cell.level) };
        files.push(file.clone());
        self.report.tiles += 1;
        self.report.levels = self.report.levels.max(usize::from(cell.level) + 1);
        Ok(Part { cell, mesh, node: Node { min, max, error, file, children }, files })
    }

    /// Writes a file with a name for its content, unless it is there.
    fn write(&mut self, cell: Cell, ending: &str, bytes: &[u8]) -> Result<String> {
        let [x, y, z] = cell.coordinates();
        let name = format!("{}-{x}-{y}-{z}-{:016x}.{ending}", cell.level, xxh3_64(bytes));
        let path = self.folder.join(CONTENT).join(&name);
        self.report.bytes += bytes.len() as u64;
        if path.metadata().is_ok_and(|there| there.len() == bytes.len() as u64) {
            self.report.kept += 1;
        } else {
            write_atomically(&path, |w| w.write_all(bytes))?;
        }
        Ok(name)
    }

    /// Ends with the tiles of `level`, which is above that of the leaves: the parts that a whole map is made of, in order. No tileset is written.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn parts(mut self, level: u8) -> Result<Vec<Part>> {
        let mut parts = Vec::new();
        while let Some((at, open)) = self.open.pop_first() {
            let part = self.close(open)?;
            if at >= level { parts.push(part) } else { self.add(part)? }
        }
        Ok(parts)
    }

    /// Writes the rest, then `tileset.json`, and removes tiles of an earlier run that are no longer needed. `title` is what viewers call the map. None if
    /// there was no leaf: then nothing is written.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn finish(mut self, title: &str) -> Result<Option<TilesetReport>> {
        let Some(root) = self.root()? else { return Ok(None) };
        let extras = json!({ "title": title, "voxel_m": self.voxel, "up": "z" });
        let text = root.node.tileset(&format!("{CONTENT}/"), extras, self.origin);
        write_atomically(&self.folder.join(TILESET), |w| w.write_all(text.as_bytes()))?;
        self.report.bytes += text.len() as u64;
        self.remove_others(&root.files);
        Ok(Some(self.report))
    }

    /// The tile that has all others below it.
    fn root(&mut self) -> Result<Option<Part>> {
        while let Some((_, open)) = self.open.pop_first() {
            let is_last = self.open.is_empty();
            match open {
                Open { only: Some(part), .. } if is_last => return Ok(Some(part)),
                open => {
                    let part = self.close(open)?;
                    if is_last {
                        return Ok(Some(part));
                    }
                    self.add(part)?;
                }
            }
        }
        Ok(None)
    }

    /// Removes tiles that are not among `files`. What cannot be removed only takes space.
    fn remove_others(&self, files: &[String]) {
        let needed: HashSet<&str> = files.iter().map(String::as_str).collect();
        let is_ours = |name: &str| name.ends_with(".glb") || name.ends_with(".json");
        for entry in fs::read_dir(self.folder.join(CONTENT)).into_iter().flatten().flatten() {
            let name = entry.file_name();
            if name.to_str().is_some_and(|name| is_ours(name) && !needed.contains(name)) {
                let _ = fs::remove_file(entry.path());
            }
        }
    }
}
