//! The viewer's page in a browser: the map grows, bends, and comes back after the connection was lost.
//!
//! Skipped where neither Chromium nor Chrome is installed.

use std::sync::Arc;
use std::time::{Duration, Instant};
use voxelastic::event::{Edge, Event, Scan};
use voxelastic::meshing::{SurfaceChanges, TileMaker};
use voxelastic::surface::MeshOptions;
use voxelastic::{Cloud, Mapper, Pose, Settings};
use voxelastic_live::publisher::{Publisher, ShownScan};
use voxelastic_live::scene::Scene;
use voxelastic_live::viewer::Viewer;
use voxelastic_testing::{PATIENCE, Page};

/// A corridor of 4 x 3 m along x, seen from `x` metres along it.
fn corridor(x: f64) -> Cloud {
    let mut points = Vec::new();
    for row in 0..32 {
        for column in 0..720 {
            let (elevation, azimuth) = ((f64::from(row) - 15.5) * 0.04, f64::from(column) * std::f64::consts::TAU / 720.0);
            let d = [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()];
            let along = |side: f64, c: f64| if c.abs() < 1e-9 { f64::INFINITY } else { side / c.abs() };
            let range = along(2.0, d[1]).min(along(1.5, d[2])).min(along(20.0 - x * d[0].signum(), d[0]));
            points.push(d.map(|c| (c * range) as f32));
        }
    }
    Cloud::from_points(points)
}

/// The mapper and what tells the page about it.
struct Node {
    mapper: Mapper,
    publisher: Publisher,
}

impl Node {
    fn scan(&mut self, node: u64) {
        let (x, time) = (1.0 * node as f64, 0.1 * node as f64);
        let cloud = corridor(x);
        let shown = ShownScan::of(&cloud, time);
        self.mapper.handle(Event::Scan(Scan { node, time, t_map_lidar: Pose::translation(x, 0.0, 0.0), cloud })).unwrap();
        self.publisher.note(&self.mapper, Some(&shown));
        self.publisher.step(self.mapper.atlas());
    }

    /// Waits until all tiles were made.
    fn settle(&mut self) {
        let begin = Instant::now();
        while self.publisher.is_behind() {
            assert!(begin.elapsed() < PATIENCE, "the surface is not made");
            self.publisher.step(self.mapper.atlas());
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    fn event(&mut self, event: Event) {
        self.mapper.handle(event).unwrap();
        self.publisher.note(&self.mapper, None);
    }
}

const COLOURS: &str = "(() => {
    const { canvas } = voxelastic.view, flat = document.createElement('canvas');
    [flat.width, flat.height] = [canvas.width, canvas.height];
    const pen = flat.getContext('2d');
    pen.drawImage(canvas, 0, 0);
    return new Set(new Uint32Array(pen.getImageData(0, 0, flat.width, flat.height).data.buffer)).size;
})()";

