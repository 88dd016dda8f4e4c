//! The states of a managed node, and the transitions between them.
//!
//! Unconfigured and inactive nodes take no scans; cleaning up drops the map; a node that is shut down saves it and ends.

/// A state that a node can be in, with the number that `lifecycle_msgs/State` has for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// It was started.
    Unconfigured = 1,
    /// It is ready.
    Inactive = 2,
    /// It maps.
    Active = 3,
    /// It ends.
    Finalized = 4,
}

/// All states.
pub const STATES: [State; 4] = [State::Unconfigured, State::Inactive, State::Active, State::Finalized];

/// From one state to another, with the number that `lifecycle_msgs/Transition` has for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transition {
    /// The number.
    pub id: u8,
    /// The name.
    pub label: &'static str,
    /// Where it begins.
    pub from: State,
    /// Where it leads.
    pub to: State,
}

/// All transitions.
pub const TRANSITIONS: [Transition; 7] = {
    use State::{Active, Finalized, Inactive, Unconfigured};
    [
        Transition { id: 1, label: "configure", from: Unconfigured, to: Inactive },
        Transition { id: 2, label: "cleanup", from: Inactive, to: Unconfigured },
        Transition { id: 3, label: "activate", from: Inactive, to: Active },
        Transition { id: 4, label: "deactivate", from: Active, to: Inactive },
        Transition { id: 5, label: "shutdown", from: Unconfigured, to: Finalized },
        Transition { id: 6, label: "shutdown", from: Inactive, to: Finalized },
        Transition { id: 7, label: "shutdown", from: Active, to: Finalized },
    ]
};

impl State {
    /// Its name.
    pub fn label(self) -> &'static str {
        match self {
            Self::Unconfigured => "unconfigured",
            Self::Inactive => "inactive",
            Self::Active => "active",
            Self::Finalized => "finalized",
        }
    }

    /// The transition with a number or, if it is not empty, with a label, from this state; none if there is none.
    pub fn transition(self, id: u8, label: &str) -> Option<Transition> {
        let is_meant = |transition: &&Transition| if label.is_empty() { transition.id == id } else { transition.label == label };
        TRANSITIONS.iter().filter(|transition| transition.from == self).find(is_meant).copied()
    }
}

impl Transition {
    /// Whether the map is dropped by it.
    pub fn cleans_up(self) -> bool {
        self.to == State::Unconfigured
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn states_follow_each_other_as_in_ros() {
        let mut state = State::Unconfigured;
        assert_eq!(state.transition(3, ""), None, "not before it is configured");
        for (id, label, then) in [(1, "", State::Inactive), (0, "activate", State::Active), (4, "", State::Inactive), (2, "", State::Unconfigured)] {
            let transition = state.transition(id, label).unwrap();
            assert_eq!((transition.to, transition.cleans_up()), (then, id == 2));
            state = then;
        }
        assert!(STATES[..3].iter().all(|state| state.transition(0, "shutdown").is_some_and(|transition| transition.to == State::Finalized)));
        assert_eq!(State::Finalized.transition(1, "shutdown"), None);
    }
}
