//! Where a map is, and residuals, as text.

use std::fmt::Write;
use voxelastic_earth::Georeference;
use voxelastic_run::georeference::{Outcome, Row, Statistics, Use};

/// Most fixes that are listed: the worst ones, beside all that were refused and all control points.
const MOST: usize = 12;

/// The place in some lines.
pub fn place(place: &Georeference) -> String {
    let mut out = String::new();
    let _ = match place.anchor {
        Some(p) => writeln!(out, "plane at {:.9}, {:.9}, height {:.3} m ({})", p.latitude, p.longitude, p.height, place.heights.name()),
        None => writeln!(out, "in metres of a place that nobody named; heights: {}", place.heights.name()),
    };
    let (t, (roll, pitch, yaw)) = (place.t_plane_map.translation.vector, place.t_plane_map.rotation.euler_angles());
    let degrees = [roll, pitch, yaw].map(f64::to_degrees);
    let _ = writeln!(
        out,
        "map in it: east {:.3} north {:.3} up {:.3} m, roll {:.3} pitch {:.3} yaw {:.3} degrees",
        t.x, t.y, t.z, degrees[0], degrees[1], degrees[2]
    );
    let system = place.crs.map_or_else(|| "east, north and up of the plane".to_owned(), |code| format!("EPSG:{code}"));
    let _ = writeln!(out, "clouds are written in {system}");
    out
}

/// Residuals in a table: all control points, or what was refused and the worst of the others.
pub fn residuals(outcome: &Outcome) -> String {
    let mut out = String::new();
    let _ = writeln!(
        out,
        "{:<18} {:>8} {:<8} {:>9} {:>9} {:>9} {:>9}   metres: measured less mapped",
        "fix", "node", "use", "east", "north", "up", "rigid"
    );
    for row in listed(&outcome.rows) {
        let name = row.name.clone().or_else(|| row.time_s.map(|t| format!("{t:.2} s"))).unwrap_or_default();
        let what = match row.r#use {
            Use::Used => "used",
            Use::Refused => "refused",
            Use::Check => "check",
        };
        let [e, n, u] = row.residual_m;
        let _ = writeln!(out, "{name:<18} {:>8} {what:<8} {e:>9.3} {n:>9.3} {u:>9.3} {:>9.3}", row.node, length(row.rigid_m));
    }
    let count = |what: Use| outcome.rows.iter().filter(|row| row.r#use == what).count();
    let elsewhere = outcome.elsewhere;
    let _ = writeln!(
        out,
        "{} used, {} refused, {} held out, {elsewhere} of places that the map does not have",
        count(Use::Used),
        count(Use::Refused),
        count(Use::Check)
    );
    for (what, [used, check]) in [("rigid", outcome.rigid), ("now", outcome.now)] {
        statistics(&mut out, &format!("{what}, used"), &used);
        statistics(&mut out, &format!("{what}, held out"), &check);
    }
    let [_, _, yaw, east, north, up] = outcome.sigmas;
    let _ = writeln!(
        out,
        "rigid alignment to {yaw:.4} degrees of heading, {east:.3} {north:.3} {up:.3} m (1 sigma); the map was bent by up to {:.2} m",
        outcome.bent_m
    );
    if outcome.spread > 1.5 {
        let _ = writeln!(out, "residuals are {:.1} times what the standard deviations of the fixes say", outcome.spread);
    }
    out += &place(&outcome.place);
    out
}

fn length([e, n, u]: [f64; 3]) -> f64 {
    e.hypot(n).hypot(u)
}

fn listed(rows: &[Row]) -> Vec<&Row> {
    let is_control = rows.iter().any(|row| row.name.is_some());
    if is_control || rows.len() <= MOST {
        return rows.iter().collect();
    }
    let mut worst: Vec<&Row> = rows.iter().collect();
    worst.sort_by(|a, b| length(b.residual_m).total_cmp(&length(a.residual_m)));
    worst.truncate(MOST);
    worst
}

fn statistics(out: &mut String, what: &str, s: &Statistics) {
    if s.count > 0 {
        let _ = writeln!(
            out,
            "{what}: mean {:.3} m, rms {:.3}, median {:.3}, largest {:.3}; along the ground mean {:.3}",
            s.mean_m, s.rms_m, s.median_m, s.max_m, s.ground_mean_m
        );
    }
}
