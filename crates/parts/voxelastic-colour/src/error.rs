//! Errors of this crate.

/// Errors of this crate, each with what is wrong and what it should be.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ColourError {
    /// A number of a camera model is impossible.
    #[error("{what} is {value}, but must be {must}")]
    Camera {
        /// Which number: `fx`, `width`, `k1`.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed, in words.
        must: &'static str,
    },
    /// An image has another size than its camera's intrinsics are for.
    #[error("the image has {found_width} x {found_height} pixels, but the intrinsics are for {width} x {height}")]
    Size {
        /// Pixels across.
        found_width: usize,
        /// Pixels down.
        found_height: usize,
        /// Pixels across, of the camera.
        width: usize,
        /// Pixels down, of the camera.
        height: usize,
    },
    /// A texture would be too large.
    #[error("{texels} texels are more than fit into a texture of {most} x {most}")]
    Texture {
        /// Texels of all triangles.
        texels: usize,
        /// Longest side of a texture.
        most: usize,
    },
}

/// Result of this crate.
pub type Result<T> = std::result::Result<T, ColourError>;
