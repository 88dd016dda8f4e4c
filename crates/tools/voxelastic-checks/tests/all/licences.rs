//! Dependencies have licences that go with this project's.

use std::path::Path;
use voxelastic_checks::licences::{packages, refused};

#[test]
fn all_dependencies_have_an_allowed_licence() {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..");
    assert!(packages(&workspace).unwrap().len() > 100);
    let refused = refused(&workspace).unwrap();
    assert!(refused.is_empty(), "{}", refused.join("\n"));
}
