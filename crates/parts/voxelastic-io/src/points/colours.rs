//! Colours of points, packed in one field or in three.

use super::record::{Column, Field, Scalar};
use std::sync::atomic::{AtomicBool, Ordering};

/// Names of PCL's packed colours: blue, green, red and optionally alpha, lowest byte first, in a 32-bit integer or in the bits of a float.
const PACKED: [&str; 2] = ["rgb", "rgba"];
/// Names of three fields.
const SEPARATE: [[&str; 3]; 2] = [["red", "green", "blue"], ["r", "g", "b"]];

/// Whether it was said that a field of colours holds numbers: that of every cloud does.
static SAID_NUMBERS: AtomicBool = AtomicBool::new(false);

/// Which fields hold the colour, as indices into the fields.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ColourFields {
    Packed(usize),
    Separate([usize; 3]),
}

impl ColourFields {
    /// Finds the fields by name; `find` gives the index of a name.
    pub(crate) fn of(fields: &[Field], find: impl Fn(&str) -> Option<usize>) -> Option<Self> {
        let packed = PACKED.into_iter().filter_map(&find).find(|&k| fields[k].scalar.size() == 4);
        let separate = || {
            let found = SEPARATE.into_iter().find_map(|[r, g, b]| Some([find(r)?, find(g)?, find(b)?]))?;
            let same = |k: usize| matches!(fields[k].scalar, Scalar::U8 | Scalar::U16 | Scalar::F32) && fields[k].scalar == fields[found[0]].scalar;
            found.into_iter().all(same).then_some(Self::Separate(found))
        };
        packed.map(Self::Packed).or_else(separate)
    }

    pub(crate) fn indices(self) -> Vec<usize> {
        match self {
            Self::Packed(k) => vec![k],
            Self::Separate(k) => k.to_vec(),
        }
    }

    /// The colours, from the columns of the fields; none if a packed field holds numbers.
    pub(crate) fn read<'a>(self, fields: &[Field], column: impl Fn(usize) -> Column<'a>) -> Option<Vec<[u8; 3]>> {
        match self {
            Self::Packed(k) if holds_numbers(column(k)) => {
                if !SAID_NUMBERS.swap(true, Ordering::Relaxed) {
                    tracing::warn!("field {} holds numbers, probably an intensity, and not colours packed into bits: it is left out", fields[k].name);
                }
                None
            }
            Self::Packed(k) => Some(packed(column(k))),
            Self::Separate(at) => Some(separate(at.map(column), fields[at[0]].scalar)),
        }
    }
}

/// Whether most of a packed field's floats are numbers: colours in the bits of a float are next to zero, or none at all.
fn holds_numbers(column: Column<'_>) -> bool {
    if column.scalar != Scalar::F32 {
        return false;
    }
    let values = column.to_f32();
    let numbers = values.iter().filter(|v| (1e-3..1e6).contains(&v.abs())).count();
    let colours = values.iter().filter(|v| v.is_nan() || **v != 0.0 && v.abs() < 1e-30).count();
    numbers > colours
}

fn packed(column: Column<'_>) -> Vec<[u8; 3]> {
    let split = |bits: u32| [(bits >> 16) as u8, (bits >> 8) as u8, bits as u8];
    if column.scalar == Scalar::F64 {
        // Text: the integer itself, or the (tiny) float with the same bits.
        let bits = |v: f64| if v.fract() == 0.0 && v >= 1.0 { v as u32 } else { (v as f32).to_bits() };
        return column.to_f64().into_iter().map(|v| split(bits(v))).collect();
    }
    // Only the bits count: with an alpha of 255 the float is NaN.
    Column { scalar: Scalar::U32, ..column }.to_f64().into_iter().map(|v| split(v as u32)).collect()
}

