//! Scans of sensors that turn: one for each turn of the head.

use super::spinning::{Firing, PacketReturns, SpinningPackets, SpinningReturn};
use crate::stamped_cloud::StampedCloud;
use std::collections::VecDeque;
use voxelastic::Cloud;

/// No sensor turns more slowly: a longer turn has lost its end, seconds.
const LONGEST_TURN_S: f64 = 0.35;
/// A packet that is older than the one before by less than this was overtaken on its way, seconds. By more, the clock went back.
const LONGEST_DETOUR_S: f64 = 1.0;
/// A turn that is not even half there, at the ends of a capture and around gaps, is left out, degrees.
const LEAST_TURN: f64 = 180.0;
/// Between two firings the head turns by no more, if nothing is missing, degrees.
const LARGEST_STEP: f64 = 30.0;
/// How long a turn takes until one was seen, seconds.
const USUAL_TURN_S: f64 = 0.1;

/// What became of the packets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct PacketCounts {
    pub(super) used: usize,
    /// Those that are not of the sensor: of another size, or damaged.
    pub(super) damaged: usize,
    /// Those that were overtaken.
    pub(super) late: usize,
    /// How many are missing, by the times of the others.
    pub(super) lost: usize,
    /// Returns of turns that were left out.
    pub(super) left_out: usize,
}

impl PacketCounts {
    /// What could not be used, in words; `of_others` packets are of another sensor.
    pub(super) fn words(self, of_others: usize) -> Option<String> {
        let Self { used, damaged, late, lost, .. } = self;
        let parts =
            [(damaged, "are damaged or of another kind"), (late, "came too late"), (lost, "are missing"), (of_others, "are of another sensor")];
        let said: Vec<String> = parts.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}")).collect();
        (!said.is_empty()).then(|| format!("of {} packets, {}", used + damaged + late + lost, said.join(", ")))
    }
}

/// The returns since the head passed zero.
#[derive(Debug, Default)]
struct Turn {
    returns: Vec<SpinningReturn>,
    start: Option<f64>,
    /// How far the head has turned, degrees.
    swept: f64,
}

/// Collects the packets of a sensor.
#[derive(Debug)]
pub(super) struct TurnAssembler {
    packets: Box<dyn SpinningPackets>,
    turn: Turn,
    complete: VecDeque<StampedCloud>,
    /// Scans so far.
    scans: usize,
    counts: PacketCounts,
    last: Option<Firing>,
    /// Whether the head turns anticlockwise: some sensors can.
    is_backward: bool,
    /// How long the last turn took, seconds.
    turn_s: f64,
    /// Time of the last packet, and the shortest time between two.
    last_packet: Option<f64>,
    interval: f64,
    buffer: PacketReturns,
}

impl TurnAssembler {
    pub(super) fn new(packets: Box<dyn SpinningPackets>) -> Self {
        Self {
            packets,
            turn: Turn::default(),
            complete: VecDeque::new(),
            scans: 0,
            counts: PacketCounts::default(),
            last: None,
            is_backward: false,
            turn_s: USUAL_TURN_S,
            last_packet: None,
            interval: f64::INFINITY,
            buffer: PacketReturns::default(),
        }
    }

    /// What became of the packets so far.
    pub(super) fn counts(&self) -> PacketCounts {
        self.counts
    }

    /// The next complete scan.
    pub(super) fn take_scan(&mut self) -> Option<StampedCloud> {
        self.complete.pop_front()
    }

    /// The scan that is being collected, if half of it is there or nothing else was.
    pub(super) fn take_unfinished(&mut self) -> Option<StampedCloud> {
        let turn = std::mem::take(&mut self.turn);
        if self.scans == 0 || turn.swept >= LEAST_TURN {
            return turn.cloud();
        }
        self.counts.left_out += turn.returns.len();
        None
    }

    /// Adds the content of a datagram that came at a time, seconds. Returns its time in the clock of the scans, if it is one of the sensor.
    pub(super) fn add(&mut self, packet: &[u8], came: f64) -> Option<f64> {
        let mut buffer = std::mem::take(&mut self.buffer);
        buffer.clear();
        let is_read = self.packets.read(packet, came, &mut buffer);
        if is_read {
            self.add_returns(&buffer);
        } else {
            self.counts.damaged += 1;
        }
        let first = buffer.firings.first().filter(|_| is_read).map(|firing| firing.time);
        self.buffer = buffer;
        first
    }

    fn add_returns(&mut self, packet: &PacketReturns) {
        let Some(first) = packet.firings.first() else { return };
        if let Some(last) = self.last_packet {
            let step = first.time - last;
            if step < 0.0 && step > -LONGEST_DETOUR_S {
                self.counts.late += 1;
                return;
            }
            if step < 0.0 {
                self.finish_turn();
                self.last = None;
            } else if step > 0.0 {
                // A pause of a second is one: the sensor was switched off, or the capture is made of pieces.
                if step > 1.5 * self.interval && step < 1.0 {
                    self.counts.lost += (step / self.interval).round() as usize - 1;
                }
                self.interval = self.interval.min(step);
            }
        }
        self.last_packet = Some(first.time);
        self.counts.used += 1;
        let mut begin = 0;
        for firing in &packet.firings {
            self.turn_to(firing);
            self.turn.start.get_or_insert(firing.time);
            self.turn.returns.extend(packet.returns.get(begin..firing.end).unwrap_or_default());
            begin = firing.end;
        }
    }

