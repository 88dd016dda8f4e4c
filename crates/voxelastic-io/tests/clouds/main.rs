//! Clouds of every format, good and bad.

mod bad;
mod drivers;
mod encode;
mod formats;
