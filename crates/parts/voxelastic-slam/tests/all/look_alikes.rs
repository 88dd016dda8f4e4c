//! How probable is it that a scan was taken where it seems to be? Weights for the model, and how true its probabilities are, on places that look alike.

use crate::common::logit::{Doubts, shares, weights_against_none, weights_among};
use crate::storeys::{STOREY, building, walk};
use voxelastic::event::{Event, Scan};
use voxelastic::geometry::PoseExt;
use voxelastic::sensor::preset_with_columns;
use voxelastic::surface::MeshOptions;
use voxelastic::{Cloud, Mapper, Pose, Settings};
use voxelastic_io::{OpenOptions, dataset};
use voxelastic_sim::random::Stream;
use voxelastic_sim::sensor::{Lidar, LidarSettings};
use voxelastic_sim::{PoseSource, SimOptions, Simulation, World, WorldBuilder};
use voxelastic_slam::loops::{Localiser, LocaliserSettings, Located};

/// A place is right within this distance of the truth, metres.
const RIGHT: f64 = 0.5;

/// A scan with its true pose.
type Seen = (Pose, Cloud);

/// A scan that was looked for in a map.
struct Sample {
    kind: &'static str,
    /// What belongs to it is fitted to, or held out.
    seed: u64,
    located: Vec<Located>,
    /// Which of them is right.
    right: Option<usize>,
    /// Whether the place was mapped.
    is_mapped: bool,
}

fn localiser(scans: &[Seen], voxel_size: f32) -> Localiser {
    let mut mapper = Mapper::new(Settings { voxel_size, ..Settings::default() }).unwrap();
    for (node, (t_map_lidar, cloud)) in (0..).zip(scans) {
        mapper.handle(Event::Scan(Scan { node, time: node as f64, t_map_lidar: *t_map_lidar, cloud: cloud.clone() })).unwrap();
    }
    let atlas = mapper.into_atlas();
    let viewpoints = atlas.submaps().iter().flat_map(|s| s.scans().iter().map(|scan| s.t_map_submap() * scan.t_submap_lidar)).collect();
    Localiser::new(atlas.unfused_mesh(&MeshOptions::default()).positions, viewpoints, LocaliserSettings::default())
}

fn looked_for(kind: &'static str, seed: u64, localiser: &mut Localiser, scans: &[Seen], is_mapped: bool) -> Vec<Sample> {
    let sample = |(truth, cloud): &Seen| {
        let located = localiser.locate_all(cloud, None);
        let right = located.iter().position(|l| is_mapped && l.t_map_lidar.translation_distance(truth) < RIGHT);
        Sample { kind, seed, located, right, is_mapped }
    };
    scans.iter().map(sample).collect()
}

/// Every second scan is mapped, the others are looked for; `others` were taken elsewhere.
fn every_second(kind: &'static str, seed: u64, scans: &[Seen], voxel: f32, others: &[Seen]) -> Vec<Sample> {
    let [mapped, held_out] = [0, 1].map(|first| scans.iter().skip(first).step_by(2).cloned().collect::<Vec<_>>());
    let mut localiser = localiser(&mapped, voxel);
    let mut samples = looked_for(kind, seed, &mut localiser, &held_out, true);
    samples.extend(looked_for("elsewhere", seed, &mut localiser, others, false));
    samples
}

fn simulated(world: &str, seed: u64, sensor: &str, columns: usize, scans: usize, spacing: f64) -> Vec<Seen> {
    let options =
        SimOptions { seed, sensor: sensor.into(), columns: Some(columns), scans: Some(scans), spacing, drift: 0.0, ..SimOptions::of(world) };
    let simulation = Simulation::new(options).unwrap();
    simulation.scans(PoseSource::Truth).map(|scan| (scan.t_map_lidar, scan.cloud)).collect()
}

fn recorded(name: &str, poses: &str) -> Option<Vec<Seen>> {
    let folder = voxelastic_testing::data(name)?;
    let drive = dataset::open(&folder, &OpenOptions { poses: Some(folder.join(poses)), ..OpenOptions::default() }).unwrap();
    Some(drive.scans().iter().map(|scan| (scan.t_map_lidar, drive.cloud(scan).unwrap())).collect())
}

fn seen(world: &World, poses: impl Iterator<Item = Pose>, seed: u64) -> Vec<Seen> {
    let lidar = Lidar::new(preset_with_columns("os0-64", 256).unwrap(), LidarSettings::default()).unwrap();
    poses.zip(0..).map(|(pose, k)| (pose, lidar.scan(world, |_| pose, &Stream::new(seed, &[k])))).collect()
}

/// Scans from about these poses.
fn near(poses: &[Pose], seed: u64, count: usize) -> Vec<Pose> {
    let mut random = Stream::new(seed, &[7]);
    let mut shifted = || {
        let at = poses[random.index(poses.len())];
        at * Pose::translation(random.range(-0.3, 0.3), random.range(-0.3, 0.3), 0.0)
            * Pose::rotation(nalgebra::Vector3::z() * random.range(0.0, 6.2))
    };
    (0..count).map(|_| shifted()).collect()
}

