//! One surface of several submaps: with drift between them, with wrong poses, whole and tile by tile, while the map grows and bends.

use std::collections::BTreeMap;
use voxelastic::atlas::{Atlas, Submap};
use voxelastic::event::{Event, Scan};
use voxelastic::meshing::{SurfaceChanges, SurfaceTiles, TileKey, TileMaker};
use voxelastic::surface::{Mesh, MeshOptions};
use voxelastic::{Cloud, Mapper, Pose, Settings};

const VOXEL: f32 = 0.1;
/// Half extents of the hall.
const HALL: [f64; 3] = [12.0, 6.0, 3.0];

/// A hall, seen from `x` metres along it.
fn hall(x: f64) -> Cloud {
    let mut points = Vec::new();
    for row in 0..48 {
        for column in 0..720 {
            let (elevation, azimuth) = ((f64::from(row) - 23.5) * 0.03, f64::from(column) * std::f64::consts::TAU / 720.0);
            let d = [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()];
            let along = |side: f64, c: f64| if c.abs() < 1e-9 { f64::INFINITY } else { side / c.abs() };
            let range = along(HALL[1], d[1]).min(along(HALL[2], d[2])).min(along(HALL[0] - x * d[0].signum(), d[0]));
            points.push(d.map(|c| (c * range) as f32));
        }
    }
    Cloud::from_points(points)
}

fn mapper() -> Mapper {
    Mapper::new(Settings { voxel_size: VOXEL, ..Settings::default() }).unwrap()
}

fn scan(node: u64, x: f64) -> Event {
    Event::Scan(Scan { node, time: node as f64, t_map_lidar: Pose::translation(x, 0.0, 0.0), cloud: hall(x) })
}

/// A submap of the hall, seen from several places.
fn submap(id: u32, places: &[f64]) -> Submap {
    let mut mapper = mapper();
    places.iter().enumerate().for_each(|(i, x)| {
        mapper.handle(scan(i as u64, *x)).unwrap();
    });
    mapper.finish();
    mapper.atlas().submaps()[0].clone().with_id(id)
}

/// The hall in two submaps, the second of which lies wrong by `t_true_second`.
fn two(t_true_second: Pose) -> Atlas {
    let [first, mut second] = [submap(0, &[0.0, 1.0]), submap(1, &[0.5, -1.0])];
    second.set_pose(t_true_second * second.t_map_submap());
    Atlas::from_submaps(VOXEL, vec![first, second])
}

fn area(mesh: &Mesh) -> f64 {
    let corner = |v: u32| nalgebra::Vector3::from(mesh.positions[v as usize].map(f64::from));
    mesh.triangles.iter().map(|t| 0.5 * (corner(t[1]) - corner(t[0])).cross(&(corner(t[2]) - corner(t[0]))).norm()).sum()
}

/// Distance of a point from the walls of a hall whose middle is at `middle`.
fn from_walls(p: [f32; 3], middle: [f64; 3]) -> f64 {
    (0..3).map(|k| ((f64::from(p[k]) - middle[k]).abs() - HALL[k]).abs()).fold(f64::MAX, f64::min)
}

fn share(mesh: &Mesh, is: impl Fn([f32; 3]) -> bool) -> f64 {
    mesh.positions.iter().filter(|p| is(**p)).count() as f64 / mesh.positions.len() as f64
}

