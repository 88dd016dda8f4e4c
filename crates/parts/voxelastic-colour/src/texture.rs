//! Where the triangles of a mesh lie in a texture.
//!
//! Each triangle has a patch of its own: a right triangle of texels with legs of some texels, more for larger triangles. Two of them make a rectangle, and
//! rectangles of one size fill rows. Corners lie in the middle of texels, and a diagonal of texels beyond the longest edge belongs to the patch, too, so that
//! bilinear filtering never mixes in the texels of another triangle.

use crate::painter::Surface;
use crate::{ColourError, Result};

/// Numbers of steps between the corners of a patch.
const STEPS: [u8; 8] = [1, 2, 3, 4, 6, 8, 12, 16];
/// Longest side of a texture, texels: what graphics cards take.
const LONGEST: usize = 8192;

/// The place of a triangle's patch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Patch {
    /// The lowest column and row of the rectangle.
    corner: [u16; 2],
    /// Steps from corner to corner of the triangle.
    steps: u8,
    /// Whether it is the second one in its rectangle, turned by half a turn.
    is_second: bool,
}

/// A texel of a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Texel {
    /// Its place in the texture, row by row.
    pub at: usize,
    /// Which part of each corner is in it; a little outside of the triangle they are negative.
    pub shares: [f32; 3],
}

/// The places of all triangles of a mesh in a texture.
#[derive(Clone, Debug)]
pub struct TextureLayout {
    size: [usize; 2],
    patches: Vec<Patch>,
}

impl Patch {
    /// Texels along a leg, with the diagonal that is beyond.
    fn leg(self) -> usize {
        usize::from(self.steps) + 2
    }

    /// Column and row of the texel `i` steps along the first leg and `j` along the second.
    fn texel(self, [i, j]: [usize; 2]) -> [usize; 2] {
        let [x, y] = self.corner.map(usize::from);
        let leg = self.leg();
        if self.is_second { [x + leg - i, y + leg - 1 - j] } else { [x + i, y + j] }
    }

    /// Number of texels.
    pub(crate) fn texels(self) -> usize {
        self.leg() * (self.leg() + 1) / 2
    }
}

/// The patch of a triangle with texels about `texel` metres apart, without its place.
pub(crate) fn patch_for(surface: &Surface<'_>, triangle: &[u32; 3], texel: f32) -> Patch {
    let corner = |k: usize| surface.positions[triangle[k % 3] as usize];
    let length = |k: usize| (0..3).map(|axis| (corner(k)[axis] - corner(k + 1)[axis]).powi(2)).sum::<f32>().sqrt();
    let wanted = (0..3).map(length).fold(0.0, f32::max) / texel;
    let steps = STEPS.into_iter().find(|steps| f32::from(*steps) >= wanted).unwrap_or(STEPS[STEPS.len() - 1]);
    Patch { steps, ..Patch::default() }
}

impl TextureLayout {
    /// A layout for all triangles of `surface`, with texels about `texel` metres apart, up to sixteen on an edge.
    ///
    /// # Errors
    /// [`ColourError::Texture`] if it would be larger than 8192 x 8192.
    pub fn new(surface: &Surface<'_>, texel: f32) -> Result<Self> {
        let mut patches: Vec<Patch> = surface.triangles.iter().map(|t| patch_for(surface, t, texel)).collect();
        let counts = STEPS.map(|steps| patches.iter().filter(|patch| patch.steps == steps).count());
        let width = width_for(&counts);
        let mut row = 0;
        for (steps, count) in STEPS.into_iter().zip(counts) {
            let leg = Patch { steps, ..Patch::default() }.leg();
            let across = width / (leg + 1);
            for (n, patch) in patches.iter_mut().filter(|patch| patch.steps == steps).enumerate() {
                let [x, y] = [n / 2 % across * (leg + 1), row + n / 2 / across * leg];
                // Sides that are too long are refused below.
                (patch.corner, patch.is_second) = ([x as u16, y as u16], n % 2 == 1);
            }
            row += count.div_ceil(2).div_ceil(across) * leg;
        }
        if width.max(row) > LONGEST {
            let texels: usize = patches.iter().map(|patch| patch.texels()).sum();
            return Err(ColourError::Texture { texels, most: LONGEST });
        }
        Ok(Self { size: [width, row.max(1)], patches })
    }

    /// Columns and rows.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// Number of texels of a triangle.
    pub fn texels(&self, triangle: usize) -> usize {
        self.patches[triangle].texels()
    }

