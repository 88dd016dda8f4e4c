//! The thread that makes tiles of the surface, beside the mapper: it has a copy of what it needs, so that no scan waits for it.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
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
pub struct TileThread<T> {
    orders: Sender<Order<T>>,
    deliveries: Receiver<Delivery<T>>,
    is_busy: bool,
}

impl<T: Send + 'static> TileThread<T> {
    /// Starts it, with `threads` threads of low priority.
    pub fn start(options: MeshOptions, threads: usize) -> Self {
        let (orders, to_make) = channel::<Order<T>>();
        let (made, deliveries) = channel();
        let pool =
            rayon::ThreadPoolBuilder::new().num_threads(threads).thread_name(|_| "surface".to_owned()).start_handler(|_| lower_priority()).build();
        let work = move || {
            let mut maker = TileMaker::new(options);
            while let Ok(order) = to_make.recv() {
                let mut make = || Delivery::of(&mut maker, &order);
                let delivery = match &pool {
                    Ok(pool) => pool.install(make),
                    // Without threads of its own it shares those of others.
                    Err(_) => make(),
                };
                if made.send(delivery).is_err() {
                    return;
                }
            }
        };
        // If it does not start, orders are lost, and the surface is not shown.
        if let Err(problem) = std::thread::Builder::new().name("surface".to_owned()).spawn(work) {
            tracing::warn!("the surface cannot be shown: {problem}");
        }
        Self { orders, deliveries, is_busy: false }
    }

    /// Whether tiles are being made.
    pub fn is_busy(&self) -> bool {
        self.is_busy
    }

    /// Has tiles made. To be called only while it is not busy.
    pub fn order(&mut self, work: TileWork, finish: Finish<T>) {
        self.is_busy = self.orders.send(Order { work, finish }).is_ok();
    }

    /// The tiles that were ordered, if they are made. Does not wait.
    pub fn delivery(&mut self) -> Option<Delivery<T>> {
        if !self.is_busy {
            return None;
        }
        let delivery = self.deliveries.try_recv();
        self.is_busy = matches!(delivery, Err(TryRecvError::Empty));
        delivery.ok()
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

/// Gives the calling thread a low priority: on a core that it shares with a scan it gets about a tenth of the time, so that there is something to see even if scans come as fast
/// as they can be mapped. If the system refuses, the priority stays as it is.
pub(crate) fn lower_priority() {
    #[cfg(target_os = "linux")]
    let _ = rustix::process::nice(10);
}
