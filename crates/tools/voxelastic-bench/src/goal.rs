//! A goal of the project and its measured value.

use serde::Serialize;

/// A quantity, its goal, and its measured value.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Goal {
    /// The quantity.
    pub what: String,
    /// Its unit.
    pub unit: &'static str,
    /// The value aimed at.
    pub goal: f64,
    /// The least acceptable value.
    pub least: f64,
    /// Whether larger values are better.
    pub more_is_better: bool,
    /// The measured value; `null` if it was not measured.
    pub measured: Option<f64>,
    /// `goal`, `least`, `missed` or `not measured`.
    pub reached: &'static str,
    /// The best peer, as measured before on a similar machine.
    pub best_peer: &'static str,
}
