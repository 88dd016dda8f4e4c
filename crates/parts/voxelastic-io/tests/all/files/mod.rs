//! Files of every format: clouds, surveys and meshes, good, damaged and made to harm, beside other readers and writers.

mod bad;
mod drivers;
mod formats;
mod meshes;
mod oracle;
mod surveys;
mod textures;