#[test]
fn drift_of_a_few_voxels_leaves_one_surface_between_the_two() {
    let one = two(Pose::identity()).fused_mesh(&MeshOptions::default());
    let drift = Pose::new(nalgebra::Vector3::new(0.15, 0.28, -0.2), nalgebra::Vector3::new(0.004, 0.0, 0.006));
    let atlas = two(drift);
    let bent = atlas.fused_mesh(&MeshOptions::default());
    let [pair] = bent.pairs[..] else { panic!("{:?}", bent.pairs) };
    assert!(pair.submaps == [0, 1] && pair.matched * 10 > pair.places * 7, "{pair:?}");
    assert!((1.3..3.0).contains(&pair.apart) && pair.left < 0.5, "{pair:?}");
    // As much surface as without drift, and as all scans in one submap make. Of the shells, what both submaps have is gone once: each alone has some two thirds of the
    // surface, because their rows of points are farther apart than voxels where they are far away.
    let together = area(&Atlas::from_submaps(VOXEL, vec![submap(0, &[0.0, 1.0, 0.5, -1.0])]).mesh(&MeshOptions::default()));
    let [whole, drifted, shells] = [area(&one.mesh), area(&bent.mesh), area(&atlas.unfused_mesh(&MeshOptions::default()))];
    assert!((whole / together - 1.0).abs() < 0.01 && (drifted / whole - 1.0).abs() < 0.02, "{together} {whole} {drifted} m2");
    let alone = |submap: &Submap| area(&Atlas::from_submaps(VOXEL, vec![submap.clone()]).unfused_mesh(&MeshOptions::default()));
    let twice = atlas.submaps().iter().map(alone).sum::<f64>() - together;
    assert!(twice > 0.3 * together && ((shells - drifted) / twice - 1.0).abs() < 0.05, "{twice} m2 twice, {shells} instead of {drifted} m2");
    // In the middle of both: within a voxel where one of the two alone would be up to three away.
    let middle = drift.translation.vector * 0.5;
    assert!(share(&bent.mesh, |p| from_walls(p, middle.into()) < 0.1) > 0.95);
    assert!(bent.agreement.refused * 30 < bent.agreement.merged, "{:?}", bent.agreement);
}

#[test]
fn poses_that_are_wrong_by_metres_are_said_and_pull_nothing() {
    let wrong = two(Pose::translation(0.0, 5.0, 0.0)).fused_mesh(&MeshOptions::default());
    let [pair] = wrong.pairs[..] else { panic!("{:?}", wrong.pairs) };
    // Floor and ceiling lie on each other, walls do not.
    assert!(pair.places > 500 && pair.matched * 4 < pair.places * 3, "{pair:?}");
    assert!(share(&wrong.mesh, |p| from_walls(p, [0.0; 3]).min(from_walls(p, [0.0, 5.0, 0.0])) < 0.1) > 0.98, "no smear");
}

#[test]
fn submaps_that_are_apart_empty_or_far_away_are_fused_without_trouble() {
    let alone = submap(0, &[0.0]);
    let expected = Atlas::from_submaps(VOXEL, vec![alone.clone()]).fused_mesh(&MeshOptions::default());
    assert!(expected.pairs.is_empty() && expected.agreement.merged == 0);
    let mut far = submap(2, &[0.0]);
    far.set_pose(Pose::translation(3000.0, -2000.0, 0.0));
    let empty = Submap::new(1, VOXEL, Pose::identity());
    let one = Atlas::from_submaps(VOXEL, vec![alone, empty, far]).fused_mesh(&MeshOptions::default());
    assert!(one.pairs.is_empty() && one.agreement.merged == 0 && one.agreement.refused == 0);
    assert!((area(&one.mesh) / area(&expected.mesh) - 2.0).abs() < 0.05);
    assert!(share(&one.mesh, |p| from_walls(p, [0.0; 3]).min(from_walls(p, [3000.0, -2000.0, 0.0])) < 0.1) > 0.98);
}

#[test]
fn the_mesh_does_not_depend_on_the_number_of_threads() {
    let drifted = two(Pose::translation(0.0, 0.2, 0.0));
    let mesh = |n: usize| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap().install(|| drifted.mesh(&MeshOptions::default()));
    assert!(mesh(1) == mesh(3) && mesh(1).triangles.len() > 10_000);
}

#[test]
fn colours_of_several_submaps_reach_the_surface() {
    let coloured = |id: u32, rgb: [u8; 3]| {
        let (mut mapper, mut cloud) = (mapper(), hall(0.0));
        cloud.colours = Some(vec![rgb; cloud.points.len()]);
        mapper.handle(Event::Scan(Scan { node: 0, time: 0.0, t_map_lidar: Pose::identity(), cloud })).unwrap();
        mapper.finish();
        mapper.atlas().submaps()[0].clone().with_id(id)
    };
    let atlas = Atlas::from_submaps(VOXEL, vec![coloured(0, [200, 0, 0]), coloured(1, [0, 0, 200])]);
    let mesh = atlas.mesh(&MeshOptions::default());
    let mixed = mesh.colours.iter().filter(|c| c[0].abs_diff(100) < 3 && c[1] == 0 && c[2].abs_diff(100) < 3).count();
    assert!(mesh.colours.len() == mesh.positions.len() && mixed * 10 > 8 * mesh.colours.len(), "{mixed} of {}", mesh.colours.len());
}

