//! Comparison of a map with the truth: the paper's protocol (Sec. V-A) and more.
//!
//! The paper aligns the vertices of the map's mesh to a survey cloud downsampled to 5 cm and reports point-to-point distances. These do not show what
//! the map lacks, and their resolution is limited by the spacing of the survey. So completeness and F-scores are computed as well, and exact
//! distances where the truth is an analytic world.

use crate::align::{AlignQuality, AlignSettings, align, moved};
use crate::cloud_distance::{PointIndex, downsample};
use crate::mesh::MeshView;
use crate::mesh_distance::MeshIndex;
use crate::stats::{DistanceStats, fraction_under};
use crate::{EvalError, error::Result};
use rayon::prelude::*;
use serde::Serialize;
use voxelastic::Pose;

/// The map to evaluate, in the map frame.
#[derive(Clone, Copy, Debug)]
pub enum Map<'a> {
    /// A cloud (of vertices, of occupied voxels).
    Points(&'a [[f32; 3]]),
    /// A mesh: accuracy is measured at its vertices, completeness to its surface.
    Mesh(MeshView<'a>),
}

impl<'a> Map<'a> {
    fn points(&self) -> &'a [[f32; 3]] {
        match self {
            Self::Points(points) => points,
            Self::Mesh(mesh) => mesh.vertices(),
        }
    }
}

/// The reference, in the truth's frame.
#[derive(Clone, Copy)]
pub struct Truth<'a> {
    /// Points of the true surface (a survey, or samples of a mesh or world), metres.
    pub points: &'a [[f32; 3]],
    /// Whether the sensor could see each point; all of them when absent. Only visible points count for completeness.
    pub visible: Option<&'a [bool]>,
    /// Exact distance from a point to the true surface, metres, if the truth is given as a function. May be signed.
    pub distance: Option<&'a (dyn Fn([f32; 3]) -> f32 + Sync)>,
}

/// Settings of [`compare`].
#[derive(Clone, Debug)]
pub struct CompareSettings {
    /// Alignment of the map to the truth before the comparison; `None` when both are in one frame (a simulated world).
    pub align: Option<AlignSettings>,
    /// The truth is downsampled to one point per voxel of this edge, metres. Default 0.05, as in the paper.
    pub truth_voxel: f32,
    /// Distances beyond this are misses, metres; default none.
    pub cut_off: f32,
    /// Most points of the map at which accuracy is measured, evenly sampled; default all. Completeness always uses the whole map.
    pub max_points: usize,
    /// Distance thresholds of the F-scores, metres. Default 0.05, 0.1, 0.2, 0.5.
    pub thresholds: Vec<f32>,
}

impl Default for CompareSettings {
    fn default() -> Self {
        Self {
            align: Some(AlignSettings::default()),
            truth_voxel: 0.05,
            cut_off: f32::INFINITY,
            max_points: usize::MAX,
            thresholds: vec![0.05, 0.1, 0.2, 0.5],
        }
    }
}

/// Precision, recall and F-score at one threshold.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FScore {
    /// The threshold, metres.
    pub threshold_m: f64,
    /// Share of the map within the threshold of the truth.
    pub precision: f64,
    /// Share of the visible truth within the threshold of the map.
    pub recall: f64,
    /// Harmonic mean of the two; 0 when both are.
    pub f_score: f64,
}

/// Result of [`compare`], with stable JSON keys; all distances in metres.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    /// Points of the map.
    pub map_points: usize,
    /// Points of the truth after downsampling.
    pub truth_points: usize,
    /// Visible points of the truth after downsampling, which count for completeness.
    pub visible_points: usize,
    /// Pose of the map in the truth's frame by the alignment.
    pub alignment: Option<AlignmentSummary>,
    /// Map to truth, point to point (the paper's figure).
    pub accuracy: DistanceStats,
    /// Map to truth by the exact distance, if the truth is a function.
    pub accuracy_exact: Option<DistanceStats>,
    /// Visible truth to map: to its surface when it is a mesh, otherwise point to point.
    pub completeness: DistanceStats,
    /// F-scores; precision uses the exact distance if there is one.
    pub f_scores: Vec<FScore>,
    /// Distance of each measured map point (the exact one if there is one), in input order: for colouring.
    #[serde(skip)]
    pub errors: Vec<f32>,
    /// Maps map to truth coordinates.
    #[serde(skip)]
    pub t_truth_map: Pose,
}

/// The alignment in a [`Comparison`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AlignmentSummary {
    /// Position of the map frame in the truth's frame, metres.
    pub translation: [f64; 3],
    /// Its orientation, x y z w.
    pub quaternion: [f64; 4],
    /// Quality of the fit.
    #[serde(flatten)]
    pub quality: AlignQuality,
}

