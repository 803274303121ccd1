//! Sharing of work among threads.
//!
//! ```
//! let mut squares = [0; 1000];
//! fvi_threads::share(2, squares.chunks_mut(100).enumerate(), |(part, squares)| {
//!     for (index, square) in squares.iter_mut().enumerate() {
//!         *square = (100 * part + index).pow(2);
//!     }
//! });
//! assert_eq!(squares[999], 999 * 999);
//! ```
#![forbid(unsafe_code)]

mod helpers;

use std::hint::spin_loop;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use helpers::Helpers;

/// Time for which a thread that is done polls the others before it sleeps until they are done: about the time
/// it takes to fall asleep and wake up.
const PATIENCE: Duration = Duration::from_micros(20);

/// Divides the parts of a piece of work among the given number of threads, the calling one included, and
/// returns when all parts are done.
///
/// A thread begins with a range of parts of its own, the same one for the same number of parts, so that it
/// finds their data in the cache of its processor; then it takes parts that no other thread has begun. If
/// threads cannot be created, the others do their share.
///
/// # Panics
/// If a part does.
pub fn share<I: Send>(threads: usize, parts: impl IntoIterator<Item = I>, work: impl Fn(I) + Sync) {
    if threads < 2 {
        return parts.into_iter().for_each(work);
    }
    let parts: Vec<_> = parts.into_iter().map(|part| Mutex::new(Some(part))).collect();
    let threads = threads.min(parts.len());
    let run = |thread: usize| {
        let (others, own) = parts.split_at(thread * parts.len() / threads);
        for part in own.iter().chain(others) {
            let part = part.lock().unwrap_or_else(PoisonError::into_inner).take();
            part.into_iter().for_each(&work);
        }
    };
    let helpers = if threads < 2 { None } else { Helpers::borrow(threads - 1) };
    let Some(helpers) = helpers else { return (0..threads.min(1)).for_each(run) };
    let (begun, done) = (AtomicUsize::new(1), AtomicUsize::new(1));
    helpers.pool().in_place_scope(|scope| {
        let (run, begun, done) = (&run, &begun, &done);
        for thread in 1..threads {
            let stay_awake = helpers.stay_awake();
            scope.spawn(move |_| {
                begun.fetch_add(1, Ordering::Relaxed);
                run(thread);
                done.fetch_add(1, Ordering::Relaxed);
                // The thread runs this after the work; the caller does not wait for it.
                rayon_core::spawn(stay_awake);
            });
        }
        run(0);
        // A thread that has not begun waits for a processor, perhaps for this one.
        if begun.load(Ordering::Relaxed) == threads {
            let since = Instant::now();
            while done.load(Ordering::Relaxed) < threads && since.elapsed() < PATIENCE {
                spin_loop();
            }
        }
    });
}

/// True if the threads that would [`share`] a piece of work are still awake from the last one. Then work of
/// some ten microseconds is worth sharing; to wake a thread up may take 80 µs.
pub fn are_awake(threads: usize) -> bool {
    threads > 1 && Helpers::are_awake(threads - 1)
}

#[cfg(test)]
mod tests {
    use super::{are_awake, share};
    use std::collections::HashSet;
    use std::sync::{Barrier, Mutex};
    use std::thread;
    use std::time::Duration;

    #[test]
    fn every_part_is_done_once_on_any_number_of_threads() {
        for threads in [0, 1, 2, 3, 7] {
            for count in [0, 1, 2, 6, 100] {
                let mut done = vec![0; count];
                share(threads, done.iter_mut().enumerate(), |(index, part)| *part += index + 1);
                assert_eq!(done, (1..=count).collect::<Vec<_>>(), "{threads} threads");
            }
        }
    }

    /// The threads that run three parts, each of which waits for the others.
    fn who() -> Vec<thread::ThreadId> {
        let (together, seen) = (Barrier::new(3), Mutex::new(vec![thread::current().id(); 3]));
        share(3, 0..3, |part| {
            together.wait();
            seen.lock().unwrap()[part] = thread::current().id();
        });
        seen.into_inner().unwrap()
    }

    #[test]
    fn threads_are_awake_for_some_time_after_work_and_not_before() {
        // No other test uses a group of five.
        assert!(![0, 1, 5].into_iter().any(are_awake));
        // On a busy machine they may fall asleep before the check, but not always.
        let found = (0..1000).any(|_| {
            share(5, 0..5, |_| thread::yield_now());
            (0..100).any(|_| {
                thread::yield_now();
                are_awake(5)
            })
        });
        assert!(found, "threads do not stay awake");
        let asleep = (0..1000).any(|_| {
            thread::sleep(Duration::from_millis(5));
            !are_awake(5)
        });
        assert!(asleep, "threads do not fall asleep");
    }

    #[test]
    fn as_many_threads_as_were_asked_for_work_at_once_and_stay() {
        let all: HashSet<_> = (0..50).flat_map(|_| who()).collect();
        // Other tests of this program use helpers too, which may be reused here.
        assert!(who().into_iter().collect::<HashSet<_>>().len() == 3 && all.len() < 20, "{all:?}");
        assert!(all.contains(&thread::current().id()));
    }

    #[test]
    fn work_side_by_side_and_within_other_work_has_threads_of_its_own() {
        let together = Barrier::new(4);
        let meet = |_| {
            together.wait();
        };
        share(2, 0..2, |_| share(2, 0..2, meet));
        thread::scope(|scope| {
            for _ in 0..2 {
                scope.spawn(|| share(2, 0..2, meet));
            }
        });
    }

    #[test]
    fn a_panic_reaches_the_caller_and_leaves_the_threads_usable() {
        for bad in 0..4 {
            let broken = || share(2, 0..4, |part| assert_ne!(part, bad));
            assert!(std::panic::catch_unwind(broken).is_err());
            who();
        }
    }
}
