//! What two runs must have in common, so that one can go on with the other.

use std::collections::BTreeMap;
use std::io::Write;
use voxelastic::settings::Settings;

/// Settings that do not change the map.
const FREE: [&str; 2] = ["memory", "threads"];
/// Version of the states that this program writes.
const VERSION: &str = concat!("voxelastic ", env!("CARGO_PKG_VERSION"), ", state 6");

/// Of the hash FNV-1a with 64 bits.
const FNV_BASIS: u64 = 0xcbf2_9ce4_8422_2325;
const FNV_PRIME: u64 = 0x0000_0100_0000_01b3;

/// Everything that decides about the bits of a map, in words, by what it is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Identity(BTreeMap<String, String>);

impl Identity {
    /// Of a run with these settings.
    pub fn new(settings: &Settings) -> Self {
        let pairs = settings.pairs().into_iter().filter(|(key, _)| !FREE.contains(key));
        Self(pairs.map(|(key, value)| (key.to_owned(), value)).collect()).with("program", VERSION)
    }

    /// With something more.
    #[must_use]
    pub fn with(mut self, key: &str, value: impl ToString) -> Self {
        self.0.insert(key.to_owned(), value.to_string());
        self
    }

    /// A number that hardly any other run has, as text.
    pub fn digest(&self) -> Result<String, postcard::Error> {
        let hash = |bytes: &[u8]| bytes.iter().fold(FNV_BASIS, |sum, byte| (sum ^ u64::from(*byte)).wrapping_mul(FNV_PRIME));
        Ok(format!("{:016x}", hash(&postcard::to_stdvec(&self.0)?)))
    }

    /// What differs between this run and the one `before`, in words.
    pub fn differences(&self, before: &Self) -> Vec<String> {
        let mut keys: Vec<&String> = self.0.keys().chain(before.0.keys()).collect();
        keys.sort();
        keys.dedup();
        let differ = keys.into_iter().filter(|key| self.0.get(*key) != before.0.get(*key));
        differ
            .map(|key| match (before.0.get(key), self.0.get(key)) {
                (Some(before), Some(now)) if key != "data" => format!("{key} was {before} and is {now}"),
                (Some(_), Some(_)) => "its data are others, or were changed since".to_owned(),
                (Some(before), None) => format!("{key} was {before}"),
                (None, now) => format!("{key} is {}", now.map_or("", String::as_str)),
            })
            .collect()
    }

    /// Writes its serialised form, before a state.
    pub(super) fn write(&self, out: &mut dyn Write) -> Result<(), postcard::Error> {
        postcard::to_io(&self.0, out).map(drop)
    }

    /// The identity that [`write`](Self::write) has written, and the state behind it.
    pub(super) fn split(bytes: &[u8]) -> Result<(Self, &[u8]), String> {
        postcard::take_from_bytes(bytes).map(|(pairs, state)| (Self(pairs), state)).map_err(|e| format!("its state: {e}"))
    }
}
