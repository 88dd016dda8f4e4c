//! Colours: perceptually uniform ramps for numbers, and a palette for categories.

use std::sync::OnceLock;

/// An sRGB colour, 8 bits a channel.
pub type Rgb = [u8; 3];

/// A ramp from numbers in 0..=1 to colours. Neighbouring control points are blended in OKLab, so that equal steps look equally large.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ramp {
    /// Violet over teal to yellow, rising in lightness: for any scalar, also printed in grey.
    Violet,
    /// Blue over green and yellow to red: shows fine structure.
    Rainbow,
    /// Teal (small) over cream to red and black (large): for errors.
    Error,
    /// Slate over sand to brick and cream: for heights of buildings and land.
    Land,
    /// Dark to light grey: for intensity.
    Grey,
}

const VIOLET: &[Rgb] = &[[46, 14, 84], [62, 68, 140], [38, 122, 144], [52, 174, 118], [172, 214, 60], [254, 232, 66]];
const RAINBOW: &[Rgb] = &[[52, 28, 96], [62, 108, 228], [36, 188, 222], [88, 226, 116], [224, 218, 56], [246, 122, 36], [142, 18, 14]];
const ERROR: &[Rgb] = &[[14, 104, 112], [88, 178, 158], [244, 236, 196], [240, 150, 70], [192, 40, 44], [58, 6, 28]];
const LAND: &[Rgb] = &[[104, 124, 150], [124, 164, 166], [184, 200, 168], [228, 204, 152], [212, 134, 94], [248, 240, 228]];
const GREY: &[Rgb] = &[[28, 28, 30], [245, 245, 242]];

impl Ramp {
    /// The colour at `t`, clamped to 0..=1; grey for NaN.
    pub fn at(self, t: f32) -> Rgb {
        if t.is_nan() {
            return [150, 150, 150];
        }
        self.table()[(t.clamp(0.0, 1.0) * 255.0).round() as usize]
    }

    fn table(self) -> &'static [Rgb; 256] {
        static TABLES: [OnceLock<[Rgb; 256]>; 5] = [const { OnceLock::new() }; 5];
        let (slot, stops) = match self {
            Self::Violet => (0, VIOLET),
            Self::Rainbow => (1, RAINBOW),
            Self::Error => (2, ERROR),
            Self::Land => (3, LAND),
            Self::Grey => (4, GREY),
        };
        TABLES[slot].get_or_init(|| std::array::from_fn(|i| blend(stops, i as f32 / 255.0)))
    }
}

/// Colours of the absolute values of errors in metres on [`Ramp::Error`]: 0 is teal, `worst` and beyond is darkest, NaN is grey.
pub fn error_colours(errors: &[f32], worst: f32) -> Vec<Rgb> {
    errors.iter().map(|e| Ramp::Error.at(e.abs() / worst.max(1e-9))).collect()
}

/// A colour for the `i`-th category (submap, curve): hues a golden angle apart.
pub fn palette(i: usize) -> Rgb {
    const FIRST: [Rgb; 8] =
        [[38, 110, 180], [226, 112, 46], [58, 152, 88], [196, 62, 84], [126, 94, 176], [150, 116, 84], [32, 160, 170], [206, 160, 40]];
    if let Some(c) = FIRST.get(i) {
        return *c;
    }
    let hue = (i as f32 * 2.399_963).rem_euclid(std::f32::consts::TAU);
    let (light, chroma) = (0.52 + 0.11 * (i % 3) as f32, 0.13);
    from_oklab([light, chroma * hue.cos(), chroma * hue.sin()])
}

fn blend(stops: &[Rgb], t: f32) -> Rgb {
    let x = t * (stops.len() - 1) as f32;
    let i = (x as usize).min(stops.len() - 2);
    let (a, b, f) = (to_oklab(stops[i]), to_oklab(stops[i + 1]), x - i as f32);
    from_oklab(std::array::from_fn(|k| a[k] + (b[k] - a[k]) * f))
}