/// Compares a map with the truth.
///
/// # Errors
/// [`EvalError::Empty`] when the map or the (visible) truth has no points; [`EvalError::Length`] for a wrong number of flags; those of
/// [`align`]; [`EvalError::Setting`] for a voxel size that is not positive.
pub fn compare(map: Map<'_>, truth: &Truth<'_>, settings: &CompareSettings) -> Result<Comparison> {
    let reference = downsample(truth.points, settings.truth_voxel)?;
    let truth_index = PointIndex::new(&reference, "the truth")?;
    let (t_truth_map, alignment) = aligned(map.points(), &reference, settings)?;
    let points = moved(map.points(), &t_truth_map);
    let visible = visible(truth, &reference, settings)?;

    let sample: Vec<[f32; 3]> = points.iter().step_by(points.len().div_ceil(settings.max_points.max(1)).max(1)).copied().collect();
    let to_truth = truth_index.distances(&sample, settings.cut_off);
    let exact: Option<Vec<f32>> = truth.distance.map(|f| exact_errors(&sample, f));
    let to_map = match map {
        Map::Points(_) => PointIndex::new(&points, "the map")?.distances(&visible, settings.cut_off),
        Map::Mesh(mesh) => MeshIndex::new(&MeshView::new(&points, mesh.triangles())?)?.distances(&visible, settings.cut_off),
    };
    let errors = exact.as_ref().unwrap_or(&to_truth);
    Ok(Comparison {
        map_points: points.len(),
        truth_points: reference.len(),
        visible_points: visible.len(),
        alignment,
        accuracy: DistanceStats::new(&to_truth),
        accuracy_exact: exact.as_deref().map(DistanceStats::new),
        completeness: DistanceStats::new(&to_map),
        f_scores: settings.thresholds.iter().map(|&t| f_score(errors, &to_map, t)).collect(),
        errors: errors.clone(),
        t_truth_map,
    })
}

/// Absolute distance of each point to the true surface by a distance function, metres; NaN for points that are not finite.
pub fn exact_errors(points: &[[f32; 3]], distance: &(dyn Fn([f32; 3]) -> f32 + Sync)) -> Vec<f32> {
    points.par_iter().map(|p| if p.iter().all(|c| c.is_finite()) { distance(*p).abs() } else { f32::NAN }).collect()
}

fn aligned(map: &[[f32; 3]], truth: &[[f32; 3]], settings: &CompareSettings) -> Result<(Pose, Option<AlignmentSummary>)> {
    if !map.iter().any(|p| p.iter().all(|c| c.is_finite())) {
        return Err(EvalError::Empty { what: "the map", of: "points" });
    }
    let Some(how) = &settings.align else { return Ok((Pose::identity(), None)) };
    let found = align(map, truth, how)?;
    let (t, q) = (found.t_target_source.translation.vector, found.t_target_source.rotation.coords);
    let summary = AlignmentSummary { translation: t.into(), quaternion: q.into(), quality: found.quality };
    Ok((found.t_target_source, Some(summary)))
}

/// The downsampled truth that counts for completeness.
fn visible(truth: &Truth<'_>, reference: &[[f32; 3]], settings: &CompareSettings) -> Result<Vec<[f32; 3]>> {
    let Some(flags) = truth.visible else { return Ok(reference.to_vec()) };
    if flags.len() != truth.points.len() {
        return Err(EvalError::Length { what: "visibility flags of the truth", got: flags.len(), expected: truth.points.len() });
    }
    let visible: Vec<[f32; 3]> = truth.points.iter().zip(flags).filter(|(_, f)| **f).map(|(p, _)| *p).collect();
    let visible = downsample(&visible, settings.truth_voxel)?;
    if visible.is_empty() { Err(EvalError::Empty { what: "the visible truth", of: "points" }) } else { Ok(visible) }
}

