//! The native part of the Python package `voxelastic`: the module `voxelastic._native`.
//!
//! It takes arrays that are checked already, runs the library without the interpreter lock and gives arrays back. What users call, with the checks, the
//! documentation and the types, is Python: `python/voxelastic`.

mod arrays;
mod command;
mod crossing;
mod dataset;
mod errors;
mod estimation;
mod evaluation;
mod export;
mod fleet;
mod job;
mod joining;
mod map;
mod mapper;
mod rays;
mod settings;
mod simulation;
mod space;

use pyo3::pymodule;

/// See `python/voxelastic/_native.pyi`.
#[pymodule]
mod _native {
    #[pymodule_export]
    use crate::command::run_command;
    #[pymodule_export]
    use crate::dataset::{Dataset, Events, Scan};
    #[pymodule_export]
    use crate::estimation::{Localiser, Odometry};
    #[pymodule_export]
    use crate::evaluation::{compare_surfaces, mesh_distances, trajectory_errors};
    #[pymodule_export]
    use crate::export::export;
    #[pymodule_export]
    use crate::fleet::{
        Splitter, alike_places, cells_of_box, finish_tiles, join_manifests, optimise_graph, unpack_scans, verify_places, write_tiles,
    };
    #[pymodule_export]
    use crate::job::{free_in_every_thread, limit_memory, use_threads};
    #[pymodule_export]
    use crate::joining::merge_into;
    #[pymodule_export]
    use crate::map::{Map, write_mesh};
    #[pymodule_export]
    use crate::mapper::Mapper;
    #[pymodule_export]
    use crate::rays::ray_cast;
    #[pymodule_export]
    use crate::settings::{complete_settings, settings_table};
    #[pymodule_export]
    use crate::simulation::{Simulation, world_names};
    #[pymodule_export]
    use crate::space::{beam_directions, clearance, esdf, plan, slice};
}
