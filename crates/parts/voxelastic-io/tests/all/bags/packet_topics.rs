//! Packets in messages: those of the captures, written into bags of ROS 1 and ROS 2 here, and recordings with the clouds of another decoder
//! (`VOXELASTIC_DATA`).

use crate::bags::drive::{every_scan, play};
use crate::bags::message_bag::Bag;
use crate::bags::packets::{Capture, PANDAR_40P, START, VLP_16, XT_32, check_scans, pandar40p, scans, table, tilted};
use crate::bags::robosense::RS_32;
use std::collections::HashMap;
use voxelastic::Cloud;
use voxelastic_io::bag::{Recording, describe};
use voxelastic_io::ouster::{Capture as OusterCapture, datagrams};
use voxelastic_io::raw::{self, TimedScan};
use voxelastic_io::{Error, OpenOptions, clouds};
use voxelastic_testing::run_python;

/// By how much the clock of the machine is ahead of the sensor's, seconds.
const AHEAD: f64 = 1000.0;

impl Bag {
    /// The packets of a capture in messages of a type, as many in each as a driver that does not look at angles puts there.
    fn add_packets(&mut self, topic: (&'static str, &'static str), packets: &[(f64, Vec<u8>)]) {
        let mut recorded = 0.0f64;
        for some in packets.chunks(if topic.1.ends_with("Packet") { 1 } else { 37 }) {
            let (first, last) = (some[0].0, some[some.len() - 1].0);
            recorded = recorded.max(last + 0.001);
            self.add(topic, recorded, |body| match topic.1 {
                "rslidar_msg/RslidarPacket" => body.header(first, "lidar").bytes(&[0, 1]).sequence(&some[0].1),
                "rslidar_msgs/rslidarPacket" => body.stamp(first).bytes(&some[0].1),
                kind => some.iter().fold(body.header(first, "lidar").u32(some.len()), |body, (time, packet)| {
                    let body = body.stamp(*time);
                    match kind {
                        "pandar_msgs/PandarScan" => body.bytes(packet).bytes(&vec![9; 1500 - packet.len()]).u32(packet.len()),
                        "hesai_lidar/PandarScan" => body.sequence(packet).u32(packet.len()),
                        "nebula_msgs/NebulaPackets" => body.sequence(packet),
                        _ => body.bytes(packet),
                    }
                }),
            });
        }
    }
}

/// The packets of a capture to some ports, by the clock of the machine, each up to 3 ms late.
fn packets(capture: Capture, ports: &[u16]) -> Vec<(f64, Vec<u8>)> {
    let of_ports = capture.0.into_iter().filter(|datagram| ports.contains(&datagram.2));
    of_ports.enumerate().map(|(k, (time, _, _, payload))| (time + AHEAD + 1e-3 * (k % 4) as f64, payload)).collect()
}

fn vlp_16() -> Vec<(f64, Vec<u8>)> {
    packets(VLP_16.room(3.0, false), &[2368])
}

const VELODYNE: (&str, &str) = ("/velodyne_packets", "velodyne_msgs/VelodyneScan");

