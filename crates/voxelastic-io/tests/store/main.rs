//! The map store: what comes back, what is refused, and what is left in the directory.

mod compat;
mod damage;
mod directory;
mod hall;
mod roundtrip;
mod world;