/// sRGB channel to linear light, 0..=1.
pub(crate) fn to_linear(c: u8) -> f32 {
    static TABLE: OnceLock<[f32; 256]> = OnceLock::new();
    TABLE.get_or_init(|| {
        std::array::from_fn(|i| {
            let c = i as f32 / 255.0;
            if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
        })
    })[c as usize]
}

/// Linear light to an sRGB channel; clamped.
pub(crate) fn from_linear(l: f32) -> u8 {
    let l = l.clamp(0.0, 1.0);
    let c = if l <= 0.003_130_8 { l * 12.92 } else { 1.055 * l.powf(1.0 / 2.4) - 0.055 };
    (c * 255.0).round() as u8
}

// OKLab: B. Ottosson, "A perceptual color space for image processing", 2020.
fn to_oklab(c: Rgb) -> [f32; 3] {
    let [r, g, b] = c.map(to_linear);
    let l = (0.412_221_46 * r + 0.536_332_55 * g + 0.051_445_995 * b).cbrt();
    let m = (0.211_903_5 * r + 0.680_699_5 * g + 0.107_396_96 * b).cbrt();
    let s = (0.088_302_46 * r + 0.281_718_85 * g + 0.629_978_7 * b).cbrt();
    [
        0.210_454_26 * l + 0.793_617_8 * m - 0.004_072_047 * s,
        1.977_998_5 * l - 2.428_592_2 * m + 0.450_593_7 * s,
        0.025_904_037 * l + 0.782_771_77 * m - 0.808_675_77 * s,
    ]
}

fn from_oklab([light, a, b]: [f32; 3]) -> Rgb {
    let l = (light + 0.396_337_78 * a + 0.215_803_76 * b).powi(3);
    let m = (light - 0.105_561_346 * a - 0.063_854_17 * b).powi(3);
    let s = (light - 0.089_484_18 * a - 1.291_485_5 * b).powi(3);
    [
        from_linear(4.076_741_7 * l - 3.307_711_6 * m + 0.230_969_94 * s),
        from_linear(-1.268_438 * l + 2.609_757_4 * m - 0.341_319_38 * s),
        from_linear(-0.004_196_086_3 * l - 0.703_418_6 * m + 1.707_614_7 * s),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn oklab_and_srgb_round_trip() {
        for c in [[0, 0, 0], [255, 255, 255], [12, 200, 99], [250, 3, 128]] {
            let back = from_oklab(to_oklab(c));
            assert!((0..3).all(|k| back[k].abs_diff(c[k]) <= 1), "{c:?} {back:?}");
        }
    }

    #[test]
    fn violet_rises_in_lightness_and_ramps_end_at_their_stops() {
        let light: Vec<f32> = (0..=20).map(|i| to_oklab(Ramp::Violet.at(i as f32 / 20.0))[0]).collect();
        assert!(light.windows(2).all(|w| w[1] > w[0]));
        for (ramp, stops) in [(Ramp::Rainbow, RAINBOW), (Ramp::Error, ERROR), (Ramp::Land, LAND)] {
            let end = ramp.at(f32::INFINITY);
            assert!((0..3).all(|k| end[k].abs_diff(stops[stops.len() - 1][k]) <= 1));
        }
    }

    #[test]
    fn error_colours_run_from_teal_to_dark_and_nan_is_grey() {
        let colours = error_colours(&[0.0, -0.5, f32::INFINITY, f32::NAN], 0.5);
        assert_eq!([colours[1], colours[3]], [colours[2], [150; 3]]);
        assert!((0..3).all(|k| colours[0][k].abs_diff(ERROR[0][k]) <= 1));
    }

    #[test]
    fn neighbouring_palette_colours_differ() {
        for i in 0..60 {
            for j in i + 1..(i + 5).min(60) {
                let (a, b) = (palette(i), palette(j));
                let difference: u32 = (0..3).map(|k| u32::from(a[k].abs_diff(b[k]))).sum();
                assert!(difference > 40, "{i} {j}");
            }
        }
    }
}