    /// Ends the turn if the head passed zero, or must have.
    fn turn_to(&mut self, firing: &Firing) {
        let Some(last) = self.last.replace(*firing) else { return };
        let forwards = (firing.head - last.head).rem_euclid(360.0);
        let step = forwards.min(360.0 - forwards);
        if step > 0.0 && step <= LARGEST_STEP {
            self.is_backward = forwards > 180.0;
        }
        let turned = if self.is_backward { 360.0 - forwards } else { forwards };
        let jump = if self.is_backward { firing.head - last.head } else { last.head - firing.head };
        let is_long = self.turn.start.is_some_and(|start| firing.time - start > LONGEST_TURN_S);
        // So much is missing that the head may have passed zero without a trace.
        let is_gap = firing.time - last.time > 0.95 * self.turn_s;
        if jump > LARGEST_STEP {
            if let Some(start) = self.turn.start.filter(|_| self.turn.swept >= LEAST_TURN && !is_long) {
                self.turn_s = firing.time - start;
            }
            self.finish_turn();
        } else if is_long || is_gap {
            self.finish_turn();
        }
        self.turn.swept += if is_gap { step } else { turned };
    }

    fn finish_turn(&mut self) {
        let turn = std::mem::take(&mut self.turn);
        if turn.swept >= LEAST_TURN {
            self.complete.extend(turn.cloud());
            self.scans += 1;
        } else {
            self.counts.left_out += turn.returns.len();
        }
    }
}

impl Turn {
    /// The returns as a cloud without a grid: how many columns a turn has differs from turn to turn.
    fn cloud(&self) -> Option<StampedCloud> {
        let stamp = self.start.filter(|_| !self.returns.is_empty())?;
        let cloud = Cloud {
            intensity: Some(self.returns.iter().map(|r| f32::from(r.intensity)).collect()),
            ring: Some(self.returns.iter().map(|r| r.ring).collect()),
            time: Some(self.returns.iter().map(|r| (r.time - stamp) as f32).collect()),
            ..Cloud::from_points(self.returns.iter().map(|r| r.point).collect())
        };
        Some(StampedCloud::new(cloud, Some(stamp)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Packets of a time in milliseconds and a direction in degrees, one byte and two: one firing, one return.
    #[derive(Debug)]
    struct Toy;

    impl SpinningPackets for Toy {
        fn read(&mut self, packet: &[u8], _: f64, out: &mut PacketReturns) -> bool {
            let [t, a, b] = *packet else { return false };
            let (time, head) = (f64::from(t) * 1e-3, f64::from(u16::from_le_bytes([a, b])));
            out.returns.push(SpinningReturn { time, ring: 0, intensity: 1, point: [1.0, 0.0, head as f32] });
            out.end_firing(time, head);
            true
        }
    }

    fn play(packets: &[(u8, u16)]) -> (Vec<usize>, PacketCounts) {
        let mut assembler = TurnAssembler::new(Box::new(Toy));
        let mut sizes = Vec::new();
        for (time, head) in packets {
            let [a, b] = head.to_le_bytes();
            assembler.add(&[*time, a, b], 0.0);
            sizes.extend(std::iter::from_fn(|| assembler.take_scan()).map(|scan| scan.cloud.len()));
        }
        assembler.add(&[0; 7], 0.0);
        sizes.extend(assembler.take_unfinished().map(|scan| scan.cloud.len()));
        (sizes, assembler.counts())
    }

    #[test]
    fn turns_end_where_the_head_passes_zero() {
        // From 300 degrees on, in steps of 30.
        let steady: Vec<(u8, u16)> = (0..30u8).map(|k| (2 * k, (300 + 30 * u16::from(k)) % 360)).collect();
        let counts = PacketCounts { used: 30, damaged: 1, left_out: 6, ..PacketCounts::default() };
        assert_eq!(play(&steady), (vec![12, 12], counts), "neither the end of the first nor the beginning of the last");
        let back: Vec<(u8, u16)> = steady.iter().map(|(t, head)| (*t, (360 - head) % 360)).collect();
        assert_eq!(play(&back).0.iter().sum::<usize>(), 24, "the other way round");
        assert_eq!(play(&steady[..4]).0, [2], "all there is, if there is no more than that");
        // A sensor that looks forward only, over the direction in which it counts from zero.
        let forward: Vec<(u8, u16)> = (0..60u8).filter(|k| !(3..9).contains(&(k % 12))).map(|k| (2 * k, 30 * u16::from(k) % 360)).collect();
        assert_eq!(play(&forward).0, [6; 5]);
    }

    #[test]
    fn what_is_lost_and_late_is_counted() {
        let mut packets: Vec<(u8, u16)> = (0..36u8).map(|k| (2 * k, 30 * u16::from(k) % 360)).collect();
        packets.drain(14..17);
        packets.swap(3, 4);
        let (sizes, counts) = play(&packets);
        assert_eq!(sizes, [11, 9, 12]);
        assert_eq!(counts, PacketCounts { used: 32, damaged: 1, late: 1, lost: 4, left_out: 0 }, "a packet that comes late was missing");
        // More than a turn is missing: no scan is made of two.
        let gap: Vec<(u8, u16)> = (0..40u8).filter(|k| !(14..26).contains(k)).map(|k| (6 * k, 30 * u16::from(k) % 360)).collect();
        assert_eq!(play(&gap).0, [12, 10]);
    }
}
