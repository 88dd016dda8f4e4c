//! Files of maps whose checksums are right, whatever is in them.

use voxelastic_io::store::FORMAT_VERSION;

/// A map that is kept as it was written.
pub const KEPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../crates/parts/voxelastic-io/tests/fixtures/map-v4");

/// A manifest: `rest` is what follows its checksum.
pub fn manifest(rest: &[u8]) -> Vec<u8> {
    let head = format!("{{\n\"format\": \"voxelastic map\",\n\"version\": {FORMAT_VERSION},\n\"crc32\": \"");
    let crc32 = crc32fast::hash(&[head.as_bytes(), b"00000000", rest].concat());
    [head.as_bytes(), format!("{crc32:08x}").as_bytes(), rest].concat()
}

/// That of a map without submaps.
pub fn empty_manifest() -> Vec<u8> {
    manifest(b"\",\n\"generator\": \"fuzz\",\n\"settings\": {\"voxel_size\": \"0.1\"},\n\"sensor\": {},\n\"submaps\": []\n}\n")
}

/// Name of the state of a run whose manifest is [`empty_manifest`].
pub fn state_name() -> String {
    format!("state-{:08x}.vxr", crc32fast::hash(&empty_manifest()))
}

/// The state of a run, with a table that is said to have a length.
pub fn state(length: u64, table: &[u8]) -> Vec<u8> {
    let content = [&b"\x89VXRUN\r\n"[..], &3u32.to_le_bytes(), &length.to_le_bytes(), table].concat();
    let crc32 = crc32fast::hash(&content);
    [content, crc32.to_le_bytes().to_vec()].concat()
}

/// A journal of `data`: a record where there is `!`, a length and so many bytes, else as it is.
pub fn journal(mut data: &[u8]) -> Vec<u8> {
    let mut journal = b"\x89VXJNL\r\n".to_vec();
    while let Some((b'!', [length, rest @ ..])) = data.split_first() {
        let (record, rest) = rest.split_at(rest.len().min(usize::from(*length)));
        let length = (record.len() as u32).to_le_bytes();
        journal.extend(length);
        journal.extend(crc32fast::hash(&[&length, record].concat()).to_le_bytes());
        journal.extend(record);
        data = rest;
    }
    journal.extend(data);
    journal
}
