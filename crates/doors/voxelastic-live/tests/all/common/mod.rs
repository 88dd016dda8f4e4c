//! What tests of sensors share.

use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use voxelastic::Cloud;
use voxelastic_live::feed::{Feed, Next};
use voxelastic_run::Input;

/// The scans that come until `sender` has ended and nothing comes any more.
pub fn scans_of(feed: &Feed, sender: JoinHandle<()>) -> Vec<(f64, Cloud)> {
    let (mut scans, mut last) = (Vec::new(), Instant::now());
    while !sender.is_finished() || last.elapsed() < Duration::from_millis(300) {
        match feed.next(Duration::from_millis(20)) {
            Next::Incoming(incoming, _) => match *incoming {
                Input::RawScan(scan, _) => {
                    scans.push((scan.time, scan.cloud));
                    last = Instant::now();
                }
                other => panic!("{other:?}"),
            },
            Next::Nothing => {}
            Next::End => panic!("the input ended"),
        }
    }
    sender.join().unwrap();
    scans
}
pub mod published;
