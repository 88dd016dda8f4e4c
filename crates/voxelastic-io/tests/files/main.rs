//! Files of every format: clouds, surveys and meshes, good, damaged and made to harm, beside other readers and writers.

mod bad;
#[path = "../common/damage.rs"]
mod damage;
mod drivers;
mod encode;
mod formats;
mod meshes;
mod oracle;
mod surveys;
mod textures;
