//! An axis: its range, its ticks, and where values lie on the page.

use crate::round_number::round_number;

/// A range of values, and the range of page coordinates that it is drawn on.
pub(super) struct Axis {
    low: f64,
    high: f64,
    /// Distance between ticks.
    step: f64,
    /// Page coordinate of the low end.
    pub from: f32,
    /// Page coordinate of the high end.
    pub to: f32,
}

impl Axis {
    /// An axis that contains the values, with about `ticks` ticks at round numbers. With `zero` it starts at zero if no value is negative.
    pub fn new(values: impl Iterator<Item = f64>, ticks: f64, zero: bool, (from, to): (f32, f32)) -> Self {
        let (mut low, mut high) = values.filter(|v| v.is_finite()).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        if zero && low > 0.0 {
            low = 0.0;
        }
        // Beyond this, steps between ticks are lost in rounding.
        (low, high) = (low.clamp(-1e30, 1e30), high.clamp(-1e30, 1e30));
        if high - low < 1e-9 * high.abs().max(low.abs()).max(1e-12) {
            high = low + low.abs().max(1.0);
        }
        let step = round_up((high - low) / ticks);
        Self { low: (low / step).floor() * step, high: (high / step).ceil() * step, step, from, to }
    }

    /// Page coordinate of a value.
    pub fn at(&self, value: f64) -> f32 {
        let t = ((value - self.low) / (self.high - self.low)).clamp(-10.0, 10.0) as f32;
        self.from + (self.to - self.from) * t
    }

    /// Values of the ticks.
    pub fn ticks(&self) -> Vec<f64> {
        let n = ((self.high - self.low) / self.step).round().clamp(1.0, 100.0) as usize;
        (0..=n).map(|i| self.low + self.step * i as f64).collect()
    }

    /// Text of a tick.
    pub fn label(&self, value: f64) -> String {
        let digits = (-self.step.log10().floor()).clamp(0.0, 9.0) as usize;
        if value.abs() >= 1e7 { format!("{value:.1e}") } else { format!("{:.digits$}", if value.abs() < self.step * 1e-6 { 0.0 } else { value }) }
    }
}

/// The next number of the form 1, 2, 5 times a power of ten.
fn round_up(v: f64) -> f64 {
    let below = round_number(v);
    [1.0, 2.0, 2.5, 5.0].into_iter().map(|f| round_number(below * f * 1.000_001)).find(|s| *s >= v * 0.999_999).unwrap_or(below * 2.5)
}