/// Triangles by the bits of their corners, in an order of their own.
fn triangles<'a>(meshes: impl IntoIterator<Item = &'a Mesh>) -> Vec<[[u32; 3]; 3]> {
    let of = |mesh: &Mesh| -> Vec<[[u32; 3]; 3]> {
        let turned = |t: &[u32; 3]| {
            let corners = t.map(|v| mesh.positions[v as usize].map(f32::to_bits));
            let first = (0..3).min_by_key(|&i| corners[i]).unwrap();
            [0, 1, 2].map(|k| corners[(first + k) % 3])
        };
        mesh.triangles.iter().map(turned).collect()
    };
    let mut all: Vec<_> = meshes.into_iter().flat_map(of).collect();
    all.sort_unstable();
    all
}

#[test]
fn the_surface_tile_by_tile_is_the_whole_one() {
    let drift = Pose::new(nalgebra::Vector3::new(0.15, 0.28, -0.2), nalgebra::Vector3::new(0.004, 0.0, 0.006));
    let mut single = Atlas::from_submaps(VOXEL, vec![submap(0, &[0.0, 1.0])]);
    single.submap_mut(0).unwrap().set_pose(drift);
    for (atlas, keep_all) in [(two(drift), false), (two(drift), true), (single, false), (Atlas::new(VOXEL), false)] {
        let options = MeshOptions { keep_all, ..MeshOptions::default() };
        let whole = atlas.fused_mesh(&options);
        let surface = SurfaceTiles::new(&atlas, options);
        let meshes: Vec<Mesh> = surface.batches(surface.tiles()).into_iter().flat_map(|batch| surface.meshes(batch)).collect();
        assert!(meshes.len() == surface.tiles().len() && (atlas.submaps().is_empty() || meshes.len() > 3));
        assert!(triangles(&meshes) == triangles([&whole.mesh]) && surface.small_components() == whole.small_components);
        assert_eq!((surface.triangles(), surface.is_empty()), (whole.mesh.triangles.len() as u64, whole.mesh.triangles.is_empty()));
        for (tile, mesh) in surface.tiles().iter().zip(&meshes) {
            let (low, high) = surface.bounds(*tile);
            assert!(mesh.positions.iter().all(|p| (0..3).all(|k| low[k] < f64::from(p[k]) && f64::from(p[k]) < high[k])));
            assert!(mesh == &surface.meshes(&[*tile])[0], "made alone");
        }
        let (low, high) = surface.height_range();
        let between = whole.mesh.positions.iter().filter(|p| (low - VOXEL..=high + VOXEL).contains(&p[2])).count();
        assert!(between as f64 >= 0.98 * whole.mesh.positions.len() as f64, "{low} {high}");
    }
}

#[test]
fn the_surface_in_a_box_is_that_of_the_whole_there() {
    let drift = Pose::new(nalgebra::Vector3::new(0.15, 0.28, -0.2), nalgebra::Vector3::new(0.004, 0.0, 0.006));
    let atlas = two(drift);
    let whole = atlas.mesh(&MeshOptions::default());
    for (low, high) in [([-2.0, -7.0, -4.0], [4.0, 1.0, 4.0]), ([11.0, -9.0, -9.0], [40.0, 9.0, 9.0])] {
        let part = SurfaceTiles::within(&atlas, MeshOptions::default(), low, high);
        let made = part.meshes(part.tiles());
        let is_inside = |t: &[[u32; 3]; 3]| t.iter().all(|p| (0..3).all(|k| (low[k]..high[k]).contains(&f64::from(f32::from_bits(p[k])))));
        let [here, expected] = [triangles(&made), triangles([&whole])].map(|all| all.into_iter().filter(is_inside).collect::<Vec<_>>());
        assert!(expected.len() > 1000 && here == expected, "{} {}", here.len(), expected.len());
        assert!(made.iter().map(|mesh| mesh.triangles.len()).sum::<usize>() < whole.triangles.len(), "elsewhere nothing is made");
    }
    let nowhere = SurfaceTiles::within(&atlas, MeshOptions::default(), [100.0; 3], [110.0; 3]);
    assert!(nowhere.tiles().is_empty());
}

