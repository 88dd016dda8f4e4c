//! Minimum and maximum without the extra instructions that NaN handling costs.

/// The larger of two numbers that are not NaN: one instruction, where `f32::max` takes three to handle NaN.
#[inline(always)]
pub(crate) fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The smaller of two numbers that are not NaN.
#[inline(always)]
pub(crate) fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}
