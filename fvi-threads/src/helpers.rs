//! Threads that sleep until they are needed.

use std::hint::spin_loop;
use std::mem;
use std::process;
use std::sync::{Arc, Mutex, MutexGuard};

use rayon_core::{ThreadPool, ThreadPoolBuilder};

/// Threads that nobody needs at the moment, in groups.
struct Idle {
    /// The process that they belong to.
    process: u32,
    groups: Vec<Arc<ThreadPool>>,
}

static IDLE: Mutex<Idle> = Mutex::new(Idle { process: 0, groups: Vec::new() });

/// The idle threads of this process, if they can be had at once. Others hold them for a moment only, but a
/// process may have been forked in such a moment: there nobody gives them back.
fn idle() -> Option<MutexGuard<'static, Idle>> {
    const ATTEMPTS: usize = 100;
    let mut idle = (0..ATTEMPTS).find_map(|_| {
        let idle = IDLE.try_lock().ok();
        if idle.is_none() {
            spin_loop();
        }
        idle
    })?;
    if idle.process != process::id() {
        // A forked process has the names of its parent's threads, but not the threads. Not even their end can
        // be waited for.
        mem::forget(mem::take(&mut idle.groups));
        idle.process = process::id();
    }
    Some(idle)
}

/// Threads that belong to one piece of work until it is done.
pub(crate) struct Helpers(Arc<ThreadPool>);

impl Helpers {
    /// So many threads, made if none of that number are idle; `None` if this machine has no more to give.
    pub(crate) fn borrow(threads: usize) -> Option<Self> {
        let take = |mut idle: MutexGuard<'_, Idle>| {
            let fitting = |group: &Arc<ThreadPool>| group.current_num_threads() == threads;
            let place = idle.groups.iter().rposition(fitting)?;
            Some(idle.groups.swap_remove(place))
        };
        let builder = || ThreadPoolBuilder::new().num_threads(threads).thread_name(|_| "fvi".into());
        let make = || builder().build().ok().map(Arc::new);
        idle().and_then(take).or_else(make).map(Self)
    }

    pub(crate) fn pool(&self) -> &ThreadPool {
        &self.0
    }
}

impl Drop for Helpers {
    fn drop(&mut self) {
        if let Some(mut idle) = idle() {
            idle.groups.push(Arc::clone(&self.0));
        }
    }
}
