//! Closures that bend a map without need, and submaps that lie apart: what would mend them is tried, and the surfaces say whether it does.

use super::suggestion::Suggestion;
use super::survey::Survey;
use crate::editing::closures::ListedClosure;
use crate::editing::list::{Between, Edit};
use crate::editing::pair_fit::{PairFit, misaligned};
use crate::editing::state::State;
use crate::error::Result;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use voxelastic::atlas::SubmapId;
use voxelastic::event::NodeId;

/// Closures without which the map is looked at, those that the poses contradict most; and those of them, and pairs, of which surfaces are compared.
const LOOKED_AT: usize = 48;
const TRIED: usize = 6;
/// By how much a map bends at least that is worth a word, metres and voxels; and where no surface supports the closure.
const LEAST_BENT: (f64, f64) = (0.1, 2.0);
const LEAST_UNSUPPORTED: f64 = 0.3;
/// More places agree if it is this share of all that do; and of the places of the pair that is closed. In a hall whose poses are right to a centimetre, closing a pair that does not
/// fit made 3 to 6 % of its places more agree by chance, and moved scans by 14 cm.
const BETTER: f64 = 0.005;
const BETTER_OF_PAIR: f64 = 0.1;

/// How many places more agree with the edit of a suggestion.
pub type Tried = (u64, Suggestion);

/// How often submaps agree.
fn agreeing(pairs: &[PairFit], voxel: f64) -> u64 {
    pairs.iter().map(|pair| pair.agreeing(voxel)).sum::<f64>().round() as u64
}

/// How many places more agree, if it is worth a word.
fn gain([before, after]: [u64; 2]) -> Option<u64> {
    after.checked_sub(before).filter(|more| *more as f64 > BETTER * before as f64)
}

/// The closures that bend the map, and that no surface supports or without which surfaces agree better.
pub fn of_closures(
    state: &State,
    survey: &mut Survey,
    before: &[PairFit],
    closures: &[ListedClosure],
    tried: &mut (dyn FnMut() + Send),
) -> Result<Vec<Tried>> {
    let voxel = survey.voxel();
    let least = LEAST_BENT.0.max(LEAST_BENT.1 * voxel);
    let without = |closure: &ListedClosure| {
        let mut without = state.clone();
        // One that cannot be taken out is no suggestion.
        let done = without.apply(&mut Edit::RemoveClosure { scans: closure.scans }).ok()?;
        (done.moved_most_m >= least).then_some((done.moved_most_m, closure.scans, without))
    };
    let mut bent: Vec<(f64, [NodeId; 2], State)> = closures.par_iter().take(LOOKED_AT).filter_map(without).collect();
    bent.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let poses = crate::editing::graph::poses(&state.entries);
    let bad: BTreeSet<[SubmapId; 2]> = misaligned(before, voxel).iter().map(|pair| pair.submaps).collect();
    let mut found = Vec::new();
    for (bends, scans, without) in bent.into_iter().take(TRIED) {
        let [a, b] = [state.submap_of(scans[0])?, state.submap_of(scans[1])?];
        let pair = [a.min(b), a.max(b)];
        let is_supported = a == b || before.iter().any(|fit| fit.submaps == pair) && !bad.contains(&pair);
        let both = [agreeing(before, voxel), agreeing(&survey.pairs(&without), voxel)];
        tried();
        let (more, [x, y]) = (gain(both), scans);
        let why = match (more, is_supported) {
            (Some(_), _) => "surfaces agree better without it",
            (None, false) if bends >= LEAST_UNSUPPORTED => "its submaps have no surfaces that agree",
            _ => continue,
        };
        let suggestion = Suggestion {
            code: "closure",
            text: format!("the closure of scans {x} and {y} bends the map by {bends:.2} m, and {why}"),
            at: poses.get(&y).map_or([0.0; 3], |pose| state.origin.point_to_map(pose.translation.vector.into())),
            submaps: if a == b { vec![a] } else { vec![a, b] },
            scans: scans.to_vec(),
            places_agree: Some(both),
            edit: Edit::RemoveClosure { scans }.to_text().trim().to_owned(),
        };
        found.push((more.unwrap_or(0), suggestion));
    }
    Ok(found)
}

/// The pairs of submaps that do not fit, but for those that somebody keeps apart, if surfaces agree better once they are registered: each with the closure between them.
pub fn of_pairs(state: &State, survey: &mut Survey, before: &[PairFit], tried: &mut (dyn FnMut() + Send)) -> Result<Vec<Tried>> {
    let voxel = survey.voxel();
    let mut left: VecDeque<PairFit> = misaligned(before, voxel).into_iter().filter(|pair| !state.are_apart(pair.submaps)).collect();
    let at: BTreeMap<SubmapId, [f64; 3]> =
        state.entries.iter().map(|entry| (entry.id, state.origin.point_to_map(entry.t_map_submap.translation.vector.into()))).collect();
    let mut found = Vec::new();
    for _ in 0..TRIED {
        let Some(pair) = left.pop_front() else { break };
        let mut edit = Edit::Closure { between: Between::Submaps(pair.submaps), start: None, edges: Vec::new() };
        let mut closed = state.clone();
        // Many that do not fit cannot be registered: they saw a wall from either side.
        let after = closed.apply(&mut edit).is_ok().then(|| survey.pairs(&closed));
        tried();
        let Some(after) = after else { continue };
        let both = [agreeing(before, voxel), agreeing(&after, voxel)];
        let Some(more) = gain(both).filter(|more| *more as f64 >= BETTER_OF_PAIR * pair.places as f64) else { continue };
        let [a, b] = pair.submaps;
        let (percent, apart) = (100.0 * pair.matched, 100.0 * pair.apart_m);
        let mut text = format!("submaps {a} and {b} do not fit: {percent:.0} % of {} places agree, {apart:.1} cm apart", pair.places);
        // What the same closure mends is not said again.
        let still: BTreeSet<[SubmapId; 2]> = misaligned(&after, voxel).iter().map(|pair| pair.submaps).collect();
        let count = left.len();
        left.retain(|other| still.contains(&other.submaps));
        if left.len() < count {
            text += &format!("; {} more pairs fit with them", count - left.len());
        }
        let middle = at.get(&a).zip(at.get(&b)).map_or([0.0; 3], |(p, q)| std::array::from_fn(|k| (p[k] + q[k]) / 2.0));
        let suggestion = Suggestion {
            code: "pair",
            text,
            at: middle,
            submaps: pair.submaps.to_vec(),
            scans: Vec::new(),
            places_agree: Some(both),
            edit: edit.to_text().trim().to_owned(),
        };
        found.push((more, suggestion));
    }
    Ok(found)
}
