//! What `voxelastic --version` prints: what the program was built from and with, and what it uses of the CPU.

/// Version, commit where the build knew it (`VOXELASTIC_COMMIT`, as release/build sets it), features, and vector instructions in use.
pub fn long() -> String {
    let commit = option_env!("VOXELASTIC_COMMIT").map(|commit| format!("\ncommit: {commit}")).unwrap_or_default();
    let features = match (cfg!(feature = "foxglove"), cfg!(feature = "ros2")) {
        (true, true) => "foxglove, ros2",
        (true, false) => "foxglove",
        (false, true) => "ros2",
        (false, false) => "none",
    };
    let instructions = voxelastic::vector_instructions();
    format!("{}{commit}\nfeatures: {features}\nvector instructions: {instructions}, {}", env!("CARGO_PKG_VERSION"), std::env::consts::ARCH)
}
