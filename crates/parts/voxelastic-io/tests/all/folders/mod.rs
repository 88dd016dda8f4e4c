//! Folders as data sets and SLAM systems leave them: with poses, dumps of SLAM systems, without poses.

mod datasets;
mod dumps;
mod raw;
