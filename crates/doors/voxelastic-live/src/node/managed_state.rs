//! The state of a managed node, from before there is anything to map.

use crate::ros::lifecycle::{State, Transition};
use crate::ros::services::{NotLoaded, Pending, Request, Response};
use std::cell::Cell;
use std::sync::mpsc::Receiver;

/// The state after a transition of a managed node, given by its number or its label, once `prepare` has done what it needs.
pub fn change(now: Option<State>, id: u8, label: &str, prepare: impl FnOnce(Transition) -> Result<(), String>) -> Result<State, String> {
    let now = now.ok_or("this is no managed node: start it with --lifecycle")?;
    let transition = now.transition(id, label).ok_or_else(|| format!("no transition {id} {label:?} begins where the node is {}", now.label()))?;
    prepare(transition)?;
    tracing::info!("on request: the node is {}", transition.to.label());
    Ok(transition.to)
}

/// A node whose robot is not there yet: a lifecycle manager starts its nodes in its own order, and waits for each.
pub struct Waiting<'a> {
    requests: &'a Receiver<Pending>,
    state: Cell<Option<State>>,
}

impl<'a> Waiting<'a> {
    /// One that is asked by `requests`.
    pub fn new(requests: &'a Receiver<Pending>, is_managed: bool) -> Self {
        Self { requests, state: Cell::new(is_managed.then_some(State::Unconfigured)) }
    }

    /// Answers what was asked.
    pub fn answer(&self) {
        for pending in self.requests.try_iter() {
            let waits = "the topics of the robot are not there yet";
            let response = match &pending.request {
                Request::State => Response::State(self.state().unwrap_or(State::Active)),
                Request::ChangeState(id, label) => Response::Done(change(self.state(), *id, label, |_| Ok(())).map(|state| {
                    self.state.set(Some(state));
                    state.label().to_owned()
                })),
                Request::Plan { .. } => Response::Path(Vec::new()),
                Request::Load(_) => Response::Loaded(Err((NotLoaded::Other, waits.to_owned()))),
                Request::Distances(_) => Response::Distances(Err(waits.to_owned())),
                _ => Response::Done(Err(waits.to_owned())),
            };
            pending.answer(response);
        }
    }

    /// The state of a managed node.
    pub fn state(&self) -> Option<State> {
        self.state.get()
    }
}
