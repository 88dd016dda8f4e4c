//! Distance fields of maps, against exact distances.
// Tests say when they skip, and measurements what they measured.
#![allow(clippy::print_stdout)]

mod simulated;
mod surfaces;
