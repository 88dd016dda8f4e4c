//! What checksums cannot vouch for: bytes that someone made on purpose. They are read or refused, and never worse.

use super::description::manifest::Manifest;
use super::description::manifest_text;
use super::description::piece::{MapDetails, Piece};
use super::sections::bytes::Bytes;
use super::sections::frames::Section;
use super::sections::{colour_section, masks, occupancy_section, submap_file, tsdf_page, tsdf_section};
use proptest::prelude::*;
use std::io::Cursor;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::atlas::Submap;
use voxelastic::field::occupancy::{OccupancyField, Summary};
use voxelastic::field::tsdf::{ColourVoxel, TsdfField, Voxel};
use voxelastic::field::{BlockHead, OccupancyBuilder, OctantRecord, PackedBlocks, TsdfBuilder};
use voxelastic::octree::voxels_at;
use voxelastic::surface::{MeshOptions, extract};

/// What happens to a byte: the place, as a fraction, and the new value.
type Changes = Vec<(f64, u8)>;

fn changes() -> impl Strategy<Value = Changes> {
    let value = prop_oneof![2 => any::<u8>(), 1 => Just(0), 1 => Just(0xff)];
    prop::collection::vec((0.0..1.0, value), 1..6)
}

/// Applies `changes`, most of them to the first tenth, where the numbers are that say how much follows.
fn changed(mut bytes: Vec<u8>, changes: &Changes, cut: Option<f64>) -> Vec<u8> {
    for (i, &(place, value)) in changes.iter().enumerate() {
        let reach = if i % 3 == 0 { bytes.len() } else { bytes.len().div_ceil(10) };
        let at = (place * reach as f64) as usize;
        bytes[at] = value;
    }
    if let Some(cut) = cut {
        bytes.truncate((cut * bytes.len() as f64) as usize);
    }
    bytes
}

fn tsdf() -> TsdfField {
    let mut builder = TsdfBuilder::default();
    for i in 0..40u64 {
        let head = BlockHead { key: 3 * i, scale: (i % 4) as u8, finest: (i % 2).min(i % 4) as u8, has_intensity: i % 3 == 0 };
        let voxel = |v: usize| Voxel { distance: (v as i16).wrapping_mul(700), weight: (v % 3) as u16 * 64 };
        let voxels: Vec<Voxel> = (0..head.voxel_count()).map(voxel).collect();
        builder.push(head, &voxels, &vec![9; head.intensity_count()]).expect("a possible block");
    }
    builder.finish()
}

/// The same, with colours in every third block.
fn coloured() -> TsdfField {
    let mut field = tsdf();
    for i in (0..40u64).step_by(3) {
        let scale = (i % 4) as u8;
        let colour = |v: usize| {
            if v.is_multiple_of(3) { ColourVoxel::default() } else { ColourVoxel { rgb: [v as u8, i as u8, 9], observations: 1 + v as u8 % 5 } }
        };
        field.set_colours(3 * i, scale, &(0..voxels_at(scale.into())).map(colour).collect::<Vec<_>>()).expect("a block that is there");
    }
    field
}

fn occupancy() -> OccupancyField {
    let octant = |linked| OctantRecord { linked, summary: Summary::uniform(-3) };
    let mut builder = OccupancyBuilder::new(0, 2, octant(true)).expect("a possible root");
    // The first child of the root has eight blocks below it, the other seven are uniform.
    (0..16).for_each(|i| builder.push_octant(octant(i < 9)).expect("an announced octant"));
    (0..8).for_each(|scale| builder.push_block(scale % 4, &vec![1; voxels_at(usize::from(scale % 4))]).expect("an announced block"));
    builder.finish().expect("a whole field")
}