/// Both storeys of a building are mapped, or only the lower one, and scans of both are looked for.
fn storeys(seed: u64, differing: f64) -> Vec<Sample> {
    let (world, walk) = (building(seed, differing), walk());
    let is_low = |pose: &&Pose| pose.translation.z < 1.5;
    let [low, high]: [Vec<Pose>; 2] =
        [walk.iter().filter(is_low).copied().collect(), walk.iter().filter(|p| p.translation.z > STOREY + 1.3).copied().collect()];
    let scans = [near(&low, seed, 5), near(&high, seed + 1, 5)].map(|poses| seen(&world, poses.into_iter(), seed + 100));
    let mut mapped = [low, high].map(|poses| seen(&world, poses.into_iter().step_by(5), seed));
    let mut lower = localiser(&mapped[0], 0.1);
    mapped[0].append(&mut mapped[1].clone());
    let mut both = localiser(&mapped[0], 0.1);
    let mut samples = looked_for("storeys", seed, &mut both, &scans.concat(), true);
    samples.extend(looked_for("one storey", seed, &mut lower, &scans[0], true));
    samples.extend(looked_for("one storey", seed, &mut lower, &scans[1], false));
    samples
}

/// Rooms of 9 x 6 m, 30 m apart, that are alike by half a turn but for `differing` of their furniture, of which each has its own.
fn rooms(seed: u64, differing: f64, count: u64) -> (World, Vec<Pose>) {
    let mut world = WorldBuilder::new("rooms", seed);
    let mut poses = Vec::new();
    for room in 0..count {
        let x = 30.0 * room as f64;
        let mut put = |a: [f64; 3], b: [f64; 3]| world.cuboid([a[0] + x, a[1], a[2]], [b[0] + x, b[1], b[2]], 0.5);
        put([-4.7, -3.2, -0.2], [4.7, 3.2, 0.0]);
        put([-4.7, -3.2, 2.8], [4.7, 3.2, 3.0]);
        for (a, b) in [([-4.7, -3.2], [-4.5, 3.2]), ([4.5, -3.2], [4.7, 3.2]), ([-4.5, -3.2], [4.5, -3.0]), ([-4.5, 3.0], [4.5, 3.2])] {
            put([a[0], a[1], 0.0], [b[0], b[1], 2.8]);
        }
        let (mut common, mut own) = (Stream::new(seed, &[1]), Stream::new(seed, &[2, room]));
        for _ in 0..5 {
            for half_turned in [1.0, -1.0] {
                // The second of a pair is as the first, unless it is its own.
                let mut pair = common.fork(1);
                let is_own = own.uniform() < differing;
                let numbers: [f64; 4] = std::array::from_fn(|_| if is_own { own.uniform() } else { pair.uniform() });
                let [along, deep, wide, tall] = numbers;
                let (x, deep, half, tall) = (8.0 * along - 4.0, 0.3 + 0.4 * deep, 0.2 + 0.4 * wide, 0.6 + 1.4 * tall);
                let y = 3.0 - deep;
                put([half_turned * (x - half), half_turned * y, 0.0], [half_turned * (x + half), half_turned * 3.0, tall]);
            }
            common = common.fork(2);
        }
        let mut random = Stream::new(seed, &[3, room]);
        poses.extend((0..6).map(|_| {
            let turn = Pose::rotation(nalgebra::Vector3::z() * random.range(0.0, 6.2));
            Pose::translation(x + random.range(-3.0, 3.0), random.range(-1.5, 1.5), 1.2) * turn
        }));
    }
    (world.build().unwrap(), poses)
}

fn rooms_alike(seed: u64, differing: f64, count: u64) -> Vec<Sample> {
    let (world, poses) = rooms(seed, differing, count);
    let mut map = localiser(&seen(&world, poses.iter().copied(), seed), 0.1);
    looked_for("rooms", seed, &mut map, &seen(&world, near(&poses, seed, 3 * count as usize).into_iter(), seed + 100), true)
}

fn samples() -> Vec<Sample> {
    let mut samples = Vec::new();
    for seed in 0..10 {
        let differing = 0.1 + 0.1 * (seed % 10) as f64;
        samples.extend(storeys(seed, differing));
        samples.extend(rooms_alike(seed, differing, 1 + seed % 3));
    }
    let [street, mine] = ["street", "mine"].map(|world| simulated(world, 9, "os1-64", 512, 3, 2.0));
    for seed in 0..3 {
        // Few scans leave gaps.
        samples.extend(every_second("sparse", seed, &simulated("room", seed, "vlp-16", 900, 10, 0.6), 0.05, &[]));
        samples.extend(every_second("sparse", seed, &simulated("room", seed, "os1-64", 256, 10, 0.6), 0.05, &street));
        samples.extend(every_second("drive", seed, &simulated("street", seed, "os1-64", 512, 20, 2.0), 0.2, &mine));
        samples.extend(every_second("drive", seed, &simulated("campus", seed, "os1-64", 512, 30, 2.0), 0.2, &mine));
        samples.extend(every_second("drive", seed, &simulated("mine", seed, "os1-64", 512, 20, 2.0), 0.1, &street));
    }
    let drives = [recorded("hall", "poses.tum"), recorded("kitti00-street", "poses_groundtruth.txt")];
    if let [Some(hall), Some(street)] = drives {
        let some = |scans: &[Seen]| scans.iter().step_by(3).cloned().collect::<Vec<_>>();
        samples.extend(every_second("recorded", 0, &hall, 0.1, &some(&street)));
        samples.extend(every_second("recorded", 1, &street, 0.2, &some(&hall)));
    }
    samples
}

