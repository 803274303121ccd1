//! Batches: many runs of one scenario with other numbers, on threads, without files.

use crate::results::rows::Rows;
use crate::run::{Last, Run, RunEnd, RunSummary};
use fvi_fft::memory::Tables;
use fvi_scenario::language::InputError;
use fvi_scenario::scenario::{Feature, Members, Scenario};
use fvi_simulation::simulation::events::EventRecord;
use fvi_simulation::simulation::step_batch::StepBatch;
use fvi_simulation::simulation::{Precision, Simulation};
use std::convert::Infallible;
use std::num::NonZero;
use std::slice;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::time::Duration;

/// A scenario that is run many times with other numbers at some of its places. It is read and compiled once;
/// runs with equal kernels, steps and lengths share the tables of their memories. Every run has the bits of a
/// run by itself.
///
/// ```
/// # use fvi_host::batch::Batch;
/// # use fvi_scenario::scenario::{Members, Scenario};
/// # use fvi_simulation::simulation::Precision;
/// let oscillator: Scenario = "
/// [system]
/// mass = [1.0]
/// potential = '0.5*k*q0^2'
/// parameters = { k = 1.0 }
/// damping = [{ order = 0.5, coefficient = [0.1] }]
/// [initial]
/// position = [1.0]
/// [time]
/// step = 0.05
/// steps = 100
/// ".parse()?;
/// let members = Members::new(oscillator, ["system.parameters.k"])?;
/// let batch = Batch::new(members, Precision::F64, Default::default())?;
/// let runs = batch.run(&[1.0, 2.0, 3.0], None, &Default::default(), &mut |_| {});
/// assert_eq!(runs[2].as_ref().unwrap().rows.len(), 101);
/// # Ok::<(), fvi_scenario::language::InputError>(())
/// ```
#[derive(Debug)]
pub struct Batch {
    members: Members,
    precision: Precision,
    tables: Arc<Tables>,
}

/// One run of a batch.
#[derive(Clone, Debug, PartialEq)]
pub struct MemberRun {
    /// Its rows, as `[output]` selects them.
    pub rows: Rows,
    /// How it ended.
    pub end: RunEnd,
    /// Steps made.
    pub steps: usize,
    /// The events that have occurred, in order of time.
    pub events: Vec<EventRecord>,
    /// Warnings.
    pub warnings: Vec<String>,
}

/// Number of runs that a thread takes at a time.
const SHARE: usize = 16;

/// Time between two calls of the progress function.
const LOOK: Duration = Duration::from_millis(20);

impl Batch {
    /// A batch of these members; its tables may be shared with other batches and runs.
    ///
    /// # Errors
    /// If the scenario has load cases.
    pub fn new(members: Members, precision: Precision, tables: Arc<Tables>) -> Result<Self, InputError> {
        members.base().check_use(Feature::OneMotion)?;
        Ok(Self { members, precision, tables })
    }

    /// The members.
    pub fn members(&self) -> &Members {
        &self.members
    }

    /// The run of the member with these numbers, one for each path: its rows and its record. `take` receives
    /// the states, so that it can also set `stop`.
    ///
    /// # Errors
    /// If the numbers cannot be used.
    pub fn run_one(
        &self,
        numbers: &[f64],
        stop: &AtomicBool,
        take: &mut dyn FnMut(&StepBatch),
    ) -> Result<(Rows, RunSummary), InputError> {
        self.with_member(numbers, &mut Last::default(), |scenario, ended| {
            let (run, rows, end) = self.made(scenario, ended, stop, &mut *take)?;
            Ok((rows, run.summary(end)))
        })
    }

    fn member_run(
        &self,
        numbers: &[f64],
        last: &mut Last,
        stop: &AtomicBool,
    ) -> Result<MemberRun, InputError> {
        self.with_member(numbers, last, |scenario, ended| {
            let (run, rows, end) = self.made(scenario, ended, stop, &mut |_| {})?;
            let (steps, events, warnings) = run.told();
            if self.members.differ_in_start_and_parameters() {
                *ended = Some(run.into_simulation());
            }
            Ok(MemberRun { rows, end, steps, events, warnings })
        })
    }

