//! The map store: what comes back, what is refused, and what is left in the directory.

// Tests say what they skipped, measurements what they measured.
#![allow(clippy::print_stdout)]

mod checkpoint;
mod compat;
mod damage;
mod directory;
mod hall;
mod python_reader;
mod repair;
mod resume;
mod roundtrip;
mod world;