/// Floats range to 1, 16-bit integers to 65535 unless no value exceeds 255.
fn separate(columns: [Column<'_>; 3], scalar: Scalar) -> Vec<[u8; 3]> {
    let [r, g, b] = columns.map(Column::to_f32);
    let factor = match scalar {
        Scalar::F32 => 255.0,
        Scalar::U16 if [&r, &g, &b].into_iter().flatten().any(|v| *v > 255.0) => 255.0 / 65535.0,
        _ => 1.0,
    };
    let byte = |v: f32| (v * factor).round().clamp(0.0, 255.0) as u8;
    r.into_iter().zip(g).zip(b).map(|((r, g), b)| [r, g, b].map(byte)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field(name: &str, scalar: Scalar) -> Field {
        Field { name: name.into(), scalar, count: 1, offset: 0, index: 0 }
    }

    fn column(bytes: &[u8], scalar: Scalar) -> Column<'_> {
        Column { bytes, stride: scalar.size(), len: bytes.len() / scalar.size(), scalar, big_endian: false }
    }

    #[test]
    fn packed_colours_are_bits() {
        // Opaque orange is NaN as a float; with zero alpha it is tiny; text has the integer or that tiny float.
        let bits = [0xffff_8000u32, 0x00ff_8000];
        let bytes: Vec<u8> = bits.iter().flat_map(|b| b.to_le_bytes()).collect();
        for scalar in [Scalar::F32, Scalar::U32, Scalar::I32] {
            assert_eq!(packed(column(&bytes, scalar)), [[255, 128, 0]; 2]);
        }
        let text: Vec<u8> = [f64::from(bits[0]), f64::from(f32::from_bits(bits[1]))].iter().flat_map(|v| v.to_le_bytes()).collect();
        assert_eq!(packed(column(&text, Scalar::F64)), [[255, 128, 0]; 2]);
    }

    #[test]
    fn intensities_are_no_packed_colours() {
        let bytes = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let of = |values: &[f32]| ColourFields::Packed(0).read(&[field("rgb", Scalar::F32)], |_| column(bytes(values).leak(), Scalar::F32));
        assert_eq!(of(&[0.0, 12.5, 255.0, 3.0]), None);
        assert_eq!(of(&[0.0, f32::from_bits(0x00ff_8000), f32::from_bits(0xff00_ff00)]), Some(vec![[0; 3], [255, 128, 0], [0, 255, 0]]));
    }

    #[test]
    fn separate_colours_are_brought_to_bytes() {
        let floats: Vec<u8> = [0f32, 0.5, 7.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        assert_eq!(separate([column(&floats, Scalar::F32); 3], Scalar::F32), [[0; 3], [128; 3], [255; 3]]);
        let wide: Vec<u8> = [0u16, 257 * 40, 65535].iter().flat_map(|v| v.to_le_bytes()).collect();
        assert_eq!(separate([column(&wide, Scalar::U16); 3], Scalar::U16), [[0; 3], [40; 3], [255; 3]]);
        assert_eq!(separate([column(&wide[..2], Scalar::U16), column(&[9, 0], Scalar::U16), column(&[1, 0], Scalar::U16)], Scalar::U16), [[0, 9, 1]]);
        assert_eq!(separate([column(&[200, 3], Scalar::U8); 3], Scalar::U8), [[200; 3], [3; 3]]);
    }

    #[test]
    fn fields_are_found_by_name_and_type() {
        let of = |names: &[(&str, Scalar)]| {
            let fields: Vec<Field> = names.iter().map(|(n, s)| field(n, *s)).collect();
            ColourFields::of(&fields, |name| fields.iter().position(|f| f.name == name))
        };
        assert_eq!(of(&[("x", Scalar::F32), ("rgb", Scalar::F32)]), Some(ColourFields::Packed(1)));
        assert_eq!(of(&[("b", Scalar::U8), ("g", Scalar::U8), ("r", Scalar::U8)]), Some(ColourFields::Separate([2, 1, 0])));
        assert_eq!(of(&[("red", Scalar::U8), ("green", Scalar::U8), ("blue", Scalar::F32)]), None);
        assert_eq!(of(&[("rgb", Scalar::U8)]), None);
    }
}
