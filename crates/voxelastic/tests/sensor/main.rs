//! The sensor room from outside: models, preparation, normals, recognition; on analytic scenes and on real scans.

mod data;
mod detecting;
mod models;
mod normals;
mod preparing;
mod scene;
