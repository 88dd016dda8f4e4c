//! Serialising a message as plain CDR, little-endian (OMG DDSI-RTPS 2.3, section 10): numbers are aligned to their size.

/// Bytes of the header before the message, to which alignment does not count.
const HEADER: usize = 4;

/// A message that is being serialised.
pub(super) struct CdrWriter(Vec<u8>);

impl CdrWriter {
    /// An empty message with room for so many bytes.
    pub(super) fn new(capacity: usize) -> Self {
        let mut bytes = Vec::with_capacity(HEADER + capacity);
        bytes.extend([0, 1, 0, 0]);
        Self(bytes)
    }

    /// The message with its header.
    pub(super) fn bytes(&self) -> &[u8] {
        &self.0
    }

    fn align(&mut self, size: usize) {
        while !(self.0.len() - HEADER).is_multiple_of(size) {
            self.0.push(0);
        }
    }

    pub(super) fn u8(&mut self, value: u8) {
        self.0.push(value);
    }

    pub(super) fn u32(&mut self, value: u32) {
        self.align(4);
        self.0.extend(value.to_le_bytes());
    }

    pub(super) fn f64s(&mut self, values: impl IntoIterator<Item = f64>) {
        self.align(8);
        values.into_iter().for_each(|value| self.0.extend(value.to_le_bytes()));
    }

    /// A string, with its length and a terminating zero.
    pub(super) fn text(&mut self, text: &str) {
        self.u32(text.len() as u32 + 1);
        self.0.extend(text.as_bytes());
        self.0.push(0);
    }

    /// A sequence of bytes, with its length.
    pub(super) fn blob(&mut self, bytes: &[u8]) {
        self.u32(bytes.len() as u32);
        self.0.extend(bytes);
    }

    /// `std_msgs/Header`.
    pub(super) fn header(&mut self, time: f64, frame: &str) {
        let nanoseconds = (time.max(0.0) * 1e9).round() as u64;
        self.u32((nanoseconds / 1_000_000_000) as u32);
        self.u32((nanoseconds % 1_000_000_000) as u32);
        self.text(frame);
    }
}
