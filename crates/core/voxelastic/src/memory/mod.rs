//! A budget for the memory of the process: maps may be larger than it.
//!
//! The voxels of all maps are nearly all of the memory of a large map, and most of them belong to places where the sensor is not. Under a
//! [budget](limit) they are kept in a file that is mapped into memory. Whenever the process has more memory than the budget, a thread gives
//! the memory of parts of the file back to the system: the content stays in the file, of which the system keeps what it has room for, and
//! what is used again comes back by itself. So nothing else changes, neither how fields are read and written nor any bit of a map. Parts take
//! turns, in the order in which they were allocated. One that is in use comes back at once, for a page fault, and stays until its next turn;
//! one that is not stays out. So what is out are the parts that were not used for longest, on a drive those farthest from the sensor. Bricks
//! that are not compressed stay in memory: they are what the last scans changed, fewer scans where the budget is tight. The file has no name
//! and is gone with the process, also with a killed one.
//!
//! Programs whose global allocator is a [`BudgetAllocator`] can [keep large arrays in a file](keep_arrays_in_file), too: the mesh of a large map, for one, is larger than
//! the map.
//!
//! Poses, boxes, the pose graph, place signatures and whatever else is not voxels stay where they are.

mod allocator;
mod arrays;
mod budget;
mod budget_allocator;
#[cfg_attr(not(target_os = "linux"), path = "no_mapping.rs")]
mod mapping;
mod region;
mod size;

pub(crate) use allocator::{FieldMemory, PageBox, PageVec, zeroed_page, zeroed_working_page};
pub(crate) use budget::is_tight;
pub use budget::{MemoryError, budget, keep_arrays_in_file, limit};
pub use budget_allocator::BudgetAllocator;
pub use size::MemorySize;