#[test]
fn packets_of_every_type_are_the_scans_of_the_capture() {
    let dir = tempfile::tempdir().unwrap();
    let even = |channel: usize| [15.0 - channel as f64, 0.0];
    for is_ros2 in [false, true] {
        let path = dir.path().join(if is_ros2 { "a.db3" } else { "a.bag" });
        let check = |topic, packets: &[(f64, Vec<u8>)], per_turn, off| {
            let mut bag = Bag::new(is_ros2);
            bag.add_packets(topic, packets);
            bag.write(&path);
            check_scans(&path, START + AHEAD + 0.0015, 3, per_turn, off);
        };
        check(VELODYNE, &vlp_16(), 28_900, 0.006);
        check(("/pandar_packets", "pandar_msgs/PandarScan"), &packets(XT_32.room(3.0, 0x37, even), &[2368]), 64_000, 0.004);
        check(("/nebula_packets", "nebula_msgs/NebulaPackets"), &packets(XT_32.room(3.0, 0x39, even), &[2368]), 64_000, 0.004);
        // The angles of the piece are in a file beside the bag, or in packets about the device in the same topic, or in one of its own.
        let csv = dir.path().join("a.csv");
        std::fs::write(&csv, table(40, tilted)).unwrap();
        check(("/hesai", "hesai_lidar/PandarScan"), &packets(PANDAR_40P.room(3.0, 0x37, tilted), &[2368]), 72_000, 0.004);
        std::fs::remove_file(csv).unwrap();
        let room = || RS_32.room(3.0, true, true);
        check(("/rslidar_packets", "rslidar_msg/RslidarPacket"), &packets(room(), &[6699, 7788]), 57_640, 0.006);
        let mut bag = Bag::new(is_ros2);
        bag.add_packets(("/rslidar_packets", "rslidar_msgs/rslidarScan"), &packets(room(), &[6699]));
        bag.add_packets(("/rslidar_packets_difop", "rslidar_msgs/rslidarPacket"), &packets(room(), &[7788]));
        bag.write(&path);
        check_scans(&path, START + AHEAD + 0.0015, 3, 57_640, 0.006);
    }
}

/// Writes the messages of a bag in sqlite into MCAP, as the library of that format does.
const TO_MCAP: &str = r#"
import sqlite3
import sys

from mcap.writer import Writer

database = sqlite3.connect(sys.argv[1])
with open(sys.argv[2], "wb") as file:
    writer = Writer(file)
    writer.start("ros2")
    channels = {}
    for topic, name, kind in database.execute("SELECT id, name, type FROM topics"):
        channels[topic] = writer.register_channel(name, "cdr", writer.register_schema(kind, "ros2msg", b""))
    for topic, time, data in database.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp"):
        writer.add_message(channels[topic], time, data, time)
    writer.finish()
"#;

#[test]
fn packets_in_mcap_are_the_scans_of_the_capture() {
    let dir = tempfile::tempdir().unwrap();
    let [sqlite, mcap] = ["a.db3", "a.mcap"].map(|name| dir.path().join(name));
    let mut bag = Bag::new(true);
    bag.add_packets(VELODYNE, &vlp_16());
    bag.write(&sqlite);
    if run_python("mcap", TO_MCAP, &[&sqlite, &mcap]).is_some() {
        check_scans(&mcap, START + AHEAD + 0.0015, 3, 28_900, 0.006);
    }
}

#[test]
fn packets_with_poses_are_a_recording() {
    let dir = tempfile::tempdir().unwrap();
    for is_ros2 in [false, true] {
        let path = dir.path().join(if is_ros2 { "a.db3" } else { "a.bag" });
        let mut bag = Bag::new(is_ros2);
        bag.add_packets(VELODYNE, &vlp_16());
        for k in 0..40 {
            let time = START + AHEAD - 0.01 + 0.01 * f64::from(k);
            let numbers = [time - START, 0.0, 2.0, 0.0, 0.0, 0.0, 1.0].map(f64::to_le_bytes).concat();
            bag.add(("/odometry", "nav_msgs/Odometry"), time, |body| {
                let body = body.header(time, "odom").text("lidar");
                let padding = if is_ros2 { body.0.len().next_multiple_of(8) - body.0.len() } else { 0 };
                body.bytes(&vec![0; padding]).bytes(&numbers)
            });
        }
        bag.write(&path);
        let (scans, errors) = play(&path, &every_scan());
        assert!(errors.is_empty() && scans.len() >= 3, "{errors:?}");
        for (k, scan) in scans.iter().enumerate() {
            let late = scan.time - (START + AHEAD + 0.1 * k as f64);
            assert!((0.0..4e-3).contains(&late) && scan.cloud.motion.is_some(), "{late}");
            assert!((scan.t_map_lidar.translation.x - (scan.time - START)).abs() < 1e-5, "where it was at its time");
        }
        let said = describe(&path, &OpenOptions::default()).unwrap().to_string();
        assert!(said.contains("clouds: /velodyne_packets") && said.contains("note: sensor: Velodyne VLP-16"), "{said}");
        // Where clouds are recorded, too, they are used, unless packets are asked for.
        bag.add(("/points", "sensor_msgs/PointCloud2"), START + AHEAD, |body| body.header(START, "lidar"));
        bag.write(&path);
        let topic = |options: &OpenOptions| Recording::open(&path, options).unwrap().description().cloud_topic.clone();
        assert_eq!(topic(&OpenOptions::default()).as_deref(), Some("/points"));
        assert_eq!(topic(&OpenOptions { cloud_topic: Some("velodyne_packets".into()), ..every_scan() }).as_deref(), Some("/velodyne_packets"));
    }
}

