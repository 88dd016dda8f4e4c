//! Loop closures: places that were visited before, found again from the scans alone.
//!
//! The scans along some metres of path make a place. Seen from above it is an image of what stands where; the magnitude of its Fourier
//! transform does not depend on where in it the sensor was and turns with the heading, so that one correlation compares two places for all
//! headings. The best candidates are aligned by correlating the images themselves, and the best of these are registered in three
//! dimensions. A closure is believed if the surfaces lie on each other, hold the pose in all directions, do not lie in space that the
//! other place saw to be free, and if the poses can be as wrong as it says, by what they got wrong along the way.

mod align;
mod density_image;
mod drift;
mod finder;
mod fine_surface;
mod localiser;
mod overlap;
mod place;
mod place_book;
mod plane_fft;
mod settings;
mod signature;
mod ties;
mod verify;
mod visible;

pub(crate) use align::settings as registration_settings;
pub use finder::{Closure, LoopFinder, Searches, Verdict};
pub use localiser::{Localiser, LocaliserSettings, Located, Whereabouts};
pub(crate) use place::{PlaceScan, levels, surfels, thinned};
pub use place_book::{PlaceBook, PlaceDescriptors, PlacePair};
pub use settings::LoopSettings;
pub use verify::Fit;
pub use visible::MapSurface;