fn f_score(to_truth: &[f32], to_map: &[f32], threshold: f32) -> FScore {
    let precision = fraction_under(to_truth, threshold).unwrap_or(0.0);
    let recall = fraction_under(to_map, threshold).unwrap_or(0.0);
    let sum = precision + recall;
    let f_score = if sum > 0.0 { 2.0 * precision * recall / sum } else { 0.0 };
    FScore { threshold_m: f64::from((threshold * 1e6).round()) / 1e6, precision, recall, f_score }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};

    /// The floor z = 0 over 10 x 10 m as a grid of `step`, at height `z`.
    fn floor(step: f32, z: f32) -> Vec<[f32; 3]> {
        let n = (10.0 / step).round() as usize;
        (0..n * n).map(|i| [((i % n) as f32 + 0.5) * step, ((i / n) as f32 + 0.5) * step, z]).collect()
    }

    fn unaligned() -> CompareSettings {
        CompareSettings { align: None, ..CompareSettings::default() }
    }

    #[test]
    fn scores_of_half_a_map_one_centimetre_too_high() {
        let truth = floor(0.02, 0.0);
        let map: Vec<[f32; 3]> = floor(0.05, 0.01).into_iter().filter(|p| p[0] < 5.0).collect();
        let distance = |p: [f32; 3]| p[2];
        let t = Truth { points: &truth, visible: None, distance: Some(&distance) };
        let c = compare(Map::Points(&map), &t, &unaligned()).unwrap();
        assert!((c.accuracy_exact.as_ref().unwrap().mean.unwrap() - 0.01).abs() < 1e-6);
        assert!(c.accuracy.p90.unwrap() < 0.045 && c.accuracy.mean.unwrap() >= 0.01);
        let f = &c.f_scores[0];
        assert_eq!(f.precision, 1.0);
        assert!((f.recall - 0.5).abs() < 0.02 && (f.f_score - 2.0 / 3.0).abs() < 0.02, "{f:?}");
        let seen: Vec<bool> = truth.iter().map(|p| p[0] < 5.0).collect();
        let c = compare(Map::Points(&map), &Truth { visible: Some(&seen), ..t }, &unaligned()).unwrap();
        assert!(c.f_scores[0].recall > 0.99 && c.visible_points.abs_diff(c.truth_points / 2) < 300);
    }

    #[test]
    fn sample_of_points_gives_similar_statistics() {
        let truth = floor(0.05, 0.0);
        let map: Vec<[f32; 3]> = floor(0.1, 0.01).into_iter().enumerate().map(|(i, [x, y, z])| [x, y, z * (1 + i % 3) as f32]).collect();
        let distance = |p: [f32; 3]| p[2];
        let t = Truth { points: &truth, visible: None, distance: Some(&distance) };
        let all = compare(Map::Points(&map), &t, &unaligned()).unwrap();
        let some = compare(Map::Points(&map), &t, &CompareSettings { max_points: 1000, ..unaligned() }).unwrap();
        let mean = |c: &Comparison| c.accuracy_exact.as_ref().unwrap().mean.unwrap();
        assert!((mean(&all) - mean(&some)).abs() < 5e-4 && (500..=1000).contains(&some.errors.len()), "{}", some.errors.len());
        assert_eq!((some.map_points, &some.completeness), (all.map_points, &all.completeness));
    }

    #[test]
    fn completeness_of_a_mesh_is_measured_to_its_surface() {
        let corners = [[0.0, 0.0, 0.02], [10.0, 0.0, 0.02], [10.0, 10.0, 0.02], [0.0, 10.0, 0.02]];
        let mesh = MeshView::new(&corners, &[[0, 1, 2], [0, 2, 3]]).unwrap();
        let truth = floor(0.05, 0.0);
        let c = compare(Map::Mesh(mesh), &Truth { points: &truth, visible: None, distance: None }, &unaligned()).unwrap();
        assert!((c.completeness.max.unwrap() - 0.02).abs() < 1e-6);
    }

    #[test]
    fn alignment_is_applied_and_reported() {
        let truth = crate::align::tests::building(11, 80_000);
        let t = Pose::from_parts(Translation3::new(0.5, -0.3, 0.2), UnitQuaternion::from_euler_angles(0.0, 0.01, 0.04));
        let map = moved(&crate::align::tests::building(12, 30_000), &t.inverse());
        let c = compare(Map::Points(&map), &Truth { points: &truth, visible: None, distance: None }, &CompareSettings::default()).unwrap();
        assert!((c.t_truth_map.translation.vector - t.translation.vector).norm() < 0.01);
        let json = serde_json::to_value(&c).unwrap();
        for key in ["map_points", "truth_points", "visible_points", "alignment", "accuracy", "accuracy_exact", "completeness", "f_scores"] {
            assert!(json.get(key).is_some(), "{key}");
        }
        assert!(json["alignment"]["converged"].as_bool().unwrap() && json.get("errors").is_none());
        assert_eq!(json["f_scores"][0]["threshold_m"], 0.05);
    }

    #[test]
    fn empty_inputs_and_wrong_flags_are_rejected() {
        let cloud = floor(0.5, 0.0);
        let truth = Truth { points: &cloud, visible: None, distance: None };
        assert!(matches!(compare(Map::Points(&[]), &truth, &unaligned()), Err(EvalError::Empty { what: "the map", .. })));
        assert!(matches!(
            compare(Map::Points(&cloud), &Truth { points: &[], ..truth }, &unaligned()),
            Err(EvalError::Empty { what: "the truth", .. })
        ));
        assert!(matches!(compare(Map::Points(&cloud), &Truth { visible: Some(&[true]), ..truth }, &unaligned()), Err(EvalError::Length { .. })));
    }
}