#[test]
fn packets_that_are_not_read_are_named_with_their_topic() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.bag");
    let open = |topic: (&'static str, &'static str), packets: &[(f64, Vec<u8>)], options: OpenOptions| {
        let mut bag = Bag::new(false);
        bag.add_packets(topic, packets);
        bag.write(&path);
        raw::open(&path, &options).unwrap_err().to_string()
    };
    let mut other = vlp_16();
    other.iter_mut().for_each(|(_, packet)| packet[1205] = 0xa1);
    let said = open(VELODYNE, &other, OpenOptions::default());
    let parts =
        ["topic /velodyne_packets (velodyne_msgs/VelodyneScan)", "Velodyne VLS-128, which are not read", "have the sensor's driver make clouds"];
    assert!(parts.iter().all(|part| said.contains(part)), "{said}");
    let said = open(VELODYNE, &[(START, vec![1; 1206])], OpenOptions::default());
    assert!(said.contains("(velodyne_msgs/VelodyneScan) has no packets of a sensor that is known"), "{said}");
    let rslidar = ("/rslidar_packets", "rslidar_msg/RslidarPacket");
    let said = open(rslidar, &packets(RS_32.room(0.1, false, false), &[6699]), OpenOptions::default());
    assert!(said.contains("topic /rslidar_packets") && said.contains("RS-LiDAR-32") && said.contains("7788"), "{said}");
    let metadata = Some(dir.path().join("a.csv"));
    assert!(open(VELODYNE, &vlp_16(), OpenOptions { metadata, ..OpenOptions::default() }).contains("do without --metadata"));
    let unstamped: Vec<_> = vlp_16().into_iter().map(|(_, packet)| (0.0, packet)).collect();
    assert!(open(VELODYNE, &unstamped, OpenOptions::default()).contains("message of /velodyne_packets at 0.001 s: its packets have no time stamps"));
    // And a message that ends early is one that is left out.
    let mut bag = Bag::new(true);
    bag.add_packets(VELODYNE, &vlp_16());
    bag.messages[3].2.truncate(5000);
    let path = path.with_extension("db3");
    bag.write(&path);
    let errors: Vec<Error> = raw::open(&path, &OpenOptions::default()).unwrap().iter().filter_map(Result::err).collect();
    assert!(errors.len() == 1 && errors[0].to_string().contains("it ends early"), "{errors:?}");
}

