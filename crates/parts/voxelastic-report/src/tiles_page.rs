//! A page that streams a map's tiles (3D Tiles), for maps that are too large for one page: files to lie beside `tileset.json`, on any server of files.
//!
//! The page needs no network but that server. Its script is three.js and 3d-tiles-renderer with a page of our own around them; `page/tiles/build.sh` makes it.

/// The files by name: the page (`index.html`), its script, and the licences of what the script contains.
pub const FILES: [(&str, &[u8]); 3] = [
    ("index.html", include_bytes!("../page/tiles/page.html")),
    ("viewer.js", include_bytes!("../page/tiles/viewer.min.js")),
    ("LICENCES.txt", include_bytes!("../page/tiles/LICENCES.txt")),
];
