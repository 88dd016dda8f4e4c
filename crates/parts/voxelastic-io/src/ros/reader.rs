//! Deserialising numbers and strings: ROS 1's packed bytes, or CDR's aligned ones.

/// Serialisation of messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Encoding {
    /// ROS 1: packed, little-endian.
    Ros1,
    /// ROS 2: CDR, aligned, byte order in the first bytes.
    Cdr,
    /// Anything else; not read.
    Other,
}

/// A message that is read from front to back. Reads beyond its end give `None`.
#[derive(Clone, Copy, Debug)]
pub struct MessageReader<'a> {
    bytes: &'a [u8],
    next: usize,
    /// Largest alignment; 1 for packed bytes.
    align: usize,
    big_endian: bool,
    /// Whether the length of a string includes a terminating zero.
    zero_terminated: bool,
}

macro_rules! number {
    ($name:ident, $type:ty, $size:literal) => {
        #[doc = concat!("A number: `", stringify!($type), "`.")]
        pub fn $name(&mut self) -> Option<$type> {
            self.align($size);
            let bytes = self.bytes.get(self.next..)?.first_chunk::<$size>()?;
            self.next += $size;
            Some(if self.big_endian { <$type>::from_be_bytes(*bytes) } else { <$type>::from_le_bytes(*bytes) })
        }
    };
}

impl<'a> MessageReader<'a> {
    /// A message of ROS 2 (CDR); `None` if its header is of an unknown kind.
    pub fn new(message: &'a [u8]) -> Option<Self> {
        Self::of(message, Encoding::Cdr)
    }

    /// Little-endian numbers without gaps.
    pub(crate) fn packed(bytes: &'a [u8]) -> Self {
        Self { bytes, next: 0, align: 1, big_endian: false, zero_terminated: false }
    }

    /// A message; `None` if its header is of an unknown kind.
    pub(crate) fn of(bytes: &'a [u8], encoding: Encoding) -> Option<Self> {
        match encoding {
            Encoding::Ros1 => Some(Self::packed(bytes)),
            Encoding::Cdr => {
                // Plain CDR (0, 1) aligns to 8 bytes, plain CDR2 (6, 7) to 4; odd is little-endian. Alignment is relative to the end of the header.
                let (header, body) = bytes.split_first_chunk::<4>()?;
                let align = match header[1] {
                    0 | 1 => 8,
                    6 | 7 => 4,
                    _ => return None,
                };
                Some(Self { bytes: body, next: 0, align, big_endian: header[1] % 2 == 0, zero_terminated: true })
            }
            Encoding::Other => None,
        }
    }

    number!(u8, u8, 1);
    number!(u16, u16, 2);
    number!(u32, u32, 4);
    number!(u64, u64, 8);
    number!(i64, i64, 8);
    number!(f32, f32, 4);
    number!(f64, f64, 8);

    /// A truth value.
    pub fn bool(&mut self) -> Option<bool> {
        self.u8().map(|byte| byte != 0)
    }

    /// A string.
    pub fn text(&mut self) -> Option<String> {
        let len = self.u32()? as usize;
        let mut bytes = self.bytes(len)?;
        if self.zero_terminated {
            bytes = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        }
        Some(String::from_utf8_lossy(bytes).into_owned())
    }

    /// The next `count` bytes as they are.
    pub fn bytes(&mut self, count: usize) -> Option<&'a [u8]> {
        let bytes = self.bytes.get(self.next..)?.get(..count)?;
        self.next += count;
        Some(bytes)
    }

    /// Length of a sequence whose elements take at least `element_size` bytes each; `None` if the message cannot hold that many.
    pub fn count(&mut self, element_size: usize) -> Option<usize> {
        let count = self.u32()? as usize;
        (count.checked_mul(element_size)? <= self.bytes.len() - self.next.min(self.bytes.len())).then_some(count)
    }

    pub(crate) fn is_big_endian(&self) -> bool {
        self.big_endian
    }

    /// Whether numbers are aligned.
    pub(crate) fn is_aligned(&self) -> bool {
        self.align > 1
    }

    /// Skips the padding before a number of `size` bytes.
    pub(crate) fn align(&mut self, size: usize) {
        self.next = self.next.next_multiple_of(size.min(self.align));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packed_and_aligned_numbers() {
        let packed = [1, 2, 0, 0, 0, 3, 0, 0, 0, b'a', b'b', b'c'];
        let mut cursor = MessageReader::of(&packed, Encoding::Ros1).unwrap();
        assert_eq!((cursor.u8(), cursor.u32(), cursor.text().as_deref(), cursor.u8()), (Some(1), Some(2), Some("abc"), None));

        let mut aligned = vec![0, 1, 0, 0, 7, 0, 0, 0, 3, 0, 0, 0, b'a', b'b', 0, 0, 0, 0, 0, 0];
        aligned.extend(2.5f64.to_le_bytes());
        let mut cursor = MessageReader::of(&aligned, Encoding::Cdr).unwrap();
        assert_eq!((cursor.u8(), cursor.text().as_deref(), cursor.f64(), cursor.u8()), (Some(7), Some("ab"), Some(2.5), None));

        let big = [0, 0, 0, 0, 0, 5, 0, 0, 0, 0, 0, 9];
        let mut cursor = MessageReader::of(&big, Encoding::Cdr).unwrap();
        assert_eq!((cursor.u16(), cursor.u32()), (Some(5), Some(9)));
        assert!(MessageReader::of(&[0, 9, 0, 0], Encoding::Cdr).is_none() && MessageReader::of(&[0], Encoding::Cdr).is_none());
    }

    #[test]
    fn a_length_beyond_the_message_is_refused() {
        let mut cursor = MessageReader::packed(&[255, 255, 255, 255, 1]);
        assert_eq!(cursor.count(1), None);
        assert_eq!(MessageReader::packed(&[9, 0, 0, 0, 1]).text(), None);
    }
}
