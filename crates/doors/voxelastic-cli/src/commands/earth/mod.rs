//! A map's place on Earth.

pub mod georeference;
mod table;