fn doubts(located: &Located) -> Doubts {
    [100.0 * located.fine_contradiction, 100.0 * located.beside]
}

/// The possible places of scans that have the right one among them, and which it is.
fn choices<'a>(samples: impl Iterator<Item = &'a Sample>) -> Vec<(Vec<Doubts>, usize)> {
    let choice = |sample: &Sample| {
        let right = sample.right.filter(|right| sample.located[*right].is_possible)?;
        let possible: Vec<usize> = (0..sample.located.len()).filter(|k| sample.located[*k].is_possible).collect();
        Some((possible.iter().map(|k| doubts(&sample.located[*k])).collect(), possible.iter().position(|k| *k == right)?))
    };
    samples.filter_map(choice).collect()
}

/// Places that are right, and those that scans of other places fit best.
fn right_and_elsewhere(samples: &[Sample]) -> Vec<(Doubts, bool)> {
    let place = |sample: &Sample| match sample.right {
        Some(right) => Some((doubts(&sample.located[right]), true)),
        None if sample.kind == "elsewhere" => Some((doubts(sample.located.first()?), false)),
        None => None,
    };
    samples.iter().filter_map(place).collect()
}

/// Of places said with a probability from `LEVELS[k]` on: how many, what was said on average, and the share that is right.
fn table(title: &str, said: impl Iterator<Item = (f64, bool)>) {
    const LEVELS: [f64; 8] = [0.0, 0.05, 0.2, 0.5, 0.8, 0.9, 0.99, 1.01];
    let said: Vec<(f64, bool)> = said.collect();
    println!("{title}: {} places", said.len());
    for level in LEVELS.windows(2) {
        let of: Vec<_> = said.iter().filter(|(p, _)| *p >= level[0] && *p < level[1]).collect();
        let count = of.len().max(1) as f64;
        let (mean, right) = (of.iter().map(|(p, _)| p).sum::<f64>() / count, of.iter().filter(|(_, is_right)| *is_right).count() as f64 / count);
        println!("| {:.2} to {:.2} | {} | {mean:.3} | {right:.3} |", level[0], level[1].min(1.0), of.len());
    }
}

/// Fits the weights, and says how true the probabilities are: of scans of odd seeds by weights of even ones, and of all by those of the library. Some minutes:
/// `cargo test --release -p voxelastic-slam --test all -- --ignored --nocapture look_alike`.
#[test]
#[ignore = "takes minutes"]
fn look_alike_places_are_as_probable_as_is_said() {
    let samples = samples();
    let [even, odd] = [0, 1].map(|rest| choices(samples.iter().filter(|s| s.seed % 2 == rest)));
    let weights = weights_among(&even);
    let (all, none) = (weights_among(&choices(samples.iter())), weights_against_none(&right_and_elsewhere(&samples)));
    println!("weights in percent: {weights:.2?} of even seeds, {all:.2?} of all; against none {none:.2?}");
    let said = odd.iter().flat_map(|(places, right)| shares(&weights, places).into_iter().enumerate().map(|(k, p)| (p, k == *right)));
    table("odd seeds, by weights of even ones, where one is right", said);
    table("all, by the library", samples.iter().flat_map(|s| s.located.iter().enumerate().map(|(k, l)| (l.probability, s.right == Some(k)))));
    let mut wrong = 0;
    let mut kinds: Vec<&str> = samples.iter().map(|s| s.kind).collect();
    kinds.dedup();
    kinds.sort_unstable();
    kinds.dedup();
    for kind in kinds {
        for is_mapped in [true, false] {
            let of: Vec<&Sample> = samples.iter().filter(|s| s.kind == kind && s.is_mapped == is_mapped).collect();
            let certain: Vec<&&Sample> = of.iter().filter(|s| s.located.first().is_some_and(|l| l.is_certain)).collect();
            let false_ones = certain.iter().filter(|s| s.right != Some(0)).count();
            let found = of.iter().filter(|s| s.right.is_some()).count();
            println!(
                "{kind}, mapped {is_mapped}: {} scans, {found} with the right place among the candidates, {} certain, {false_ones} of these wrong",
                of.len(),
                certain.len()
            );
            wrong += if is_mapped { false_ones } else { 0 };
        }
    }
    assert_eq!(wrong, 0, "certain and wrong, though the place was mapped");
}
