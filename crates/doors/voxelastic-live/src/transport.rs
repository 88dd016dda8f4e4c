//! Where inputs come from.

use voxelastic_run::Input;

/// A source of inputs: a recording, or a robot's middleware.
pub trait Transport: Send {
    /// The next input; waits for it. None when there will be none any more, or when `is_stopped` has become true, which it asks at least
    /// ten times a second while it waits.
    fn next(&mut self, is_stopped: &dyn Fn() -> bool) -> Option<Input>;
}
