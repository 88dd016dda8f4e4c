//! Why a setting is refused.

/// Why a setting was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SettingError {
    /// There is no setting of that name.
    #[error("there is no setting `{key}`; did you mean `{nearest}`?")]
    UnknownKey {
        /// The name given.
        key: String,
        /// The setting whose name is most like it.
        nearest: &'static str,
    },
    /// The value is not of the right kind, or not in its range.
    #[error("{key} = {value}: must be {allowed}")]
    BadValue {
        /// The setting.
        key: &'static str,
        /// The value given.
        value: String,
        /// What it may be, with the unit.
        allowed: String,
    },
    /// Two settings contradict each other.
    #[error("{key} = {value}: {reason}")]
    Contradiction {
        /// One of the settings.
        key: &'static str,
        /// Its value.
        value: String,
        /// What is wrong, and what to change.
        reason: String,
    },
}
