//! What a map is made of: the manifest, as text and as values.

pub(super) mod details;
pub(super) mod manifest;
pub(super) mod manifest_text;
pub(super) mod piece;
pub(super) mod pose_as_numbers;
