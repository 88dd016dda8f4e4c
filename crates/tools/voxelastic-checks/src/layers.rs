//! The layers of this workspace as they are meant to be: the drawing in `ARCHITECTURE.md`, as tables.
//!
//! Each line is a crate or a room (a top module of the crate `voxelastic`) and what it may import. A line may name earlier lines only, so arrows go one way.
//! A new arrow is a line to change here and in the drawing.

/// A crate or a room, and what it may import.
pub type Layer = (&'static str, &'static [&'static str]);

/// Crates of the workspace. Tests, benches and examples may use every crate on an earlier line.
pub const CRATES: &[Layer] = &[
    ("voxelastic-checks", &[]),
    ("voxelastic-testing", &[]),
    ("voxelastic-files", &[]),
    ("voxelastic", &[]),
    ("voxelastic-colour", &["voxelastic"]),
    ("voxelastic-earth", &["voxelastic"]),
    ("voxelastic-io", &["voxelastic", "voxelastic-files", "voxelastic-colour", "voxelastic-earth"]),
    ("voxelastic-eval", &["voxelastic", "voxelastic-files"]),
    ("voxelastic-sim", &["voxelastic", "voxelastic-files", "voxelastic-colour", "voxelastic-io"]),
    ("voxelastic-slam", &["voxelastic"]),
    ("voxelastic-ground", &["voxelastic"]),
    ("voxelastic-plan", &["voxelastic"]),
    ("voxelastic-esdf", &["voxelastic"]),
    ("voxelastic-explore", &["voxelastic", "voxelastic-plan"]),
    ("voxelastic-report", &["voxelastic-eval"]),
    (
        "voxelastic-run",
        &[
            "voxelastic",
            "voxelastic-colour",
            "voxelastic-plan",
            "voxelastic-files",
            "voxelastic-earth",
            "voxelastic-ground",
            "voxelastic-io",
            "voxelastic-eval",
            "voxelastic-slam",
            "voxelastic-report",
        ],
    ),
    (
        "voxelastic-live",
        &[
            "voxelastic",
            "voxelastic-io",
            "voxelastic-eval",
            "voxelastic-slam",
            "voxelastic-ground",
            "voxelastic-plan",
            "voxelastic-esdf",
            "voxelastic-explore",
            "voxelastic-report",
            "voxelastic-run",
        ],
    ),
    ("voxelastic-bench", &["voxelastic", "voxelastic-files", "voxelastic-io", "voxelastic-eval", "voxelastic-sim", "voxelastic-report"]),
    (
        "voxelastic-cli",
        &[
            "voxelastic",
            "voxelastic-files",
            "voxelastic-earth",
            "voxelastic-io",
            "voxelastic-eval",
            "voxelastic-sim",
            "voxelastic-slam",
            "voxelastic-ground",
            "voxelastic-plan",
            "voxelastic-esdf",
            "voxelastic-explore",
            "voxelastic-report",
            "voxelastic-run",
            "voxelastic-live",
        ],
    ),
    ("voxelastic-manual", &["voxelastic-cli"]),
    (
        "voxelastic-python",
        &[
            "voxelastic",
            "voxelastic-earth",
            "voxelastic-io",
            "voxelastic-eval",
            "voxelastic-sim",
            "voxelastic-slam",
            "voxelastic-plan",
            "voxelastic-esdf",
            "voxelastic-run",
            "voxelastic-cli",
        ],
    ),
];

/// Development dependencies on later lines: the numbered examples of the core read files and plan paths.
pub const EXAMPLE_DEPENDENCIES: &[(&str, &str)] =
    &[("voxelastic", "voxelastic-io"), ("voxelastic", "voxelastic-sim"), ("voxelastic", "voxelastic-plan")];

/// Rooms of the crate `voxelastic`.
pub const ROOMS: &[Layer] = &[
    ("simd", &[]),
    ("memory", &[]),
    ("geometry", &["simd"]),
    ("motion", &["geometry"]),
    ("cloud", &["geometry", "motion"]),
    ("event", &["geometry", "cloud"]),
    ("sensor", &["simd", "geometry", "motion", "cloud"]),
    ("settings", &["memory", "sensor"]),
    ("octree", &["simd", "memory", "geometry"]),
    ("field", &["simd", "memory", "geometry", "octree"]),
    ("integrate", &["simd", "geometry", "sensor", "octree", "field"]),
    ("surface", &["simd", "memory", "geometry", "octree", "field"]),
    ("atlas", &["simd", "geometry", "event", "octree", "field"]),
    ("meshing", &["geometry", "atlas", "surface"]),
    ("query", &["simd", "geometry", "octree", "field", "atlas"]),
    ("changes", &["geometry", "octree", "field", "atlas", "surface", "meshing", "query"]),
    ("mapper", &["simd", "geometry", "motion", "cloud", "event", "sensor", "settings", "octree", "field", "integrate", "atlas"]),
    ("error", &["settings", "sensor", "field", "mapper"]),
];

/// Files that may hold `unsafe` code, as `ARCHITECTURE.md` names them: the crate, and the file in its `src`.
pub const UNSAFE_FILES: &[(&str, &str)] = &[
    ("voxelastic", "field/occupancy/writer.rs"),
    ("voxelastic", "field/tsdf/writer.rs"),
    ("voxelastic", "memory/allocator.rs"),
    ("voxelastic", "memory/budget_allocator.rs"),
    ("voxelastic", "memory/mapping.rs"),
    ("voxelastic", "octree/disjoint_mut.rs"),
    ("voxelastic", "octree/prefetch.rs"),
    ("voxelastic", "octree/slab.rs"),
    ("voxelastic", "simd/dispatch.rs"),
    ("voxelastic", "simd/gather.rs"),
    ("voxelastic-cli", "allocator.rs"),
];

/// Arrows between rooms that are not meant to be and still are. No new ones: this list only gets shorter.
pub const KNOWN_ARROWS: &[(&str, &str)] = &[];

/// Files with `unsafe` code that should not need it. This list only gets shorter.
pub const KNOWN_UNSAFE_FILES: &[(&str, &str)] = &[];

/// Crates in which files still depend on each other in cycles, and in how many files. These numbers only get smaller.
pub const KNOWN_CYCLES: &[(&str, usize)] = &[];
