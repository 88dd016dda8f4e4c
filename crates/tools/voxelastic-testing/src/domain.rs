//! Domains of ROS 2 that no other test of this machine uses at the same time.

use std::net::TcpListener;

/// Domains that can be had, and the port that stands for the first: who listens there has it.
const FIRST: u16 = 20;
const COUNT: u16 = 200;
const FIRST_PORT: u16 = 20_900;

/// A domain of ROS 2, until it is dropped.
#[derive(Debug)]
pub struct Domain {
    number: u16,
    _held: TcpListener,
}

impl Domain {
    /// One that no other test has.
    ///
    /// # Panics
    /// When all are taken.
    pub fn free() -> Self {
        let held = |k: u16| TcpListener::bind(("127.0.0.1", FIRST_PORT + k)).ok().map(|held| Self { number: FIRST + k, _held: held });
        (0..COUNT).find_map(held).expect("all domains are taken")
    }

    /// Its number.
    pub fn number(&self) -> u16 {
        self.number
    }
}
