//! Maps that bend, and maps of several sessions.

pub(super) mod changes;
pub(super) mod corrections;
pub(super) mod edited_maps;
pub(super) mod editing;
pub(super) mod editor_access;
pub(super) mod editor_hand;
pub(super) mod editor_page;
pub(super) mod refine;
pub(super) mod sessions;
pub(super) mod slam;
pub(super) mod suggestions;
