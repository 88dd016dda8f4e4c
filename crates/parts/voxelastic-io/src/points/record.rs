//! Fields of binary point records, and columns of their values.

/// Type of a number in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Scalar {
    /// Size of a number, bytes.
    pub(crate) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    pub(crate) fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }

    /// Name for error messages.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::I8 => "an 8-bit integer",
            Self::U8 => "an unsigned 8-bit integer",
            Self::I16 => "a 16-bit integer",
            Self::U16 => "an unsigned 16-bit integer",
            Self::I32 => "a 32-bit integer",
            Self::U32 => "an unsigned 32-bit integer",
            Self::I64 => "a 64-bit integer",
            Self::U64 => "an unsigned 64-bit integer",
            Self::F32 => "a 32-bit float",
            Self::F64 => "a 64-bit float",
        }
    }
}

/// A named field of a point record.
#[derive(Clone, Debug)]
pub(crate) struct Field {
    pub(crate) name: String,
    pub(crate) scalar: Scalar,
    /// How many numbers the field holds; padding has many.
    pub(crate) count: usize,
    /// Bytes of the record before the field.
    pub(crate) offset: usize,
    /// Numbers of the record before the field, for text files.
    pub(crate) index: usize,
}

/// One number per point: the first at the start of `bytes`, the others at multiples of `stride` bytes.
///
/// `bytes` should reach to the end of the last number; numbers beyond its end read as zero.
#[derive(Clone, Copy)]
pub(crate) struct Column<'a> {
    pub(crate) bytes: &'a [u8],
    pub(crate) stride: usize,
    pub(crate) len: usize,
    pub(crate) scalar: Scalar,
    pub(crate) big_endian: bool,
}

impl Column<'_> {
    /// The numbers, rounded to single precision.
    pub(crate) fn to_f32(self) -> Vec<f32> {
        match (self.scalar, self.big_endian) {
            (Scalar::F32, false) => gather(self, f32::from_le_bytes),
            _ => self.convert(|v| v as f32),
        }
    }

    /// The numbers in double precision. Integers beyond 2^53 lose their last bits.
    pub(crate) fn to_f64(self) -> Vec<f64> {
        self.convert(|v| v)
    }

    /// The numbers, if their type is an unsigned integer of at most 16 bits.
    pub(crate) fn to_u16(self) -> Option<Vec<u16>> {
        match self.scalar {
            Scalar::U8 => Some(self.each(|b| u8::from_le_bytes(b).into())),
            Scalar::U16 => Some(self.each(u16::from_le_bytes)),
            _ => None,
        }
    }

    fn convert<T>(self, f: impl Fn(f64) -> T + Copy) -> Vec<T> {
        match self.scalar {
            Scalar::I8 => self.each(|b| f(i8::from_le_bytes(b).into())),
            Scalar::U8 => self.each(|b| f(u8::from_le_bytes(b).into())),
            Scalar::I16 => self.each(|b| f(i16::from_le_bytes(b).into())),
            Scalar::U16 => self.each(|b| f(u16::from_le_bytes(b).into())),
            Scalar::I32 => self.each(|b| f(i32::from_le_bytes(b).into())),
            Scalar::U32 => self.each(|b| f(u32::from_le_bytes(b).into())),
            Scalar::I64 => self.each(|b| f(i64::from_le_bytes(b) as f64)),
            Scalar::U64 => self.each(|b| f(u64::from_le_bytes(b) as f64)),
            Scalar::F32 => self.each(|b| f(f32::from_le_bytes(b).into())),
            Scalar::F64 => self.each(|b| f(f64::from_le_bytes(b))),
        }
    }

    /// Gathers the numbers, reversing the bytes of big-endian ones.
    fn each<const S: usize, T>(self, f: impl Fn([u8; S]) -> T) -> Vec<T> {
        if self.big_endian {
            gather(self, |mut b| {
                b.reverse();
                f(b)
            })
        } else {
            gather(self, f)
        }
    }
}

/// Points from three columns of coordinates.
pub(crate) fn points(xyz: [Column<'_>; 3]) -> Vec<[f32; 3]> {
    let [x, y, z] = xyz;
    let is_packed = |c: &Column<'_>| c.scalar == Scalar::F32 && !c.big_endian && c.stride == x.stride;
    // Addresses are compared, not dereferenced. Most files store x, y and z next to each other.
    let follows = |a: &Column<'_>, b: &Column<'_>| a.bytes.as_ptr() as usize + 4 == b.bytes.as_ptr() as usize;
    if xyz.iter().all(is_packed) && x.stride >= 12 && follows(&x, &y) && follows(&y, &z) {
        let number = |b: &[u8; 12], k: usize| f32::from_le_bytes([b[k], b[k + 1], b[k + 2], b[k + 3]]);
        return gather(x, |b: [u8; 12]| [number(&b, 0), number(&b, 4), number(&b, 8)]);
    }
    let (x, y, z) = (x.to_f32(), y.to_f32(), z.to_f32());
    x.into_iter().zip(y).zip(z).map(|((x, y), z)| [x, y, z]).collect()
}

fn gather<const S: usize, T>(column: Column<'_>, f: impl Fn([u8; S]) -> T) -> Vec<T> {
    let records = column.bytes.chunks(column.stride.max(1)).take(column.len);
    records.map(|record| f(record.first_chunk::<S>().copied().unwrap_or([0; S]))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gathers_every_type_in_either_byte_order() {
        let cases: [(Scalar, &[u8], f64); 8] = [
            (Scalar::I8, &[0xfe], -2.0),
            (Scalar::U8, &[0xfe], 254.0),
            (Scalar::I16, &[0xfe, 0xff], -2.0),
            (Scalar::U16, &[0x01, 0x02], 513.0),
            (Scalar::I32, &[0xff, 0xff, 0xff, 0xff], -1.0),
            (Scalar::U64, &[0, 1, 0, 0, 0, 0, 0, 0], 256.0),
            (Scalar::F32, &1.5f32.to_le_bytes(), 1.5),
            (Scalar::F64, &(-2.25f64).to_le_bytes(), -2.25),
        ];
        for (scalar, little, value) in cases {
            for big_endian in [false, true] {
                let mut record = little.to_vec();
                if big_endian {
                    record.reverse();
                }
                record.extend([7; 3]); // padding of the record
                let bytes = record.repeat(3);
                let column = Column { bytes: &bytes, stride: record.len(), len: 3, scalar, big_endian };
                assert_eq!(column.to_f64(), [value; 3], "{}", scalar.name());
                assert_eq!(column.to_f32(), [value as f32; 3]);
                assert!(column.to_u16().is_none_or(|numbers| numbers == [value as u16; 3]));
                assert_eq!(column.to_u16().is_some(), matches!(scalar, Scalar::U8 | Scalar::U16));
            }
        }
    }

    #[test]
    fn packed_and_scattered_coordinates_agree() {
        let numbers: Vec<f32> = (0..40).map(|v| v as f32 * 0.5).collect();
        let bytes: Vec<u8> = numbers.iter().flat_map(|v| v.to_le_bytes()).collect();
        let column = |k: usize| Column { bytes: &bytes[4 * k..], stride: 16, len: 10, scalar: Scalar::F32, big_endian: false };
        let expected: Vec<[f32; 3]> = numbers.chunks(4).map(|c| [c[0], c[1], c[2]]).collect();
        assert_eq!(points([column(0), column(1), column(2)]), expected);
        let swapped: Vec<[f32; 3]> = numbers.chunks(4).map(|c| [c[1], c[0], c[3]]).collect();
        assert_eq!(points([column(1), column(0), column(3)]), swapped);
    }
}