#[test]
fn packets_of_an_ouster_are_those_of_its_capture() {
    let Some(folder) = voxelastic_testing::data("ouster") else { return };
    let (capture, metadata) = (folder.join("OS-1-128_v2.3.0_1024x10_lb_n3.pcap"), folder.join("OS-1-128_v2.3.0_1024x10.json"));
    let mut read = OusterCapture::open(&capture, &metadata).unwrap();
    let expected: Vec<_> = std::iter::from_fn(|| read.next_scan()).map(Result::unwrap).collect();
    let first = expected[0].stamp.unwrap();
    let dir = tempfile::tempdir().unwrap();
    for (kind, end) in [("ouster_ros/PacketMsg", &[0u8][..]), ("ouster_sensor_msgs/PacketMsg", &[])] {
        let is_ros2 = end.is_empty();
        let path = dir.path().join(if is_ros2 { "a.db3" } else { "a.bag" });
        let mut bag = Bag::new(is_ros2);
        // One message for each packet, which come every 1.6 ms.
        let mut time = START;
        for payload in datagrams(&capture).unwrap().map(Result::unwrap).filter(|payload| payload.len() > 1000) {
            bag.add(("/ouster/lidar_packets", kind), time, |body| body.sequence(&[&payload, end].concat()));
            time += 0.1 / 64.0;
        }
        for k in 0..30 {
            let mut sample = vec![0; 48];
            let at = 0.01 * f64::from(k);
            sample[8..16].copy_from_slice(&(((first + at) * 1e9) as u64).to_le_bytes());
            sample[32..36].copy_from_slice(&1f32.to_le_bytes());
            bag.add(("/ouster/imu_packets", kind), START + at, |body| body.sequence(&[&sample, end].concat()));
        }
        bag.write(&path);
        let open = |options: &OpenOptions| raw::open(&path, options);
        let said = open(&OpenOptions::default()).unwrap_err().to_string();
        assert!(said.contains("topic /ouster/lidar_packets") && said.contains("metadata") && said.contains("--metadata"), "{said}");
        let other = OpenOptions { metadata: Some(folder.join("OS-1-64_sensor_config_reduced.json")), ..OpenOptions::default() };
        assert!(open(&other).unwrap_err().to_string().contains("none of the first"), "the metadata of another sensor");
        let text = std::fs::read_to_string(&metadata).unwrap();
        bag.add(("/ouster/metadata", "std_msgs/String"), START + 0.05, |body| body.text(&text));
        bag.write(&path);
        let opened = open(&OpenOptions::default()).unwrap();
        let said = opened.description();
        assert!(said.contains("described by /ouster/metadata") && said.contains("imu: /ouster/imu_packets"), "{said}");
        assert_eq!(opened.sensor().map(|model| (model.rows(), model.columns())), Some((128, 1024)));
        let scans: Vec<TimedScan> = opened.iter().map(Result::unwrap).collect();
        assert_eq!(scans.len(), expected.len());
        for (scan, other) in scans.iter().zip(&expected) {
            let bits = |cloud: &Cloud| cloud.points.iter().flatten().map(|v| v.to_bits()).collect::<Vec<u32>>();
            assert_eq!(bits(&scan.cloud), bits(&other.cloud));
            assert!((scan.time - START - (other.stamp.unwrap() - first)).abs() < 3e-3, "{}", scan.time - START);
        }
        let samples: usize = scans.iter().map(|scan| scan.imu.len()).sum();
        assert!(samples == 30 && (scans[0].imu[0].time - START).abs() < 3e-3 && scans[0].imu.len() < 15);
    }
}