/// Keeps the tiles of a map up to date, all on one thread.
struct Live {
    changes: SurfaceChanges,
    maker: TileMaker,
    tiles: BTreeMap<TileKey, Mesh>,
}

impl Live {
    fn new(options: &MeshOptions) -> Self {
        Self { changes: SurfaceChanges::default(), maker: TileMaker::new(options.clone()), tiles: BTreeMap::new() }
    }

    fn is_behind(&self) -> bool {
        self.changes.waiting().next().is_some()
    }

    /// Makes the tiles that wait, at most `most`.
    fn make(&mut self, atlas: &Atlas, most: usize) {
        let some: Vec<TileKey> = self.changes.waiting().take(most).collect();
        let made = self.maker.make(&self.changes.gather(atlas, &some));
        self.changes.wait_for(&made.again);
        self.tiles.extend(made.meshes);
    }

    /// Makes all of them, `most` at a time, and forgets those without a surface.
    fn catch_up(&mut self, atlas: &Atlas, most: usize) {
        while self.is_behind() {
            self.make(atlas, most);
        }
        self.tiles.retain(|_, mesh| !mesh.triangles.is_empty());
    }
}

/// All tiles with a surface, made anew.
fn all_tiles(atlas: &Atlas, options: &MeshOptions) -> BTreeMap<TileKey, Mesh> {
    let mut live = Live::new(options);
    live.changes.note(atlas);
    live.make(atlas, usize::MAX);
    live.tiles.retain(|_, mesh| !mesh.triangles.is_empty());
    live.tiles
}

#[test]
fn tiles_made_a_few_at_a_time_become_those_of_the_map() {
    let options = MeshOptions { keep_all: true, ..MeshOptions::default() };
    let (mut mapper, mut live) = (mapper(), Live::new(&options));
    for (node, x) in [0.0, 0.5, 1.0, -3.0, -3.5].into_iter().enumerate() {
        mapper.handle(scan(node as u64, x)).unwrap();
        live.changes.note(mapper.atlas());
        live.make(mapper.atlas(), 7);
        assert!(live.is_behind(), "more than seven tiles change");
    }
    live.catch_up(mapper.atlas(), 5);
    live.changes.note(mapper.atlas());
    assert!(!live.is_behind(), "nothing has changed");
    assert!(live.tiles.len() > 20 && live.tiles == all_tiles(mapper.atlas(), &options));
    // A place in the hall is in the tile that has its surface.
    let floor = live.changes.tile_at([1.0, 0.5, -HALL[2] as f32]).unwrap();
    assert!(live.tiles[&floor].positions.iter().any(|p| (p[2] + HALL[2] as f32).abs() < VOXEL));
    let threads = |n: usize| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap().install(|| all_tiles(mapper.atlas(), &options));
    assert!(threads(1) == threads(3));
}

#[test]
fn tiles_are_made_on_another_thread_while_scans_go_on() {
    let options = MeshOptions { keep_all: true, ..MeshOptions::default() };
    let (mut mapper, mut changes) = (mapper(), SurfaceChanges::default());
    let (mut maker, mut tiles) = (Some(TileMaker::new(options.clone())), BTreeMap::new());
    let mut is_over = false;
    let mut places = [0.0, 0.5, 1.0, -3.0, -3.5, 2.0].into_iter().enumerate();
    while !is_over {
        let some: Vec<TileKey> = changes.waiting().take(9).collect();
        let (work, mut own) = (changes.gather(mapper.atlas(), &some), maker.take().unwrap());
        let thread = std::thread::spawn(move || (own.make(&work), own));
        // The map changes while they are made.
        if let Some((node, x)) = places.next() {
            mapper.handle(scan(node as u64, x)).unwrap();
            changes.note(mapper.atlas());
        }
        let (made, own) = thread.join().unwrap();
        maker = Some(own);
        changes.wait_for(&made.again);
        tiles.extend(made.meshes);
        is_over = changes.waiting().next().is_none();
    }
    assert!(places.next().is_none());
    tiles.retain(|_, mesh| !mesh.triangles.is_empty());
    assert!(tiles == all_tiles(mapper.atlas(), &options));
}