    /// Where the corners of a triangle lie, 0 to 1 from the left and from the top.
    pub fn corners(&self, triangle: usize) -> [[f32; 2]; 3] {
        let patch = self.patches[triangle];
        let end = usize::from(patch.steps);
        [[0, 0], [end, 0], [0, end]].map(|at| {
            let texel = patch.texel(at);
            std::array::from_fn(|k| (texel[k] as f32 + 0.5) / self.size[k] as f32)
        })
    }

    /// The texels of a triangle.
    pub fn of(&self, triangle: usize) -> impl Iterator<Item = Texel> + '_ {
        let patch = self.patches[triangle];
        let (leg, per_step) = (patch.leg(), 1.0 / f32::from(patch.steps));
        (0..leg).flat_map(move |j| (0..leg - j).map(move |i| [i, j])).map(move |[i, j]| {
            let [x, y] = patch.texel([i, j]);
            let [b, c] = [i, j].map(|n| n as f32 * per_step);
            Texel { at: y * self.size[0] + x, shares: [1.0 - b - c, b, c] }
        })
    }
}

/// The least power of two that is at least as large as the height that comes of it.
fn width_for(counts: &[usize; STEPS.len()]) -> usize {
    let height = |width: usize| -> usize {
        let of = |(steps, count): (u8, &usize)| {
            let leg = usize::from(steps) + 2;
            count.div_ceil(2).div_ceil(width / (leg + 1)) * leg
        };
        STEPS.into_iter().zip(counts).map(of).sum()
    };
    let mut width = 64;
    while height(width) > width && width < LONGEST {
        width *= 2;
    }
    width
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_two_triangles_share_a_texel_and_filtering_stays_within_one(sizes in prop::collection::vec(0.01f32..2.0, 1..400)) {
            let positions: Vec<[f32; 3]> = sizes.iter().flat_map(|s| [[0.0; 3], [*s, 0.0, 0.0], [0.0, *s, 0.0]]).collect();
            let triangles: Vec<[u32; 3]> = (0..sizes.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
            let normals = vec![[0.0, 0.0, 1.0]; positions.len()];
            let layout = TextureLayout::new(&Surface { positions: &positions, normals: &normals, triangles: &triangles }, 0.1).unwrap();
            let [width, height] = layout.size();
            let mut owner = vec![usize::MAX; width * height];
            for t in 0..triangles.len() {
                let mut count = 0;
                for texel in layout.of(t) {
                    prop_assert_eq!(std::mem::replace(&mut owner[texel.at], t), usize::MAX);
                    prop_assert!((texel.shares.iter().sum::<f32>() - 1.0).abs() < 1e-5);
                    count += 1;
                }
                prop_assert_eq!(count, layout.texels(t));
            }
            for t in 0..triangles.len() {
                let corners = layout.corners(t);
                for (a, b) in (0..=20).flat_map(|a| (0..=20 - a).map(move |b| (a, b))) {
                    let shares = [20 - a - b, a, b].map(|n| n as f32 / 20.0);
                    let at: [f32; 2] = std::array::from_fn(|k| (0..3).map(|c| shares[c] * corners[c][k]).sum::<f32>() * layout.size()[k] as f32 - 0.5);
                    for (i, j) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                        let texel = [at[0].floor() + i as f32, at[1].floor() + j as f32];
                        let weight = (1.0 - (at[0] - texel[0]).abs()) * (1.0 - (at[1] - texel[1]).abs());
                        if weight > 1e-3 {
                            prop_assert_eq!(owner[texel[1] as usize * width + texel[0] as usize], t);
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn texels_are_as_far_apart_as_wanted() {
        let positions = [[0.0; 3], [0.3, 0.0, 0.0], [0.0, 0.3, 0.0]];
        let surface = Surface { positions: &positions, normals: &[[0.0, 0.0, 1.0]; 3], triangles: &[[0, 1, 2]] };
        // The longest edge is 0.42 m.
        let texels = |texel: f32| TextureLayout::new(&surface, texel).unwrap().texels(0);
        assert_eq!([texels(1.0), texels(0.43), texels(0.11), texels(0.05), texels(0.001)], [6, 6, 21, 105, 171]);
    }

    #[test]
    fn what_does_not_fit_into_8192_texels_is_refused() {
        let positions = [[0.0; 3], [3.0, 0.0, 0.0], [0.0, 3.0, 0.0]];
        let layout = |count: usize| {
            let triangles = vec![[0, 1, 2]; count];
            TextureLayout::new(&Surface { positions: &positions, normals: &[[0.0, 0.0, 1.0]; 3], triangles: &triangles }, 0.1)
        };
        // 171 texels each.
        assert_eq!(layout(380_000).unwrap().size()[0], 8192);
        let error = layout(400_000).unwrap_err().to_string();
        assert_eq!(error, "68400000 texels are more than fit into a texture of 8192 x 8192");
    }
}
