//! Work that several threads share.

use std::sync::{Mutex, PoisonError};

/// Hands items to so many threads, each of which takes the next when it is done with one. Threads that cannot
/// be had leave their share to the others.
pub(crate) fn share<I: Send>(threads: usize, items: impl Iterator<Item = I> + Send, work: impl Fn(I) + Sync) {
    if threads < 2 {
        return items.for_each(work);
    }
    let items = Mutex::new(items);
    let next = || items.lock().unwrap_or_else(PoisonError::into_inner).next();
    let run = || {
        while let Some(item) = next() {
            work(item);
        }
    };
    std::thread::scope(|scope| {
        for _ in 1..threads {
            // An error means that this machine has no more threads to give.
            let _ = std::thread::Builder::new().spawn_scoped(scope, run);
        }
        run();
    });
}
