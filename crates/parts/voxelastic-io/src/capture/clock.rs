//! The clock of a sensor, which may be set or not.

/// A clock that is this near to that of the recorder is taken as set, seconds: satellites' time and atomic time are ahead of ours by 18 and 37 s.
const SAME_CLOCK_S: f64 = 60.0;
/// If the difference of both clocks changes by more, the sensor was started again, or the capture is made of pieces, seconds.
const LARGEST_CHANGE_S: f64 = 10.0;

/// Makes times of what a sensor counts. A clock that was not set is shifted to that of the recorder, once: intervals are those of the sensor.
#[derive(Clone, Debug, Default)]
pub(super) struct SensorClock {
    /// Seconds after which the sensor counts from zero again, if it does.
    wraps_after: Option<f64>,
    /// What is added to what it counts, and what the time was ahead of the recorder's at first.
    shift: Option<(f64, f64)>,
    last: f64,
}

impl SensorClock {
    /// Of a sensor that counts the seconds of an hour.
    pub(super) fn of_the_hour() -> Self {
        Self { wraps_after: Some(3600.0), ..Self::default() }
    }

    /// The time of what the sensor counted, in a packet that came at `came`; seconds.
    pub(super) fn time(&mut self, counted: f64, came: f64) -> f64 {
        if let (Some(period), Some((shift, _))) = (self.wraps_after, &mut self.shift)
            && counted < self.last - 0.5 * period
        {
            *shift += period;
        }
        self.last = counted;
        if let Some((shift, ahead)) = self.shift
            && (counted + shift - came - ahead).abs() <= LARGEST_CHANGE_S
        {
            return counted + shift;
        }
        let by_period = self.wraps_after.map_or(0.0, |period| ((came - counted) / period).round() * period);
        let shift = if (counted + by_period - came).abs() <= SAME_CLOCK_S { by_period } else { came - counted };
        self.shift = Some((shift, counted + shift - came));
        counted + shift
    }
}

/// The delays of so many packets are averaged: a second of most sensors.
const PACKETS: f64 = 1000.0;
/// If the difference of both clocks changes by more, one of them was set, seconds.
const LARGEST_DELAY_S: f64 = 1.0;

/// The clock of the machine that received the packets of a sensor, as their times in the sensor's clock tell it. Each packet is late by a delay of its own.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct HostClock {
    /// What is added to the times of the sensor, as the mean of so many packets.
    shift: f64,
    packets: f64,
}

impl HostClock {
    /// Takes the time of a packet in the sensor's clock, and when it came; seconds.
    pub(super) fn note(&mut self, sensor: f64, came: f64) {
        let delay = came - sensor - self.shift;
        if self.packets == 0.0 || delay.abs() > LARGEST_DELAY_S {
            *self = Self { shift: came - sensor, packets: 1.0 };
            return;
        }
        self.packets = (self.packets + 1.0).min(PACKETS);
        self.shift += delay / self.packets;
    }

    /// The time of the sensor in this clock.
    pub(super) fn time(&self, sensor: f64) -> f64 {
        sensor + self.shift
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clock_of_the_machine_is_followed_and_delays_are_averaged() {
        let mut host = HostClock::default();
        // The sensor counts from zero and is 50 millionths slow; packets are late by up to 4 ms.
        for k in 0..600_000 {
            host.note(f64::from(k) * 1e-3, 1.7e9 + f64::from(k) * 1e-3 * 1.000_05 + f64::from(k * 7 % 5) * 1e-3);
        }
        assert!((host.time(600.0) - (1.7e9 + 600.03 + 0.002)).abs() < 2e-4, "{}", host.time(600.0));
        host.note(600.0, 1.7e9 - 20.0);
        assert!((host.time(600.0) - (1.7e9 - 20.0)).abs() < 1e-6, "the clock was set");
    }

    #[test]
    fn a_clock_that_is_set_is_believed_and_another_is_shifted() {
        let came = 1_700_003_599.0;
        let hour = came - came % 3600.0;
        let mut set = SensorClock::of_the_hour();
        assert_eq!(set.time(came - hour - 0.25, came), came - 0.25);
        assert_eq!(set.time(came - hour + 0.5, came + 0.6), came + 0.5);
        // The hour ends: the sensor counts from zero.
        let next = hour + 3600.0;
        assert!((set.time(0.125, next + 0.2) - (next + 0.125)).abs() < 1e-6);
        let mut unset = SensorClock::of_the_hour();
        assert_eq!(unset.time(12.0, came), came);
        assert_eq!(unset.time(12.5, came + 0.7), came + 0.5, "intervals are the sensor's");
        assert_eq!(unset.time(3.0, came + 100.0), came + 100.0, "it was started again");
    }
}
