//! Writing and reading CDR, the serialisation of ROS 2: little-endian, numbers aligned to their size from the end of the header.

/// Plain CDR, little-endian.
pub const HEADER: [u8; 4] = [0, 1, 0, 0];

/// A message under construction.
#[derive(Clone, Debug)]
pub struct Writer(Vec<u8>);

impl Writer {
    /// The header of a message.
    pub fn new() -> Self {
        Self(HEADER.to_vec())
    }

    /// As [`new`](Self::new), with room for `bytes`.
    pub fn with_capacity(bytes: usize) -> Self {
        let mut message = Vec::with_capacity(bytes + HEADER.len());
        message.extend(HEADER);
        Self(message)
    }

    fn align(&mut self, size: usize) {
        let length = self.0.len() - HEADER.len();
        self.0.resize(HEADER.len() + length.next_multiple_of(size), 0);
    }

    /// A byte.
    pub fn u8(&mut self, value: u8) -> &mut Self {
        self.0.push(value);
        self
    }

    /// A truth value.
    pub fn bool(&mut self, value: bool) -> &mut Self {
        self.u8(value.into())
    }

    /// A number.
    pub fn u32(&mut self, value: u32) -> &mut Self {
        self.align(4);
        self.0.extend(value.to_le_bytes());
        self
    }

    /// A number.
    pub fn i32(&mut self, value: i32) -> &mut Self {
        self.u32(value as u32)
    }

    /// A number.
    #[cfg(any(feature = "ros2", test))]
    pub fn i64(&mut self, value: i64) -> &mut Self {
        self.align(8);
        self.0.extend(value.to_le_bytes());
        self
    }

    /// Numbers, without their count.
    pub fn f32s(&mut self, values: &[f32]) -> &mut Self {
        self.align(4);
        values.iter().for_each(|v| self.0.extend(v.to_le_bytes()));
        self
    }

    /// Numbers, without their count.
    pub fn f64s(&mut self, values: &[f64]) -> &mut Self {
        self.align(8);
        values.iter().for_each(|v| self.0.extend(v.to_le_bytes()));
        self
    }

    /// A string.
    pub fn text(&mut self, text: &str) -> &mut Self {
        self.u32(text.len() as u32 + 1);
        self.0.extend(text.as_bytes());
        self.u8(0)
    }

    /// A sequence of bytes.
    pub fn bytes(&mut self, bytes: &[u8]) -> &mut Self {
        self.u32(bytes.len() as u32);
        self.0.extend(bytes);
        self
    }

    /// Bytes as they are, without their count.
    pub fn raw(&mut self, bytes: &[u8]) -> &mut Self {
        self.0.extend(bytes);
        self
    }

    /// The message.
    pub fn finish(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.0)
    }
}

/// A message that is read from front to back. Reads beyond its end give `None`.
#[derive(Clone, Debug)]
pub struct Reader<'a> {
    body: &'a [u8],
    next: usize,
}

impl<'a> Reader<'a> {
    /// A message; `None` if it does not begin like little-endian CDR.
    pub fn new(message: &'a [u8]) -> Option<Self> {
        let body = message.strip_prefix(&HEADER[..2])?.get(2..)?;
        Some(Self { body, next: 0 })
    }

    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.next = self.next.next_multiple_of(N);
        let bytes = *self.body.get(self.next..)?.first_chunk::<N>()?;
        self.next += N;
        Some(bytes)
    }

    /// A byte.
    pub fn u8(&mut self) -> Option<u8> {
        self.take::<1>().map(|[byte]| byte)
    }

    /// A truth value.
    pub fn bool(&mut self) -> Option<bool> {
        self.u8().map(|byte| byte != 0)
    }

    /// A number.
    pub fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    /// A number.
    #[cfg(any(feature = "ros2", test))]
    pub fn i64(&mut self) -> Option<i64> {
        self.take().map(i64::from_le_bytes)
    }

    /// A number.
    pub fn f32(&mut self) -> Option<f32> {
        self.take().map(f32::from_le_bytes)
    }

    /// A number.
    pub fn f64(&mut self) -> Option<f64> {
        self.take().map(f64::from_le_bytes)
    }

    /// A string.
    pub fn text(&mut self) -> Option<String> {
        let length = self.u32()? as usize;
        let bytes = self.body.get(self.next..)?.get(..length)?;
        self.next += length;
        Some(String::from_utf8_lossy(bytes.strip_suffix(&[0]).unwrap_or(bytes)).into_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read() {
        let message = Writer::new().u8(7).text("frame").f64s(&[0.5]).bool(true).u32(9).f32s(&[1.5]).i64(-2).finish();
        let mut reader = Reader::new(&message).unwrap();
        assert_eq!((reader.bool(), reader.text().as_deref(), reader.f64()), (Some(true), Some("frame"), Some(0.5)));
        assert_eq!((reader.u8(), reader.u32(), reader.f32(), reader.i64()), (Some(1), Some(9), Some(1.5), Some(-2)));
        assert_eq!(reader.u32(), None);
        assert!(Reader::new(&[0, 0, 0, 0]).is_none() && Reader::new(&[]).is_none());
        let mut garbage = Reader::new(&[0, 1, 0, 0, 255, 255, 255, 255]).unwrap();
        assert_eq!(garbage.text(), None);
    }
}
