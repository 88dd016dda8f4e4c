//! Checks of this repository's own sources: imports follow the layers that `ARCHITECTURE.md` draws, files do not depend on each other in
//! cycles, `unsafe` stays in the files that are named for it, and dependencies have licences that go with this project's.
//!
//! `cargo run -p voxelastic-checks` prints what was found: the arrows between crates and rooms with their counts, and the cycles. The tests of this
//! crate fail on what [`layers`] does not allow; [`checks`] says what to do about it.
//!
//! Seen are `use` declarations, re-exports and paths such as `crate::field::Voxel`, in code, in arguments of macros and in strings of attributes
//! (`#[serde(with = "..")]`). References that need type inference, such as calls of methods, are not seen.
//!
//! ```
//! use voxelastic_checks::crate_source::CrateSource;
//!
//! let files = [("lib.rs", "mod a; mod b;"), ("a.rs", "use crate::b::B; pub struct A;"), ("b.rs", "pub struct B(crate::a::A);")];
//! let source = CrateSource::from_files("example", &files);
//! let cycles = voxelastic_checks::cycles::cycles(&source.references());
//! assert_eq!(cycles, [["a.rs", "b.rs"]]);
//! ```

pub mod checks;
pub mod crate_source;
pub mod cycles;
pub mod layers;
pub mod licences;
pub mod manifest;
pub mod module;
