#![no_main]

use voxelastic_io::CloudFormat;

/// Bytes of a page and of the checksum at its end.
const PAGE: usize = 1024;
const CHECKSUM: usize = 4;

/// CRC-32C (Castagnoli), bit by bit.
fn crc(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, b| (0..8).fold(crc ^ u32::from(*b), |crc, _| (crc >> 1) ^ (0x82f6_3b78 & 0u32.wrapping_sub(crc & 1))))
}

/// The pages with their checksums right, which would keep nearly all mutations out.
fn sealed(data: &[u8]) -> Vec<u8> {
    let mut sealed = data.to_vec();
    for page in sealed.chunks_exact_mut(PAGE) {
        let (body, checksum) = page.split_at_mut(PAGE - CHECKSUM);
        checksum.copy_from_slice(&crc(body).to_be_bytes());
    }
    sealed
}

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    voxelastic_fuzz::read_cloud(data, CloudFormat::E57);
    voxelastic_fuzz::read_cloud(&sealed(data), CloudFormat::E57);
});