#[test]
fn the_map_grows_bends_and_comes_back() {
    let settings = Settings { lambda_odom: 4.0, voxel_size: 0.1, ..Settings::default() };
    let scene = Arc::new(Scene::default());
    let mut node = Node { mapper: Mapper::new(settings).unwrap(), publisher: Publisher::new(Arc::clone(&scene), 0) };
    node.scan(0);
    node.settle();
    let viewer = Viewer::start(Arc::clone(&scene), "corridor", ([127, 0, 0, 1], 0).into(), Vec::new(), None).unwrap();
    let profile = tempfile::tempdir().unwrap();
    let address = viewer.address();
    let Some(mut page) = Page::open(&format!("http://{address}/"), profile.path()) else { return };

    // It was there before the page, and grows.
    page.wait("window.voxelastic !== undefined && voxelastic.view.triangles > 0");
    let first = page.value("voxelastic.view.triangles").as_f64().unwrap();
    (1..12).for_each(|k| node.scan(k));
    node.settle();
    page.wait("[...voxelastic.view.parts.values()].flat().length === 12");
    page.wait(&format!("voxelastic.view.submaps.size >= 2 && voxelastic.view.triangles > 1.5 * {first}"));
    page.wait("document.getElementById('stage').dataset.ready === 'yes'");
    page.wait(&format!("({COLOURS}) > 200"));
    let robot = page.value("voxelastic.view.robotPose()");
    assert!((robot[0].as_f64().unwrap() - 11.0).abs() < 1e-3, "{robot}");

    // What is far is drawn with fewer triangles, what is out of the picture not at all, and what is near with all.
    page.wait(&format!("voxelastic.seen.goal > 0n && voxelastic.seen.goal <= {}n", scene.news(Default::default(), usize::MAX).have.tiles));
    let drawn = |page: &mut Page, camera: &str| {
        let drawn = format!(
            "(async () => {{
                const {{ view }} = voxelastic;
                while (view.unfinished) await new Promise((done) => setTimeout(done, 5));
                view.follow = false;
                Object.assign(view.camera, {camera});
                view.render(true);
                return view.drawn;
            }})()"
        );
        let drawn = page.value(&drawn);
        [drawn["tiles"].as_f64().unwrap(), drawn["triangles"].as_f64().unwrap()]
    };
    let all = page.value("[voxelastic.view.tiles.size, voxelastic.view.triangles]");
    let all = [all[0].as_f64().unwrap(), all[1].as_f64().unwrap()];
    let whole = drawn(&mut page, "{ target: [5, 0, 0], distance: 500, yaw: -0.9, pitch: 0.7 }");
    assert!(whole[0] == all[0] && whole[1] < 0.5 * all[1] && whole[1] > 0.0, "all tiles with fewer triangles: {whole:?} of {all:?}");
    let near = drawn(&mut page, "{ target: [11, 1.5, 0], distance: 3, yaw: -1.6, pitch: 0.1 }");
    assert!(near[0] < all[0] && near[0] > 0.0, "some tiles: {near:?} of {all:?}");
    let away = drawn(&mut page, "{ target: [100, 0, 0], distance: 1, yaw: 3.14, pitch: 0 }");
    assert_eq!(away, [0.0, 0.0], "the map is behind the camera");
    drawn(&mut page, "{ target: [5, 0, 0], distance: 30, yaw: -0.9, pitch: 0.7 }");
    page.value("voxelastic.view.follow = true");

    // It bends: poses are sent at once, and no tile with them: each moves with the submap that has most of it.
    page.wait(&format!("voxelastic.seen.tiles === {}n", scene.news(Default::default(), usize::MAX).have.tiles));
    let tiles = page.value("String(voxelastic.seen.tiles)");
    let moved: Vec<(u64, Pose)> = (6..12).map(|k| (k, Pose::translation(k as f64, 3.0, 0.0))).collect();
    let last = moved[5].1;
    node.event(Event::LoopEdge(Edge { from: 0, to: 11, t_from_to: last, information: None }));
    node.publisher.add_loop(0, 11);
    node.event(Event::PoseUpdate(moved));
    page.wait("[...voxelastic.view.submaps.values()].some((pose) => pose[1] === 3)");
    page.wait("voxelastic.view.loopPlaces.length === 1");
    page.wait("Math.abs(voxelastic.view.robotPose()[1] - 3) < 1e-3");
    page.wait("[...voxelastic.view.tiles.values()].some((tile) => Math.abs(tile.matrix[13] - tile.origin[1] - 3) < 1e-3)");
    assert_eq!(page.value("String(voxelastic.seen.tiles)"), tiles, "no tile was sent again");

    // Then the tiles where a submap was or is are made again, and it is one surface: as many triangles as all tiles of the map have, but for small components.
    node.settle();
    let mut whole = SurfaceChanges::default();
    whole.note(node.mapper.atlas());
    let all: Vec<_> = whole.waiting().collect();
    let made = TileMaker::new(MeshOptions::default()).make(&whole.gather(node.mapper.atlas(), &all));
    let expected: usize = made.meshes.iter().map(|(_, mesh)| mesh.triangles.len()).sum();
    page.wait(&format!("Math.abs(voxelastic.view.triangles / {expected} - 1) < 0.005"));

    // The connection is lost and comes back, with another server at the same place.
    let all = page.value("voxelastic.view.triangles");
    drop(viewer);
    page.wait("document.getElementById('state').dataset.state === 'lost'");
    let _viewer = Viewer::start(scene, "corridor", address, Vec::new(), None).unwrap();
    page.wait("document.getElementById('state').dataset.state === 'connected' && voxelastic.seen.connections === 2");
    page.wait(&format!("voxelastic.view.triangles === {all}"));
    node.scan(12);
    node.settle();
    page.wait("voxelastic.view.scan.scans === 13");
}
