//! The thread that makes tiles of the surface, beside the mapper.

use crate::worker::{Priority, Worker};
use std::sync::Arc;
use std::time::{Duration, Instant};
use voxelastic::meshing::{TileKey, TileMaker, TileWork};
use voxelastic::surface::{Mesh, MeshOptions};

/// What is made of the surface in a tile, in the threads of the helper.
pub type Finish<T> = Arc<dyn Fn(TileKey, Mesh) -> T + Send + Sync>;

/// Tiles to make.
struct Order<T> {
    work: TileWork,
    finish: Finish<T>,
}

/// Tiles that were made.
#[derive(Debug)]
pub struct Delivery<T> {
    /// What was made of each tile, and whether it has a surface.
    pub tiles: Vec<(TileKey, bool, T)>,
    /// Other tiles that are out of date now.
    pub again: Vec<TileKey>,
    /// How long it took.
    pub took: Duration,
}

/// A thread that makes tiles, with helpers of its own. It ends with its owner.
#[derive(Debug)]
pub struct TileThread<T>(Worker<Order<T>, Delivery<T>>);

impl<T: Send + 'static> TileThread<T> {
    /// Starts it, with `threads` threads of low priority.
    pub fn start(options: MeshOptions, threads: usize) -> Self {
        let mut maker = TileMaker::new(options);
        Self(Worker::start("surface", threads, Priority::Low, move |order| Delivery::of(&mut maker, &order)))
    }

    /// Whether tiles are being made.
    pub fn is_busy(&self) -> bool {
        self.0.is_busy()
    }

    /// Has tiles made. To be called only while it is not busy.
    pub fn order(&mut self, work: TileWork, finish: Finish<T>) {
        self.0.order(Order { work, finish });
    }

    /// The tiles that were ordered, if they are made. Does not wait.
    pub fn delivery(&mut self) -> Option<Delivery<T>> {
        self.0.made()
    }
}

impl<T: Send> Delivery<T> {
    fn of(maker: &mut TileMaker, order: &Order<T>) -> Self {
        use rayon::prelude::*;
        let begin = Instant::now();
        let made = maker.make(&order.work);
        let finish = |(tile, mesh): (TileKey, Mesh)| (tile, !mesh.triangles.is_empty(), (order.finish)(tile, mesh));
        let tiles = made.meshes.into_par_iter().map(finish).collect();
        Self { tiles, again: made.again, took: begin.elapsed() }
    }
}
