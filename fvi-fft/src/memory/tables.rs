//! Tables from which memories are built, computed once for many runs.

use super::EngineError;
use std::any::{Any, TypeId};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// Tables of exponentials and of matrix weights, shared by the memories of many runs, on any number of
/// threads.
///
/// A search for exponentials takes as long as many thousands of steps, and all runs of a sweep with the same
/// kernel, step size and length need the same table. The first request computes it, while others for it wait.
/// The number of tables is bounded: the least recently used one is dropped first.
#[derive(Debug, Default)]
pub struct Tables {
    /// In order of use, the latest last.
    kept: Mutex<Vec<TableEntry>>,
}

#[derive(Debug)]
struct TableEntry {
    key: Key,
    table: Arc<OnceLock<Box<dyn Any + Send + Sync>>>,
}

/// The type of a table, and the numbers that it is computed from.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Key {
    table: TypeId,
    numbers: Vec<u64>,
}

/// Largest number of tables kept, each of some kilobytes.
const MOST: usize = 256;

impl Tables {
    /// The table that `make` computes from `numbers`, or its error: both are cached.
    pub(super) fn get<V: Send + Sync + 'static>(
        &self,
        numbers: &[u64],
        make: impl Fn() -> Result<V, EngineError>,
    ) -> Result<Arc<V>, EngineError> {
        let kept = self.place(Key { table: TypeId::of::<V>(), numbers: numbers.to_vec() });
        let made = kept.get_or_init(|| Box::new(make().map(Arc::new)));
        match made.downcast_ref::<Result<Arc<V>, EngineError>>() {
            Some(made) => made.clone(),
            // The key includes the type, so the downcast succeeds.
            None => make().map(Arc::new),
        }
    }

    /// The cell of a table, which may still be empty.
    fn place(&self, key: Key) -> Arc<OnceLock<Box<dyn Any + Send + Sync>>> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let known = kept.iter().position(|kept| kept.key == key).map(|index| kept.remove(index));
        let newest = known.unwrap_or_else(|| TableEntry { key, table: Arc::default() });
        let table = Arc::clone(&newest.table);
        if kept.len() == MOST {
            kept.remove(0);
        }
        kept.push(newest);
        table
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::memory::MemoryRequest;
    use crate::memory::{Engine, History};
    use crate::quadrature::ConvolutionFamily;
    use crate::transfer::TransferFunction;
    use fvi_core::Memory;
    use std::cell::Cell;

    #[test]
    fn a_table_is_made_once_until_many_others_have_been_asked_for() {
        let (tables, made) = (Tables::default(), Cell::new(0));
        let ask = |number: u64| {
            let table = tables.get(&[number], || {
                made.set(made.get() + 1);
                Ok(number)
            });
            assert_eq!(*table.unwrap(), number);
        };
        for number in [1, 2, 1, 1, 2] {
            ask(number);
        }
        assert_eq!(made.get(), 2);
        // The same numbers with another type give another table.
        assert_eq!(*tables.get(&[1], || Ok("text")).unwrap(), "text");
        (3..=MOST as u64).for_each(ask);
        ask(2);
        assert_eq!(made.get(), MOST);
        ask(1);
        assert_eq!(made.get(), MOST + 1);
    }

    #[test]
    fn a_refusal_is_remembered_too() {
        let (tables, tried) = (Tables::default(), Cell::new(0));
        for _ in 0..3 {
            let refusal = tables.get::<u64>(&[], || {
                tried.set(tried.get() + 1);
                Err(EngineError::TableEnds { reach: 1, samples: 2 })
            });
            assert_eq!(refusal, Err(EngineError::TableEnds { reach: 1, samples: 2 }));
        }
        assert_eq!(tried.get(), 1);
    }

    /// Memory terms of an oscillation, as bits.
    fn terms(request: &MemoryRequest<'_>, tables: &Tables) -> Vec<u64> {
        let mut memory = request.build_with::<f64>(tables).unwrap();
        let (mut term, stages) = (vec![0.0; memory.channels()], memory.channels());
        let mut terms = Vec::new();
        for k in 0..200_u16 {
            memory.begin_step(request.step_size).unwrap();
            memory.next_term(&mut term).unwrap();
            terms.extend(term.iter().map(|term| term.to_bits()));
            memory.push(&vec![(f64::from(k) * 0.3).cos(); stages]).unwrap();
        }
        terms
    }

    #[test]
    fn memories_of_shared_tables_have_the_bits_of_others_and_every_parameter_tells_them_apart() {
        let tables = Tables::default();
        let history = |engine| History { engine: Some(engine), ..History::default() };
        let families = [
            (ConvolutionFamily::Bdf { order: 1 }, Engine::ExponentialSum),
            (ConvolutionFamily::Bdf { order: 2 }, Engine::ExponentialSum),
            (ConvolutionFamily::Bdf { order: 3 }, Engine::BlockFft),
            (ConvolutionFamily::RadauIia { stages: 2 }, Engine::ExponentialSum),
            (ConvolutionFamily::LobattoIiic { stages: 2 }, Engine::ExponentialSum),
            (ConvolutionFamily::RadauIia { stages: 2 }, Engine::AnyStep),
        ];
        let mut seen = Vec::new();
        // In the second round all tables are cached.
        for round in 0..2 {
            for (family, engine) in families {
                for (exponent, step_size, tolerance) in
                    [(0.5, 0.25, None), (0.05, 0.25, None), (0.5, 0.125, None), (0.5, 0.25, Some(1e-6))]
                {
                    let history = History { tolerance, ..history(engine) };
                    let transfer = TransferFunction::power(exponent).unwrap();
                    let request = MemoryRequest {
                        family,
                        starting: &[],
                        transfer: &transfer,
                        step_size,
                        end: None,
                        coordinates: 1,
                        motions: 1,
                        samples: 201,
                        given: false,
                        history: &history,
                    };
                    let alone = terms(&request, &Tables::default());
                    assert!(terms(&request, &tables) == alone, "{request:?}");
                    if round == 0 && tolerance.is_none() {
                        assert!(!seen.contains(&alone), "{request:?} gives what another one does");
                        seen.push(alone);
                    }
                }
            }
        }
    }

    #[test]
    fn runs_of_any_length_share_weights_without_a_change() {
        let tables = Tables::default();
        let transfer = TransferFunction::power(0.5).unwrap();
        for engine in [Engine::BlockFft, Engine::RealTime] {
            let history = History { engine: Some(engine), ..History::default() };
            for samples in [400, 201, 3000] {
                let request = MemoryRequest {
                    family: ConvolutionFamily::Bdf { order: 2 },
                    starting: &[],
                    transfer: &transfer,
                    step_size: 0.25,
                    end: None,
                    coordinates: 1,
                    motions: 1,
                    samples,
                    given: false,
                    history: &history,
                };
                assert!(terms(&request, &tables) == terms(&request, &Tables::default()), "{samples}");
            }
        }
    }
}