    /// What `make` makes of a member; where it refuses it, the error shows the numbers of the member.
    fn with_member<R>(
        &self,
        numbers: &[f64],
        last: &mut Last,
        mut make: impl FnMut(&Scenario, &mut Option<Simulation>) -> Result<R, InputError>,
    ) -> Result<R, InputError> {
        let Last { member, simulation } = last;
        let member = self.members.put(numbers, member);
        if let Some(made) = member.and_then(|scenario| make(scenario, simulation).ok()) {
            return Ok(made);
        }
        make(&self.members.read(numbers)?, &mut None)
    }

    fn made<'s>(
        &self,
        scenario: &'s Scenario,
        ended: &mut Option<Simulation>,
        stop: &AtomicBool,
        take: &mut dyn FnMut(&StepBatch),
    ) -> Result<(Run<'s>, Rows, RunEnd), InputError> {
        let run = Run::of(scenario).precision(self.precision).tables(&self.tables);
        let mut run = run.start_with(ended)?;
        let mut rows = Rows::for_run(scenario);
        let Ok(end) = run.drive(stop, |portion| {
            take(portion.batch());
            portion.keep(slice::from_mut(&mut rows));
            Ok::<_, Infallible>(())
        });
        Ok((run, rows, end))
    }

    /// The runs of all members, on threads: their numbers follow each other in `numbers`. `jobs` is the
    /// number of threads, by default one for each core. `stop` ends the batch: members that have not begun
    /// have no run ([`Stopped`](RunEnd::Stopped), no rows). `progress` receives the number of runs made, some
    /// fifty times a second, so that it can also set `stop`.
    ///
    /// A member that cannot be run has its error in place of a run.
    pub fn run(
        &self,
        numbers: &[f64],
        jobs: Option<NonZero<usize>>,
        stop: &AtomicBool,
        progress: &mut dyn FnMut(usize),
    ) -> Vec<Result<MemberRun, InputError>> {
        let width = self.members.paths().len().max(1);
        let count = numbers.len() / width;
        let mut made: Vec<Option<Result<MemberRun, InputError>>> = (0..count).map(|_| None).collect();
        let jobs = jobs.or_else(|| std::thread::available_parallelism().ok()).map_or(1, NonZero::get);
        let jobs = if self.members.are_independent() { jobs } else { 1 };
        let done = AtomicUsize::new(0);
        let make = |(places, numbers): (&mut [Option<_>], &[f64]), last: &mut Last| {
            for (place, numbers) in places.iter_mut().zip(numbers.chunks_exact(width)) {
                if stop.load(Ordering::Relaxed) {
                    return;
                }
                *place = Some(self.member_run(numbers, last, stop));
                done.fetch_add(1, Ordering::Relaxed);
            }
        };
        let shares = made.chunks_mut(SHARE).zip(numbers.chunks(SHARE * width));
        if jobs == 1 || count <= SHARE {
            let mut last = Last::default();
            for share in shares {
                make(share, &mut last);
                progress(done.load(Ordering::Relaxed));
            }
        } else {
            let shares = Mutex::new(shares);
            let (sender, ended) = mpsc::sync_channel::<()>(0);
            std::thread::scope(|scope| {
                for _ in 0..jobs.min(count.div_ceil(SHARE)) {
                    let (shares, make, sender) = (&shares, &make, sender.clone());
                    scope.spawn(move || {
                        let mut last = Last::default();
                        loop {
                            let share = shares.lock().unwrap_or_else(PoisonError::into_inner).next();
                            let Some(share) = share else { break };
                            make(share, &mut last);
                        }
                        // The last thread that ends closes the channel.
                        drop(sender);
                    });
                }
                drop(sender);
                while ended.recv_timeout(LOOK) == Err(RecvTimeoutError::Timeout) {
                    progress(done.load(Ordering::Relaxed));
                }
            });
            progress(done.load(Ordering::Relaxed));
        }
        made.into_iter().map(|run| run.unwrap_or_else(|| Ok(MemberRun::none()))).collect()
    }
}

