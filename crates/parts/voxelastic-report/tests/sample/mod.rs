//! A synthetic report: a hilly surface with a wall in two submaps, of which one was corrected.

use voxelastic_eval::DistanceStats;
use voxelastic_report::content::{Distances, Exploration, ExplorationStep, Fact, KnownShare, MovingPoints, Node, PlannedPath, Table};
use voxelastic_report::surface::{RootPose, Surface};
use voxelastic_report::{Correction, FORMAT, LoopEdge, RegistrationLog, Report, RunLog, ScanLog, TriedClosure};

/// Squares of the lawn along a side.
const N: u32 = 90;
const STEP: f32 = 0.2;

fn lawn(submap: u32, shift: f64) -> Surface {
    let height = |x: f32, y: f32| 0.6 * (x * 0.6).sin() * (y * 0.5).cos() + if (8.0..8.6).contains(&x) { 3.0 } else { 0.0 };
    let at = |i: u32| ((i % (N + 1)) as f32 * STEP, (i / (N + 1)) as f32 * STEP);
    let vertices = (N + 1) * (N + 1);
    let positions: Vec<[f32; 3]> = (0..vertices).map(at).map(|(x, y)| [x, y, height(x, y)]).collect();
    let slope = |x: f32, y: f32| [height(x - 0.1, y) - height(x + 0.1, y), height(x, y - 0.1) - height(x, y + 0.1), 0.2];
    let unit = |n: [f32; 3]| n.map(|c| c / n.iter().map(|c| c * c).sum::<f32>().sqrt());
    Surface {
        submap,
        colour: if submap == 0 { [38, 110, 180] } else { [226, 112, 46] },
        pose: RootPose([shift, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
        first_pose: Some(RootPose([shift * 1.1, 0.5 * shift.signum(), 0.0, 0.0, 0.0, 0.0, 1.0])),
        normals: positions.iter().map(|p| unit(slope(p[0], p[1]))).collect(),
        intensities: positions.iter().map(|p| (p[1] * 14.0) as u8).collect(),
        // One of both submaps was mapped with a camera.
        colours: if submap == 0 { positions.iter().map(|p| [(p[0] * 13.0) as u8, 90, (p[1] * 13.0) as u8]).collect() } else { Vec::new() },
        scales: positions.iter().map(|p| (p[0] / 5.0) as u8).collect(),
        errors: positions.iter().map(|p| p[0] * 0.006).collect(),
        triangles: (0..N * N).map(|i| i / N * (N + 1) + i % N).flat_map(|a| [[a, a + 1, a + N + 2], [a, a + N + 2, a + N + 1]]).collect(),
        positions,
        ..Surface::default()
    }
}

fn run() -> RunLog {
    let scans = 60u32;
    let column = |f: &dyn Fn(f64) -> f64| (0..scans).map(|i| f(f64::from(i))).collect::<Vec<f64>>();
    RunLog {
        format: FORMAT,
        threads: 2,
        total_s: 4.2,
        fusions: 1,
        scans: ScanLog {
            node: (0..u64::from(scans)).collect(),
            time_s: column(&|i| i),
            position: (0..scans).map(|i| [f64::from(i) * 0.6, 8.0 + (f64::from(i) * 0.2).sin(), 1.5]).collect(),
            wall_ms: column(&|i| 30.0 + 8.0 * (i * 0.4).sin() + 6.0),
            submaps: (0..scans).map(|i| 1 + i / 30).collect(),
            map_mb: column(&|i| 3.0 * i.sqrt()),
            rss_mb: column(&|i| 60.0 + i),
            ..ScanLog::default()
        },
        phases_ms: [("prepare", 6.0), ("tsdf_update", 22.0), ("occupancy_descend", 8.0)]
            .map(|(name, ms)| (name.to_owned(), column(&|i| ms + (i * 0.4).sin())))
            .into(),
        loops: vec![LoopEdge { from: 3, to: 55, after: 55, wall_ms: 0.25, ..LoopEdge::default() }],
        // Two of 62 scans were not registered.
        registrations: RegistrationLog {
            node: (0..62).collect(),
            score: (0..62).map(|i| if i == 20 || i == 21 { 0.0 } else { 0.6 + 0.1 * f64::from(i).sin() }).collect(),
            overlap: (0..62).map(|i| if i == 20 || i == 21 { 0.0 } else { 0.9 }).collect(),
            sigma_m: (0..62).map(|i| if i == 20 || i == 21 { 0.0 } else { 0.02 + 0.004 * f64::from(i) }).collect(),
            remark: (0..62).map(|i| if i == 20 || i == 21 { "too few returns".to_owned() } else { String::new() }).collect(),
        },
        closures: [("accepted", 0.004), ("free_space", 0.09)]
            .map(|(verdict, contradiction)| TriedClosure {
                from: 3,
                to: 55,
                verdict: verdict.into(),
                correlation: 0.7,
                overlap: Some(0.6),
                score: Some(0.4),
                contradiction: Some(contradiction),
                correction_m: 1.2,
            })
            .into(),
        corrections: vec![Correction { after: 55, wall_ms: 1.0, optimise_ms: Some(12.5), moved: 2, closed: 1, fusions: 1, newest: None }],
        ..RunLog::default()
    }
}

pub fn report() -> Report {
    let mut report = Report::titled("A lawn");
    report.subtitle = "made up".into();
    report.facts.push(Fact { label: "Scans".into(), value: "60".into(), ..Fact::default() });
    report.run = Some(run());
    report.voxel = Some(0.1);
    report.nodes = (0..60).map(|i| Node { node: i, position: [i as f64 * 0.6, 8.0, 1.5], submap: (i / 30) as u32 }).collect();
    report.surface = vec![lawn(0, 0.0), lawn(1, 18.5)];
    let errors: Vec<f32> = (0..2000).map(|i| (i as f32 * 0.37).sin().abs() * 0.08).collect();
    report.distances.push(Distances { name: "Accuracy".into(), stats: DistanceStats::new(&errors) });
    let row = |name: &str| vec![name.to_owned(), "1.2".to_owned()];
    let columns = vec!["field".to_owned(), "mean, cm".to_owned()];
    report.tables.push(Table { title: "Figures".into(), columns, rows: vec![row("TSDF"), row("occupancy")], ..Table::default() });
    report.planned_path = Some(PlannedPath {
        start: Some([1.0, 1.0, 1.0]),
        goal: Some([17.0, 16.0, 1.0]),
        path: vec![[1.0, 1.0, 1.0], [6.0, 12.0, 1.2], [17.0, 16.0, 1.0]],
        tree: vec![[[1.0, 1.0, 1.0], [4.0, 2.0, 1.0]], [[4.0, 2.0, 1.0], [7.0, 5.0, 1.0]]],
    });
    // A box that drives along the lawn.
    let of_box = |node: u64| {
        (0..600).map(move |i| [node as f32 * 0.3 + (i % 20) as f32 * 0.1, 5.0 + (i / 20 % 10) as f32 * 0.1, 1.0 + (i / 200) as f32 * 0.5])
    };
    report.moving = (5..15).map(|node| MovingPoints { node, submap: 0, points: of_box(node).collect() }).collect();
    // A robot that explores the lawn.
    let step = |i: u32| ExplorationStep {
        time_s: f64::from(i) * 2.0,
        distance_m: f64::from(i) * 1.5,
        position: [f64::from(i) * 1.5, 4.0, 1.5],
        frontier: (0..8).map(|k| ([f64::from(i) * 1.5 + 4.0, f64::from(k) * 2.0, 1.0], 4.0)).collect(),
        path: vec![[f64::from(i) * 1.5, 4.0, 1.5], [f64::from(i) * 1.5 + 3.0, 9.0, 1.5]],
    };
    report.exploration = Some(Exploration {
        moments: (0..4)
            .map(|i| KnownShare { time_s: f64::from(i) * 7.0, distance_m: f64::from(i) * 5.0, known_share: 0.2 + f64::from(i) * 0.25 })
            .collect(),
        steps: (0..11).map(step).collect(),
    });
    report.details.push(("voxel".into(), "0.1".into()));
    report
}