fn section<'a>(name: &'static str, bytes: &'a [u8]) -> Section<'a> {
    Section { path: Path::new("map/submap"), name, offset: 100, bytes }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    #[test]
    fn any_tsdf_section_is_read_or_refused(changes in changes(), cut in prop::option::weighted(0.2, 0.0..1.0)) {
        let mut bytes = Vec::new();
        tsdf_section::write(&tsdf(), &mut bytes).unwrap();
        if let Ok(field) = tsdf_section::read(&section("tsdf section", &changed(bytes, &changes, cut))) {
            extract(&field, 0.1, &MeshOptions::default());
        }
    }

    #[test]
    fn any_colour_section_is_read_or_refused(changes in changes(), cut in prop::option::weighted(0.2, 0.0..1.0), whole in any::<bool>()) {
        let (mut bytes, mut field) = (Vec::new(), tsdf());
        colour_section::write(&coloured(), &mut bytes).unwrap();
        let bytes = if whole { bytes } else { changed(bytes, &changes, cut) };
        let read = colour_section::read(&section("colour section", &bytes), &mut field);
        prop_assert!(read.is_ok() || !whole);
        prop_assert!(!whole || colour_section::digest(&field) == colour_section::digest(&coloured()));
        extract(&field, 0.1, &MeshOptions::default());
    }

    #[test]
    fn any_colour_page_is_read_or_refused(changes in changes(), cut in prop::option::weighted(0.2, 0.0..1.0), items in 0usize..40) {
        let mut raw = Vec::new();
        let true_items = colour_section::fill(&coloured(), &colour_section::coloured(&coloured()), &mut raw);
        let items = if items % 2 == 0 { true_items } else { items };
        if let Ok(page) = colour_section::parse(Bytes::new(&changed(raw, &changes, cut)), items) {
            let _ = page.add_to(&mut tsdf());
        }
    }

    #[test]
    fn a_mask_tells_which_values_are_kept(values in prop::collection::vec(prop_oneof![3 => Just(0u16), 2 => any::<u16>()], 0..60)) {
        let (mut mask, mut kept) = (vec![7], values.clone());
        let count = masks::push_mask(&mut mask, &mut kept);
        kept.truncate(count);
        prop_assert_eq!(mask.len(), 1 + values.len().div_ceil(8));
        let is_set = |i: usize| mask[1 + i / 8] >> (i % 8) & 1 == 1;
        prop_assert!((0..8 * (mask.len() - 1)).all(|i| is_set(i) == values.get(i).is_some_and(|v| *v != 0)));
        prop_assert_eq!(kept, values.into_iter().filter(|v| *v != 0).collect::<Vec<_>>());
    }

    #[test]
    fn any_tsdf_page_is_read_or_refused(changes in changes(), cut in prop::option::weighted(0.2, 0.0..1.0), items in 0usize..80) {
        let (field, mut raw) = (tsdf(), Vec::new());
        let (true_items, _) = tsdf_page::fill(&field, &field.ids_in_morton_order(), &mut PackedBlocks::default(), &mut raw);
        let items = if items % 2 == 0 { true_items } else { items };
        if let Ok(page) = tsdf_page::parse(Bytes::new(&changed(raw, &changes, cut)), items) {
            let mut builder = TsdfBuilder::default();
            if builder.push_packed(&page).is_ok() {
                extract(&builder.finish(), 0.1, &MeshOptions::default());
            }
        }
    }

    #[test]
    fn any_occupancy_section_is_read_or_refused(changes in changes(), cut in prop::option::weighted(0.2, 0.0..1.0)) {
        let mut bytes = Vec::new();
        occupancy_section::write(&occupancy(), &mut bytes).unwrap();
        if let Ok(field) = occupancy_section::read(&section("occupancy section", &changed(bytes, &changes, cut))) {
            let corner = voxelastic::octree::block_coords(field.tree().root_key());
            let values = (0..300).map(|i| field.value_at(corner.map(|c| 8 * c + i / 3)));
            prop_assert_eq!(values.count(), 300);
        }
    }

    #[test]
    fn any_occupancy_page_is_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..2000), count in 0usize..3000) {
        let octants = occupancy_section::parse_octants(Bytes::new(&bytes), count);
        prop_assert!(octants.is_err() || octants.is_ok_and(|octants| octants.len() == count));
        let blocks = occupancy_section::parse_blocks(Bytes::new(&bytes), count);
        prop_assert!(blocks.is_err() || blocks.is_ok_and(|blocks| blocks.len() == count));
    }

    #[test]
    fn any_manifest_is_read_or_refused(changes in changes(), cut in prop::option::weighted(0.2, 0.0..1.0)) {
        let details = MapDetails { generator: "tests".to_owned(), settings: [("voxel_size".to_owned(), "0.05".to_owned())].into(), ..MapDetails::default() };
        let text = manifest_text::write(&Manifest { details, ..Manifest::default() }).unwrap();
        let mut bytes = changed(text.into_bytes(), &changes, cut);
        // With its checksum mended, so that the text itself is what is judged.
        if let Some(at) = bytes.windows(10).position(|w| w == b"\"crc32\": \"").map(|at| at + 10).filter(|at| at + 8 <= bytes.len()) {
            bytes[at..at + 8].fill(b'0');
            let crc32 = format!("{:08x}", crc32fast::hash(&bytes));
            bytes[at..at + 8].copy_from_slice(crc32.as_bytes());
        }
        if let Err(error) = manifest_text::read(Path::new("map/manifest.json"), &bytes) {
            prop_assert!(error.to_string().contains("manifest.json"));
        }
    }
}

#[test]
fn fields_come_back_from_their_sections() {
    let (mut tsdf_bytes, mut occupancy_bytes) = (Vec::new(), Vec::new());
    tsdf_section::write(&tsdf(), &mut tsdf_bytes).unwrap();
    occupancy_section::write(&occupancy(), &mut occupancy_bytes).unwrap();
    assert_eq!(tsdf_section::digest(&tsdf_section::read(&section("tsdf section", &tsdf_bytes)).unwrap()), tsdf_section::digest(&tsdf()));
    let read = occupancy_section::read(&section("occupancy section", &occupancy_bytes)).unwrap();
    assert_eq!(occupancy_section::digest(&read), occupancy_section::digest(&occupancy()));
}

#[test]
fn what_is_hashed_while_it_is_written_is_what_is_hashed_alone() {
    let mut out = Vec::new();
    assert_eq!(tsdf_section::write(&tsdf(), &mut out).unwrap(), tsdf_section::digest(&tsdf()));
    assert_eq!(occupancy_section::write(&occupancy(), &mut out).unwrap(), occupancy_section::digest(&occupancy()));
    assert_eq!(colour_section::write(&coloured(), &mut out).unwrap(), colour_section::digest(&coloured()));
    let submap = Submap::new(3, 0.1, Pose::identity()).with_fields(coloured(), occupancy());
    let piece = Piece { submap: &submap, t_map_submap: submap.t_map_submap(), session: None };
    let (_, digest) = submap_file::write(&mut Cursor::new(Vec::<u8>::new()), &piece, &MapDetails::default()).unwrap();
    assert_eq!(digest, submap_file::digest(&submap));
}

#[test]
fn pages_that_claim_the_earth_are_refused_before_memory_is_taken() {
    let mut bytes = Vec::new();
    tsdf_section::write(&tsdf(), &mut bytes).unwrap();
    for (at, what) in [(8, "bytes are left"), (12, "a page claims"), (16, "a page claims")] {
        let mut bytes = bytes.clone();
        bytes[at..at + 4].fill(0xff);
        let error = tsdf_section::read(&section("tsdf section", &bytes)).unwrap_err().to_string();
        assert!(error.contains(what) && error.contains("at byte 108"), "{error}");
    }
}
