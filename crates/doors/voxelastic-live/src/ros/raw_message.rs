//! A message that is neither serialised nor deserialised: its bytes.

use serde::de::{SeqAccess, Visitor};
use serde::ser::SerializeTuple;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use voxelastic_io::ros::CDR_HEADER;

/// The body of a message in little-endian CDR, without its header. For serde it is numbers, eight bytes each, and the bytes that are left: aligned numbers
/// in sequence are serialised as they are.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RawMessage(Vec<u8>);

impl RawMessage {
    /// Of a message with its header.
    pub fn of(message: &[u8]) -> Self {
        Self(message.get(CDR_HEADER.len()..).unwrap_or_default().to_vec())
    }

    /// The answer `message` to the request `number` of a client of Cyclone DDS, which has the second half of `client` and the number in front.
    pub fn of_answer(client: &[u8; 16], number: i64, message: &[u8]) -> Self {
        let (high, low) = ((number >> 32) as i32, number as u32);
        let body = message.get(CDR_HEADER.len()..).unwrap_or_default();
        Self([&client[8..], &high.to_le_bytes(), &low.to_le_bytes(), body].concat())
    }

    /// The message with its header.
    pub fn into_message(mut self) -> Vec<u8> {
        self.0.splice(..0, CDR_HEADER);
        self.0
    }
}

impl ros2_client::Message for RawMessage {}

impl Serialize for RawMessage {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let (words, rest) = self.0.as_chunks::<8>();
        let mut tuple = serializer.serialize_tuple(words.len() + rest.len())?;
        words.iter().try_for_each(|word| tuple.serialize_element(&u64::from_le_bytes(*word)))?;
        rest.iter().try_for_each(|byte| tuple.serialize_element(byte))?;
        tuple.end()
    }
}

impl<'de> Deserialize<'de> for RawMessage {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_tuple(usize::MAX, UntilTheEnd)
    }
}

struct UntilTheEnd;

impl<'de> Visitor<'de> for UntilTheEnd {
    type Value = RawMessage;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a message")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut bytes: A) -> Result<RawMessage, A::Error> {
        let mut body = Vec::new();
        // An error is the end: what does not fit is not consumed.
        while let Ok(Some(word)) = bytes.next_element::<u64>() {
            body.extend(word.to_le_bytes());
        }
        while let Ok(Some(byte)) = bytes.next_element::<u8>() {
            body.push(byte);
        }
        Ok(RawMessage(body))
    }
}
