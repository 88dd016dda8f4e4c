//! Nodes as others see them: sensors, viewers, requests, and robots that go where they are sent.
// Tests say when they skip, and measurements what they measured.
#![allow(clippy::print_stdout)]

mod browser;
mod common;
mod corrections;
mod explore;
mod node;
mod ouster;
mod spinning;
