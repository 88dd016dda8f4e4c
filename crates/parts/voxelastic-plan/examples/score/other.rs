//! The same problems for the planners of the oxmpl library, with our map as their validity checker.
//!
//! They check single states at steps along a motion, here every 5 cm. Their RRT* ends with its first path.

use oxmpl::base::error::StateSamplingError;
use oxmpl::base::goal::{Goal, GoalRegion, GoalSampleableRegion};
use oxmpl::base::planner::{Planner, PlannerConfig};
use oxmpl::base::problem_definition::ProblemDefinition;
use oxmpl::base::space::{RealVectorStateSpace, StateSpace};
use oxmpl::base::state::RealVectorState;
use oxmpl::base::validity::StateValidityChecker;
use oxmpl::geometric::{RRTConnect, RRTStar};
use std::sync::Arc;
use voxelastic_plan::{Effort, FirstPath, Plan, Point, Request, Space, distance, length, shorten};

/// Distance between the states that are checked along a motion, metres.
const STEP: f64 = 0.05;

struct At(RealVectorState);

impl Goal<RealVectorState> for At {
    fn is_satisfied(&self, state: &RealVectorState) -> bool {
        self.distance_goal(state) < 1e-9
    }
}

impl GoalRegion<RealVectorState> for At {
    fn distance_goal(&self, state: &RealVectorState) -> f64 {
        distance(point(&self.0), point(state))
    }
}

impl GoalSampleableRegion<RealVectorState> for At {
    fn sample_goal(&self, _: &mut impl rand::Rng) -> Result<RealVectorState, StateSamplingError> {
        Ok(self.0.clone())
    }
}

fn point(state: &RealVectorState) -> Point {
    std::array::from_fn(|k| state.values[k])
}

/// The library requires checkers with a static lifetime.
struct Fits<S: 'static>(&'static S);

impl<S: Space> StateValidityChecker<RealVectorState> for Fits<S> {
    fn is_valid(&self, state: &RealVectorState) -> bool {
        self.0.state_at(point(state)).is_some()
    }
}

pub fn plan<S: Space>(space: &'static S, request: &Request, name: &str) -> Result<Plan, String> {
    let [low, high] = space.bounds();
    let mut states = RealVectorStateSpace::new(3, Some((0..3).map(|k| (low[k], high[k])).collect())).map_err(|e| e.to_string())?;
    states.set_longest_valid_segment_fraction(STEP / 0.1 / distance(low, high));
    let state = |p: Point| RealVectorState { values: p.to_vec() };
    debug_assert!((states.get_longest_valid_segment_length() * 0.1 - STEP).abs() < 1e-9);
    let problem =
        Arc::new(ProblemDefinition { space: Arc::new(states), start_states: vec![state(request.start)], goal: Arc::new(At(state(request.goal))) });
    let stride = (distance(low, high) / 50.0).clamp(0.5, 4.0);
    let config = PlannerConfig { seed: Some(request.seed) };
    let begun = std::time::Instant::now();
    let path = match name {
        "oxmpl-connect" => solve(RRTConnect::new(stride, 0.05, &config), problem, space, request),
        "oxmpl-star" => solve(RRTStar::new(stride, 0.05, 1.5 * stride, &config), problem, space, request),
        other => Err(format!("there is no planner {other}")),
    }?;
    let first = FirstPath { seconds: begun.elapsed().as_secs_f64(), samples: 0, length: length(&path) };
    let path = shorten(space, path, Effort::Thorough);
    Ok(Plan {
        length: length(&path),
        path,
        clearance: Vec::new(),
        least_clearance: f64::NAN,
        first,
        seconds: begun.elapsed().as_secs_f64(),
        samples: 0,
        tree: Vec::new(),
        height: None,
    })
}

fn solve<S: Space, P: Planner<RealVectorState, RealVectorStateSpace, At>>(
    mut planner: P,
    problem: Arc<ProblemDefinition<RealVectorState, RealVectorStateSpace, At>>,
    space: &'static S,
    request: &Request,
) -> Result<Vec<Point>, String> {
    planner.setup(problem, Arc::new(Fits(space)));
    let path = planner.solve(request.time).map_err(|e| e.to_string())?;
    Ok(path.0.iter().map(point).collect())
}