/// The nearest of the points to each of others, by cells of a few centimetres.
fn nearest(points: &[[f32; 3]], others: &[[f32; 3]]) -> Vec<Option<(usize, f64)>> {
    const CELL: f32 = 0.05;
    let cell = |p: &[f32; 3], by: [i32; 3]| std::array::from_fn::<i32, 3, _>(|k| (p[k] / CELL).floor() as i32 + by[k]);
    let mut cells: HashMap<[i32; 3], Vec<usize>> = HashMap::new();
    points.iter().enumerate().for_each(|(k, p)| cells.entry(cell(p, [0; 3])).or_default().push(k));
    let apart = |a: &[f32; 3], b: &[f32; 3]| (0..3).map(|k| f64::from(a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
    let of = |p: &[f32; 3]| {
        let around = (0..27).filter_map(|k| cells.get(&cell(p, [k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1])));
        around.flatten().map(|k| (*k, apart(p, &points[*k]))).min_by(|a, b| a.1.total_cmp(&b.1))
    };
    others.iter().map(of).collect()
}

/// How many channels a sensor has, and the angles of its kind.
type Channels = (usize, fn(usize) -> [f64; 2]);

/// Distance, elevation and azimuth as Hesai counts it, metres and degrees.
fn polar(p: &[f32; 3]) -> [f64; 3] {
    let [x, y, z] = p.map(f64::from);
    let range = (x * x + y * y + z * z).sqrt();
    [range, (z / range).asin().to_degrees(), x.atan2(y).to_degrees()]
}

/// The angles of the piece that another decoder used, as its cloud shows them: a table beside one with those of the kind.
fn shown_angles(cloud: &Cloud, theirs: &[[f32; 3]], (channels, usual): Channels) -> String {
    let mut seen = vec![[Vec::new(), Vec::new()]; channels];
    let found = nearest(theirs, &cloud.points);
    for ((p, ring), found) in cloud.points.iter().zip(cloud.ring.as_ref().unwrap()).zip(found) {
        let (Some((k, _)), [range, _, azimuth]) = (found, polar(p)) else { continue };
        let [their_range, elevation, their_azimuth] = polar(&theirs[k]);
        if (range - their_range).abs() < 1e-3 {
            let angles = [elevation, their_azimuth - azimuth + usual(usize::from(*ring))[1]];
            seen[usize::from(*ring)].iter_mut().zip(angles).for_each(|(all, angle)| all.push(angle));
        }
    }
    let line = |channel: usize| {
        // Some channels see nothing.
        let median = |which: usize| {
            let mut sorted = seen[channel][which].clone();
            sorted.sort_by(f64::total_cmp);
            sorted.get(sorted.len() / 2).copied().unwrap_or(usual(channel)[which])
        };
        format!("{},{:.3},{:.3}\n", channel + 1, median(0), median(1))
    };
    format!("Channel,Elevation,Azimuth\n{}", (0..channels).map(line).collect::<String>())
}

/// The other decoder (nebula) uses the angles of the piece of Hesai's sensors. Of Velodyne's it lets all beams pass through the axis, which moves points by up to
/// 1.1 cm, and between the azimuths of blocks its own are off by up to 0.3 degrees.
#[test]
fn clouds_are_those_of_another_decoder() {
    let Some(folder) = voxelastic_testing::data("packets") else { return };
    let dir = tempfile::tempdir().unwrap();
    let [pandar, xt]: [Channels; 2] = [(40, pandar40p), (32, |channel| [15.0 - channel as f64, 0.0])];
    // The turn that is theirs, its points, and how many of those are to be within 1 cm and 5 cm of theirs.
    let models = [
        ("40p", 2, 54_320, Some(pandar), [0.999, 1.0]),
        ("xt32", 3, 60_824, Some(xt), [0.999, 1.0]),
        ("vlp16", 3, 14_560, None, [0.84, 1.0]),
        ("vlp32", 0, 26_224, None, [0.75, 0.98]),
    ];
    for (model, turn, count, usual, least) in models {
        let entries: Vec<_> = std::fs::read_dir(folder.join(model)).unwrap().map(|entry| entry.unwrap().path()).collect();
        let recording = entries.iter().find(|path| path.is_dir()).unwrap();
        let theirs = clouds::read(entries.iter().find(|path| !path.is_dir()).unwrap()).unwrap().cloud.points;
        let mut all = scans(recording, &OpenOptions::default());
        if let Some(usual) = usual {
            let metadata = dir.path().join(format!("{model}.csv"));
            std::fs::write(&metadata, shown_angles(&all[turn].cloud, &theirs, usual)).unwrap();
            all = scans(recording, &OpenOptions { metadata: Some(metadata), ..OpenOptions::default() });
        }
        assert!(all.windows(2).all(|pair| (pair[1].time - pair[0].time - 0.1).abs() < 8e-4), "{model}: turns of a tenth of a second");
        let mut points = all[turn].cloud.points.clone();
        assert_eq!(points.len(), count, "{model}");
        // Theirs of this sensor, which looks forward, is the first half of one turn with the second of another.
        points.retain(|p| model != "vlp32" || (p[0] > 0.0 && p[1] < 0.0));
        let off: Vec<f64> = nearest(&theirs, &points).iter().map(|found| found.map_or(f64::INFINITY, |(_, off)| off)).collect();
        let within = |limit: f64| off.iter().filter(|off| **off < limit).count() as f64 / off.len() as f64;
        eprintln!(
            "{model}: {} points, {} of theirs; {:.4} within 2 mm, {:.4} within 1 cm, {:.4} within 5 cm",
            off.len(),
            theirs.len(),
            within(0.002),
            within(0.01),
            within(0.05)
        );
        assert!(within(0.01) >= least[0] && within(0.05) >= least[1], "{model}");
    }
}
