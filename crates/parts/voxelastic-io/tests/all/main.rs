//! Files, folders, recordings and the map on disk: what is read, what is refused, and what other programs say.
// Tests say when they skip, and measurements what they measured.
#![allow(clippy::print_stdout, clippy::print_stderr)]

mod bags;
mod common;
mod files;
mod folders;
mod real_data;
mod store;
