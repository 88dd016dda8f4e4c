//! Clouds of which no image fits: beams that never repeat (Livox), and clouds that were thinned.
//!
//! Neighbours in an image are no neighbours in space there, or share its pixels. So returns are sorted into cells in space ([`cells`]), neighbours are searched
//! among those of nearby cells ([`neighbours`]), planes are fitted to them ([`plane`]) and chosen ([`planes`]), and the distance between returns that decides the
//! integration scale is measured at each return. Where neighbouring returns lie on one plane, the surface between them is known as well as the plane:
//! [`between`] adds points there, for surfaces only.

mod between;
mod cells;
mod neighbours;
mod plane;
mod planes;

pub(crate) use planes::ScatteredFitter;