impl MemberRun {
    /// A run that has not begun.
    fn none() -> Self {
        let (rows, end) = (Rows::default(), RunEnd::Stopped);
        Self { rows, end, steps: 0, events: Vec::new(), warnings: Vec::new() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    fn scenario(more: Value) -> Scenario {
        let mut value = json!({
            "system": {
                "mass": [1.0],
                "potential": "0.5*k*q0^2 + c*q0^4",
                "parameters": { "k": 1.0, "c": 0.1 },
                "damping": [{ "order": 0.5, "coefficient": [0.1] }],
            },
            "initial": { "position": [1.0], "momentum": [0.0] },
            "time": { "step": 0.05, "steps": 90 },
        });
        value.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        Scenario::from_value(&value).unwrap()
    }

    fn batch(scenario: Scenario, paths: &[&str]) -> Batch {
        let members = Members::new(scenario, paths.iter().copied()).unwrap();
        Batch::new(members, Precision::F64, Arc::default()).unwrap()
    }

    /// The rows of a member that is read and run by itself.
    fn alone(batch: &Batch, numbers: &[f64]) -> (Rows, RunEnd) {
        let scenario = batch.members().read(numbers).unwrap();
        let mut run = Run::of(&scenario).start().unwrap();
        let mut rows = Rows::for_run(&scenario);
        // Row by row: the batch keeps columns.
        let Ok(end) = run.drive(&AtomicBool::new(false), |portion| {
            portion.rows(|_, row| {
                rows.push(row);
                Ok::<_, Infallible>(())
            })
        });
        (rows, end)
    }

    #[test]
    fn every_member_has_the_bits_of_a_run_by_itself() {
        let (stop, jobs) = (AtomicBool::new(false), NonZero::new(3));
        let kernel = json!({ "form": "maxwell", "order": 0.6, "time": 1.0 });
        let other = json!({ "system": {
            "mass": [[2.0, 0.1], [0.1, 1.0]],
            "stiffness": [[2.0, -1.0], [-1.0, 2.0]],
            "force": ["a*sin(t)", "0"],
            "parameters": { "a": 1.0 },
            "damping": [{ "kernel": kernel, "coefficient": [0.1, 0.3] }],
        }, "initial": { "position": [1.0, 0.0], "velocity": [0.0, 0.0] }, "output": { "every": 7 } });
        let stops = json!({ "event": [{ "when": "q0", "action": "stop" }] });
        let times = json!({ "output": { "times": [0.1, 0.33, 4.0] } });
        let adaptive = json!({
            "time": { "grid": "adaptive", "end": 2.0, "tolerance": 1e-6 }, "scheme": { "kind": "collocation" }
        });
        let long = json!({ "time": { "step": 0.05, "steps": 700 } });
        for (scenario, paths) in [
            (scenario(json!({})), ["system.parameters.k", "initial.position[0]"]),
            (scenario(json!({})), ["system.damping[0].order", "system.damping[0].coefficient"]),
            (scenario(long), ["system.damping[0].order", "initial.momentum"]),
            (scenario(stops), ["system.parameters.c", "initial.momentum[0]"]),
            (scenario(times), ["system.parameters.c", "system.mass[0]"]),
            (scenario(adaptive), ["system.parameters.c", "initial.position[0]"]),
            (scenario(other), ["system.parameters.a", "initial.velocity[1]"]),
        ] {
            let batch = batch(scenario, &paths);
            let numbers: Vec<f64> = (0..80).map(|index| 0.3 + 0.01 * f64::from(index)).collect();
            let mut last = 0;
            let runs = batch.run(&numbers, jobs, &stop, &mut |done| last = done);
            assert_eq!((runs.len(), last), (40, 40));
            for (run, numbers) in runs.into_iter().zip(numbers.chunks_exact(2)) {
                let run = run.unwrap();
                assert_eq!((run.rows, run.end), alone(&batch, numbers), "{paths:?} {numbers:?}");
            }
        }
    }

    /// Everything that a member's run says, or its error.
    fn told(run: Result<MemberRun, InputError>) -> Result<MemberRun, String> {
        run.map_err(|error| error.to_string())
    }

    #[test]
    fn a_run_does_not_show_which_members_its_thread_has_run_before() {
        let [k, c] = ["system.parameters.k", "system.parameters.c"];
        let [q, p] = ["initial.position[0]", "initial.momentum[0]"];
        let convolution = |value: Value| json!({ "convolution": value });
        let forced = |force: &str| {
            json!({ "system": {
                "mass": [1.0], "potential": "0.5*k*q0^2 + c*q0^4", "force": [force],
                "parameters": { "k": 1.0, "c": 0.1 },
                "damping": [{ "order": 0.5, "coefficient": [0.1], "derivative": "riemann-liouville" }],
            } })
        };
        let times = json!({ "output": { "times": [0.1, 0.33, 2.9] }, "event": [{ "when": "q0 - c" }] });
        let stops = json!({ "event": [{ "when": "q0 - c", "action": "stop" }, { "when": "t - k" }] });
        let engine = |engine: &str| json!({ "history": { "engine": engine } });
        let gauss = json!({
            "scheme": { "kind": "galerkin", "degree": 2, "quadrature": "gauss", "points": 2 },
            "convolution": { "order": 3 },
        });
        let staged = json!({
            "scheme": { "kind": "galerkin", "degree": 2 }, "convolution": { "family": "radau-iia", "stages": 2 },
        });
        let explicit =
            json!({ "scheme": { "kind": "low-order", "kappa": 0.0 }, "convolution": { "at": "main-nodes" } });
        for (more, paths) in [
            (json!({}), [k, q]),
            (stops, [c, p]),
            (times, [c, q]),
            (convolution(json!({ "at": "main-nodes", "order": 2 })), [q, k]),
            (forced("k*sin(t) - c*step(t - 1)*q0"), [c, k]),
            (forced("-c*v0^3 + step(t - k)"), [c, p]),
            (engine("block-fft"), [k, p]),
            (engine("exponential-sum"), [k, p]),
            (gauss, [k, q]),
            (staged, [q, p]),
            (json!({ "output": { "memory_energy": true, "every": 7 } }), [k, q]),
            // The step is too long for some members.
            (explicit, [k, q]),
        ] {
            let mut all = json!({ "time": { "step": 0.05, "steps": 60 } });
            all.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
            for precision in [Precision::F64, Precision::F32] {
                let members = Members::new(scenario(all.clone()), paths).unwrap();
                assert!(members.differ_in_start_and_parameters());
                let batch = Batch::new(members, precision, Arc::default()).unwrap();
                // The potential falls without end, a number that cannot be used, one that is no number.
                let numbers = [
                    [1.0, 0.5],
                    [0.5, 1.5],
                    [-30.0, 2.0],
                    [0.5, 1.5],
                    [1e300, 1.0],
                    [1.0, 0.5],
                    [f64::NAN, 1.0],
                    [0.0, 0.0],
                    [1.0, 0.5],
                    [6000.0, 1.0],
                    [0.5, 1.5],
                ];
                let stop = AtomicBool::new(false);
                let together = batch.run(numbers.as_flattened(), NonZero::new(1), &stop, &mut |_| {});
                for (run, numbers) in together.into_iter().zip(numbers) {
                    let alone = batch.member_run(&numbers, &mut Last::default(), &stop);
                    assert_eq!(told(run), told(alone), "{all} {numbers:?}");
                }
            }
        }
    }

    #[test]
    fn errors_ends_and_stops_belong_to_their_members() {
        // The potential ends at 3, where faster members arrive.
        let edge = json!({ "system": {
            "mass": [1.0], "potential": "-q0 + 0*sqrt(3 - q0)",
            "damping": [{ "order": 0.5, "coefficient": [0.1] }],
        } });
        let batch = batch(scenario(edge), &["initial.momentum[0]", "system.damping[0].order"]);
        let numbers = [-9.0, 0.5, 1.0, 0.5, 1.0, 2.5, 0.0, 0.5];
        let runs = batch.run(&numbers, None, &AtomicBool::new(false), &mut |_| {});
        assert_eq!(runs[0].as_ref().unwrap().end, RunEnd::Completed);
        let failed = runs[1].as_ref().unwrap();
        assert!(matches!(&failed.end, RunEnd::Failed { step, .. } if *step == failed.steps), "{failed:?}");
        assert_eq!(failed.rows.len(), failed.steps + 1);
        let refused = runs[2].as_ref().unwrap_err();
        assert_eq!((refused.key(), refused.value()), ("system.damping[0].order", "2.5"));
        assert_eq!(runs[3].as_ref().unwrap().rows.time[0], 0.0);
        let stopped = batch.run(&numbers, None, &AtomicBool::new(true), &mut |_| {});
        assert!(stopped.iter().all(|run| run.as_ref().is_ok_and(|run| run.end == RunEnd::Stopped)));
    }

    #[test]
    fn a_step_that_is_too_long_for_one_member_is_refused_for_it() {
        let explicit = json!({ "scheme": { "kind": "low-order", "kappa": 0.0 } });
        let batch = batch(scenario(explicit), &["system.parameters.k"]);
        let runs = batch.run(&[1.0, 1e4], None, &AtomicBool::new(false), &mut |_| {});
        assert!(runs[0].is_ok());
        assert_eq!(runs[1].as_ref().unwrap_err().key(), "time.step");
    }
}
