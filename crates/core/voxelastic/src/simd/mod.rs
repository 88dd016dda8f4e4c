//! Helpers for loops that the compiler vectorises: run-time dispatch to AVX2 and AVX-512, branch-free maths, bit sets.
//!
//! A hot loop is written as a [`Kernel`] and run by [`dispatch`]. Results have the same bits with every instruction set.

pub(crate) mod bits;
mod dispatch;
mod floor;
mod gather;
mod min_max;
mod trig;

pub use dispatch::vector_instructions;
pub(crate) use dispatch::{Kernel, dispatch};
pub(crate) use floor::floor_positive;
pub(crate) use gather::gather;
pub(crate) use min_max::{larger, smaller};
pub(crate) use trig::atan2;
