//! Threads that sleep until they are needed.

use std::hint::spin_loop;
use std::mem;
use std::process;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread;
use std::time::{Duration, Instant};

use rayon_core::{ThreadPool, ThreadPoolBuilder};

/// Time for which idle threads stay awake: steps often follow each other within it, and to wake a thread up
/// takes 25 to 80 µs, as long as a short step.
const AWAKE: Duration = Duration::from_micros(500);

/// Threads that work together, as one pool.
#[derive(Clone)]
struct Group {
    pool: Arc<ThreadPool>,
    watch: Arc<Watch>,
}

impl Group {
    fn has(&self, threads: usize) -> bool {
        self.pool.current_num_threads() == threads
    }
}

/// Counters by which idle threads see whether to stay awake.
#[derive(Default)]
struct Watch {
    /// Number of times that the group was borrowed.
    calls: AtomicUsize,
    /// Number of threads that are idle and awake.
    awake: AtomicUsize,
}

/// Groups of threads that are not in use.
struct Idle {
    /// The process in which they were created.
    process: u32,
    groups: Vec<Group>,
}

static IDLE: Mutex<Idle> = Mutex::new(Idle { process: 0, groups: Vec::new() });

/// The idle threads of this process, if the lock is free at once. It is held for a moment only, but a process
/// may have been forked in such a moment: there it is never released.
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
        // A forked process has the handles of its parent's threads, but not the threads. Dropping the handles
        // would wait for threads that do not exist.
        mem::forget(mem::take(&mut idle.groups));
        idle.process = process::id();
    }
    Some(idle)
}

/// Threads borrowed for one piece of work.
pub(crate) struct Helpers(Group);

impl Helpers {
    /// `threads` threads, created if no group of that size is idle; `None` if the system cannot create them.
    pub(crate) fn borrow(threads: usize) -> Option<Self> {
        let take = |mut idle: MutexGuard<'_, Idle>| {
            let place = idle.groups.iter().rposition(|group| group.has(threads))?;
            Some(idle.groups.swap_remove(place))
        };
        let builder = || ThreadPoolBuilder::new().num_threads(threads).thread_name(|_| "fvi".into());
        let make = || Some(Group { pool: Arc::new(builder().build().ok()?), watch: Arc::default() });
        let group = idle().and_then(take).or_else(make)?;
        group.watch.calls.fetch_add(1, Ordering::Relaxed);
        Some(Self(group))
    }

    /// True if the threads that would be borrowed are awake.
    pub(crate) fn are_awake(threads: usize) -> bool {
        let awake = |group: &Group| group.watch.awake.load(Ordering::Relaxed) == threads;
        idle().is_some_and(|idle| idle.groups.iter().rfind(|group| group.has(threads)).is_some_and(awake))
    }

    pub(crate) fn pool(&self) -> &ThreadPool {
        &self.0.pool
    }

    /// Task of a helper after its work: it stays awake until the next call, for a limited time, and yields to
    /// other threads that wait for the processor.
    pub(crate) fn stay_awake(&self) -> impl FnOnce() + Clone + Send + 'static {
        let watch = Arc::clone(&self.0.watch);
        let last = watch.calls.load(Ordering::Relaxed);
        move || {
            let since = Instant::now();
            watch.awake.fetch_add(1, Ordering::Relaxed);
            while watch.calls.load(Ordering::Relaxed) == last && since.elapsed() < AWAKE {
                thread::yield_now();
            }
            watch.awake.fetch_sub(1, Ordering::Relaxed);
        }
    }
}

impl Drop for Helpers {
    fn drop(&mut self) {
        if let Some(mut idle) = idle() {
            idle.groups.push(self.0.clone());
        }
    }
}
