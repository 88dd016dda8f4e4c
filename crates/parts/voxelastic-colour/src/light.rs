//! sRGB (IEC 61966-2-1) and linear light.

use std::sync::LazyLock;

/// Linear light of each sRGB value.
pub(crate) static LINEAR: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|value| {
        let c = value as f64 / 255.0;
        (if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }) as f32
    })
});

/// The sRGB scale, 0 to 1, of linear light.
pub(crate) fn to_scale(linear: f32) -> f32 {
    let c = linear.clamp(0.0, 1.0);
    if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 }
}

/// Linear light, 0 to 1, of an sRGB value.
pub fn to_linear(value: u8) -> f32 {
    LINEAR[usize::from(value)]
}

/// The sRGB value of linear light, 0 to 1.
pub fn to_srgb(linear: f32) -> u8 {
    (to_scale(linear) * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_return() {
        assert!((0..=255u8).all(|value| to_srgb(to_linear(value)) == value));
        assert_eq!((to_srgb(-1.0), to_srgb(7.0)), (0, 255));
    }
}