#[test]
fn a_map_that_does_not_change_any_more_ends_as_its_mesh() {
    let drift = Pose::new(nalgebra::Vector3::new(0.15, 0.28, -0.2), nalgebra::Vector3::new(0.004, 0.0, 0.006));
    let atlas = two(drift);
    for keep_all in [true, false] {
        let options = MeshOptions { keep_all, ..MeshOptions::default() };
        let mut live = Live::new(&options);
        live.changes.note(&atlas);
        live.make(&atlas, usize::MAX);
        let before = triangles(live.tiles.values());
        live.changes.settle(&atlas);
        live.catch_up(&atlas, 13);
        let expected = triangles([&atlas.mesh(&options)]);
        assert!(before != expected && triangles(live.tiles.values()) == expected, "{keep_all}");
    }
}

#[test]
fn what_moves_waits_and_nothing_else_does() {
    let [first, mut second] = [submap(0, &[0.0]), submap(1, &[0.0])];
    let [near, farther] = [60.0, 90.0].map(|x| Pose::translation(x, 0.0, 0.0));
    second.set_pose(near);
    let mut atlas = Atlas::from_submaps(VOXEL, vec![first, second]);
    let options = MeshOptions { keep_all: true, ..MeshOptions::default() };
    let mut live = Live::new(&options);
    live.changes.note(&atlas);
    live.make(&atlas, usize::MAX);
    // Where nothing is bent, it is the surface of the map.
    assert!(triangles(live.tiles.values()) == triangles([&atlas.mesh(&options)]));
    for step in 0..3 {
        match step {
            0 => atlas.submap_mut(1).unwrap().set_pose(farther),
            // A correction of its scans bends it.
            1 => {
                let moved = atlas.submaps()[1].scans().iter().map(|scan| scan.t_submap_lidar * Pose::translation(0.0, 0.3, 0.0)).collect();
                *atlas.submap_mut(1).unwrap() = atlas.submaps()[1].clone().with_corrected(moved);
            }
            _ => atlas = Atlas::from_submaps(VOXEL, vec![atlas.submaps()[0].clone()]),
        }
        live.changes.note(&atlas);
        let waiting: Vec<TileKey> = live.changes.waiting().collect();
        assert!(!waiting.is_empty() && waiting.iter().all(|tile| live.changes.corner(*tile)[0] > 30.0), "tiles of the other submap in step {step}");
        live.catch_up(&atlas, 11);
        assert!(live.tiles == all_tiles(&atlas, &options), "step {step}");
    }
    assert!(live.tiles.keys().all(|tile| live.changes.corner(*tile)[0] < 30.0), "a submap that is gone takes its surface along");
}

#[test]
fn coarse_tiles_fit_together() {
    let atlas = two(Pose::translation(0.0, 0.05, 0.0));
    // Edges at which one triangle ends and no other begins.
    let open = |lod: usize| {
        let tiles = all_tiles(&atlas, &MeshOptions { lod, ..MeshOptions::default() });
        let mut edges: BTreeMap<[[u32; 3]; 2], i32> = BTreeMap::new();
        let place = |mesh: &Mesh, v: u32| mesh.positions[v as usize].map(f32::to_bits);
        for (mesh, t) in tiles.values().flat_map(|mesh| mesh.triangles.iter().map(move |t| (mesh, t))) {
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])].map(|(a, b)| (place(mesh, a), place(mesh, b))) {
                *edges.entry([a.min(b), a.max(b)]).or_default() += if a < b { 1 } else { -1 };
            }
        }
        (edges.values().filter(|sum| **sum != 0).count(), tiles.values().map(|mesh| mesh.triangles.len()).sum::<usize>())
    };
    let [full, half, least] = [0, 1, 3].map(open);
    assert!(full.0 >= half.0 && half.0 >= least.0, "{full:?} {half:?} {least:?}");
    assert!(full.1 > 2 * half.1 && half.1 > least.1, "{full:?} {half:?} {least:?}");
}
