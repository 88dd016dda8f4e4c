//! A sweep: costs as a function of one parameter.

use super::power_law::exponent;
use serde::Serialize;

/// Costs for several values of one parameter.
#[derive(Clone, Debug, Serialize)]
pub struct Sweep {
    /// The parameter: `rings`, `range`, `voxel` or `submaps`.
    pub of: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// The field: `tsdf` or `occupancy`.
    pub field: String,
    /// The fixed parameters.
    pub fixed: String,
    /// The measurements.
    pub points: Vec<Point>,
    /// Exponent of the processor time per scan.
    pub cpu_exponent: Option<f64>,
    /// Exponent of the map's memory.
    pub memory_exponent: Option<f64>,
    /// Exponent of the time per scan for submap assignment, clustering and fusion.
    pub elastic_exponent: Option<f64>,
    /// Exponent of the time of a pose update.
    pub pose_update_exponent: Option<f64>,
}

/// Costs at one value of the parameter.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Point {
    /// Value of the parameter.
    pub x: f64,
    /// Median processor time per scan on one thread, milliseconds.
    pub cpu_ms: Option<f64>,
    /// Memory of the map, megabytes.
    pub map_mb: Option<f64>,
    /// Peak memory of the process, megabytes.
    pub peak_rss_mb: Option<f64>,
    /// Mean time per scan for submap assignment, clustering and fusion, milliseconds.
    pub elastic_ms: Option<f64>,
    /// Median time of a pose update, milliseconds.
    pub pose_update_ms: Option<f64>,
}

impl Sweep {
    /// A sweep without measurements.
    pub(super) fn new(of: &'static str, unit: &'static str, field: &str, fixed: String) -> Self {
        let points = Vec::new();
        let field = field.to_owned();
        Self { of, unit, field, fixed, points, cpu_exponent: None, memory_exponent: None, elastic_exponent: None, pose_update_exponent: None }
    }

    /// The sweep with exponents fitted to its points.
    pub(super) fn fitted(self) -> Self {
        let fit = |cost: fn(&Point) -> Option<f64>| {
            let points: Option<Vec<(f64, f64)>> = self.points.iter().map(|p| Some((p.x, cost(p)?))).collect();
            points.and_then(exponent)
        };
        Self {
            cpu_exponent: fit(|p| p.cpu_ms),
            memory_exponent: fit(|p| p.map_mb),
            elastic_exponent: fit(|p| p.elastic_ms),
            pose_update_exponent: fit(|p| p.pose_update_ms),
            ..self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponents_are_fitted_to_the_points() {
        let points = [1.0, 10.0, 100.0].map(|x: f64| Point { x, cpu_ms: Some(2.0 * x), map_mb: Some(7.0), ..Point::default() });
        let sweep = Sweep { points: points.into(), ..Sweep::new("submaps", "", "tsdf", String::new()) }.fitted();
        assert!((sweep.cpu_exponent.unwrap() - 1.0).abs() < 1e-9 && sweep.memory_exponent.unwrap().abs() < 1e-9);
        assert_eq!((sweep.elastic_exponent, sweep.pose_update_exponent), (None, None));
    }
}
