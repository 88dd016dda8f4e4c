//! What the sources must keep to.
// Tests say when they skip, and measurements what they measured.
#![allow(clippy::print_stdout)]

mod layers;
mod licences;
