//! The closures that were tried, as JSON has them.

use crate::joining::numbers;
use serde::Serialize;
use voxelastic::event::NodeId;
use voxelastic_slam::loops::{Closure, Verdict};

/// Closures that were tried.
#[derive(Clone, Debug, Serialize)]
pub struct ClosureSummary {
    /// Believed.
    pub accepted: usize,
    /// Refused, because the places could not be registered to each other.
    pub not_registered: usize,
    /// Refused, because the surfaces do not lie on each other.
    pub poor_fit: usize,
    /// Refused, because surfaces would be in space that was observed to be free.
    pub free_space: usize,
    /// Refused, because the odometry cannot be as wrong as that.
    pub beyond_drift: usize,
    /// All of them, in order.
    pub tried: Vec<TriedClosure>,
}

/// One closure.
#[derive(Clone, Debug, Serialize)]
pub struct TriedClosure {
    /// Node of the earlier place.
    pub from: NodeId,
    /// Node of the later place.
    pub to: NodeId,
    /// Pose of the later node in the frame of the earlier one, `[x, y, z, qx, qy, qz, qw]`; `null` if the places could not be registered.
    pub t_from_to: Option<[f64; 7]>,
    /// `accepted`, or one of the reasons.
    pub verdict: &'static str,
    /// Correlation of the places seen from above, 0 to 1.
    pub correlation: f32,
    /// Share of the surfaces with a counterpart; `null` if the places could not be registered.
    pub overlap: Option<f64>,
    /// Mean weight of the surfaces, 1 where all lie on each other.
    pub score: Option<f64>,
    /// Share of surfaces in space that was observed to be free; `null` if that was not looked at.
    pub contradiction: Option<f64>,
    /// Distance between the closure and the poses before it, metres.
    pub correction_m: f64,
}

impl ClosureSummary {
    /// Of closures in order.
    pub fn of(closures: &[Closure]) -> Self {
        let count = |verdict: Verdict| closures.iter().filter(|c| c.verdict == verdict).count();
        Self {
            accepted: count(Verdict::Accepted),
            not_registered: count(Verdict::NotRegistered),
            poor_fit: count(Verdict::PoorFit),
            free_space: count(Verdict::FreeSpace),
            beyond_drift: count(Verdict::BeyondDrift),
            tried: closures.iter().map(TriedClosure::of).collect(),
        }
    }

    /// The closures for the log of the run.
    pub fn for_report(&self) -> Vec<voxelastic_report::TriedClosure> {
        let of = |c: &TriedClosure| voxelastic_report::TriedClosure {
            from: c.from,
            to: c.to,
            verdict: c.verdict.to_owned(),
            correlation: f64::from(c.correlation),
            overlap: c.overlap,
            score: c.score,
            contradiction: c.contradiction,
            correction_m: c.correction_m,
        };
        self.tried.iter().map(of).collect()
    }

    /// Logs the counts, if there are any.
    pub fn log(&self) {
        if !self.tried.is_empty() {
            let refused = [
                (self.free_space, "would put surfaces into space that was observed to be free"),
                (self.poor_fit, "do not fit"),
                (self.not_registered, "cannot be registered"),
                (self.beyond_drift, "claim more than the odometry can be wrong"),
            ];
            let reasons: Vec<String> = refused.iter().filter(|(n, _)| *n > 0).map(|(n, why)| format!("{n} {why}")).collect();
            let reasons = if reasons.is_empty() { "none refused".to_owned() } else { format!("refused: {}", reasons.join(", ")) };
            tracing::info!("loop closures: {} accepted; {reasons}", self.accepted);
        }
    }
}

impl TriedClosure {
    fn of(closure: &Closure) -> Self {
        let Closure { from, to, correlation, fit, correction_m, .. } = *closure;
        Self {
            from,
            to,
            t_from_to: fit.map(|f| numbers(&f.t_first_second)),
            verdict: match closure.verdict {
                Verdict::Accepted => "accepted",
                Verdict::NotRegistered => "not_registered",
                Verdict::PoorFit => "poor_fit",
                Verdict::FreeSpace => "free_space",
                Verdict::BeyondDrift => "beyond_drift",
                _ => "unknown",
            },
            correlation,
            overlap: fit.map(|f| f.overlap),
            score: fit.map(|f| f.score),
            contradiction: fit.and_then(|f| f.contradiction),
            correction_m,
        }
    }
}
