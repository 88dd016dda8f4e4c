//! What `voxelastic --version` prints: what the program was built from and with, and what it uses of the CPU.

/// Version, commit where the build knew it (`VOXELASTIC_COMMIT`, as release/build sets it), features, and vector instructions in use.
pub fn long() -> String {
    let commit = option_env!("VOXELASTIC_COMMIT").map(|commit| format!("\ncommit: {commit}")).unwrap_or_default();
    let features: Vec<&str> = [("foxglove", cfg!(feature = "foxglove")), ("ros2", cfg!(feature = "ros2"))].iter().filter(|f| f.1).map(|f| f.0).collect();
    let features = if features.is_empty() { "none".to_owned() } else { features.join(", ") };
    let instructions = voxelastic::vector_instructions();
    format!("{}{commit}\nfeatures: {features}\nvector instructions: {instructions}, {}", env!("CARGO_PKG_VERSION"), std::env::consts::ARCH)
}
