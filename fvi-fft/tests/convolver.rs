//! A finite response and an endless stream against the plain sum.

use fvi_core::{Real, StateReader, StateWriter, Stateful};
use fvi_fft::sums::max_or_nan;
use fvi_fft::{Convolver, Engines, ExchangeError, Responses, Stream, StreamError};

/// The k-th of a sequence of numbers in (−1, 1) without pattern, so that any part of a long stream is known.
fn noise<T: Real>(seed: u64, k: u64) -> T {
    let mut bits = k.wrapping_add(seed << 40).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    T::of(((bits ^ (bits >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0)
}

/// A response that decays like that of a room.
fn room<T: Real>(seed: u64, length: usize) -> Vec<T> {
    let decay = |n: usize| (-5.0 * n as f64 / length as f64).exp();
    (0..length).map(|n| T::of(decay(n) * noise::<f64>(seed, n as u64))).collect()
}

/// Σ w(n) x(k − n) in double precision.
fn plain<T: Real>(response: &[T], x: impl Fn(u64) -> T, k: u64) -> f64 {
    let lags = response.iter().zip((0..=k).rev());
    lags.map(|(w, j)| w.to_f64() * x(j).to_f64()).sum()
}

/// Units of rounding of Σ|w| max|x| by which outputs may differ from the plain sum.
const UNITS: f64 = 8.0;

fn size<T: Real>(response: &[T]) -> f64 {
    response.iter().map(|w| w.to_f64().abs()).sum()
}

/// Lengths of calls that end at, before and after the ends of blocks of every size.
fn calls(block: usize) -> impl Iterator<Item = usize> {
    let uneven = [1, 7, 64, 3, 160, 15, 1, 1, 333, 16, 48, 1024, 5, 0, 2000];
    (0..).map(move |call| if block > 0 { block } else { uneven[call % uneven.len()] })
}

/// The stream of `seed` through a convolver, in calls of `block` samples, or uneven ones for 0.
fn run<T: Engines>(convolver: &mut Convolver<T>, seed: u64, block: usize, count: usize) -> Vec<T> {
    let (mut output, first) = (vec![T::zero(); count], convolver.taken());
    let mut at = 0;
    for samples in calls(block) {
        let samples = samples.min(count - at);
        let input: Vec<T> = (at..at + samples).map(|k| noise(seed, first + k as u64)).collect();
        convolver.process_one(&input, &mut output[at..at + samples]).unwrap();
        at += samples;
        if at == count {
            break;
        }
    }
    output
}

fn largest_error<T: Real>(response: &[T], seed: u64, latency: u64, output: &[T], step: usize) -> f64 {
    let errors = output.iter().zip(0..).step_by(step).map(|(y, k): (_, u64)| {
        let expected = if k < latency { 0.0 } else { plain(response, |j| noise(seed, j), k - latency) };
        (y.to_f64() - expected).abs()
    });
    errors.fold(0.0, max_or_nan) / (size(response) * T::EPSILON.to_f64() / 2.0)
}

fn conforms<T: Engines>() {
    for length in [1, 2, 15, 16, 17, 31, 64, 100, 127, 128, 129, 1000, 5000] {
        let response = room::<T>(length as u64, length);
        let responses = Responses::one(&response).unwrap();
        for (latency, block, call) in [
            (0, None, 0),
            (0, Some(1), 1),
            (0, Some(64), 64),
            (0, Some(64), 0),
            (0, Some(48), 48),
            (0, Some(1024), 1024),
            (3, None, 0),
            (64, Some(64), 64),
            (1000, None, 0),
        ] {
            let stream = Stream { latency, block, longest: 0 };
            let mut convolver = Convolver::new(&responses, &stream).unwrap();
            let output = run(&mut convolver, 1, call, 3 * length + 4000);
            let error = largest_error(&response, 1, latency as u64, &output, 1 + length / 100);
            assert!(error < UNITS, "{length} samples, {stream:?}, calls of {call}: {error} units");
            assert_eq!(convolver.overruns(), 0, "{length} samples, {stream:?}, calls of {call}");
        }
    }
}

#[test]
fn blocks_of_any_size_give_the_plain_sum_in_double_precision() {
    conforms::<f64>();
}

#[test]
fn blocks_of_any_size_give_the_plain_sum_in_single_precision() {
    conforms::<f32>();
}

/// A second of response, and places far from the beginning.
#[test]
fn a_long_stream_has_the_errors_of_a_short_one() {
    let response = room::<f32>(3, 48_000);
    let responses = Responses::one(&response).unwrap();
    let mut convolver = Convolver::new(&responses, &Stream::default()).unwrap();
    run(&mut convolver, 4, 4096, 2_000_000);
    let output = run(&mut convolver, 4, 0, 100_000);
    let mut largest = 0.0;
    for place in (0..200).map(|place| place * 499) {
        let expected = plain(&response, |j| noise(4, j), 2_000_000 + place as u64);
        largest = max_or_nan(largest, (f64::from(output[place]) - expected).abs());
    }
    let units = largest / (size(&response) * f64::from(f32::EPSILON) / 2.0);
    assert!(units < UNITS, "{units} units");
    assert_eq!((convolver.overruns(), convolver.taken()), (0, 2_100_000));
}

#[test]
fn a_matrix_of_responses_sums_over_its_inputs() {
    let (inputs, outputs, length) = (3, 2, 700);
    // The second input does not reach the first output.
    let taps: Vec<Vec<f64>> =
        (0..6).map(|p| if p == 2 { vec![] } else { room(p, length - p as usize) }).collect();
    let responses = Responses::matrix(outputs, &taps).unwrap();
    for block in [None, Some(128)] {
        let stream = Stream { block, ..Stream::default() };
        let mut convolver = Convolver::new(&responses, &stream).unwrap();
        assert_eq!((convolver.inputs(), convolver.outputs()), (inputs, outputs));
        let count = 128 * 30;
        let x: Vec<Vec<f64>> =
            (0..inputs).map(|i| (0..count).map(|k| noise(i as u64, k as u64)).collect()).collect();
        let mut y = vec![vec![0.0; count]; outputs];
        for first in (0..count).step_by(128) {
            let parts: Vec<&[f64]> = x.iter().map(|x| &x[first..first + 128]).collect();
            let mut into: Vec<&mut [f64]> = y.iter_mut().map(|y| &mut y[first..first + 128]).collect();
            convolver.process(&parts, &mut into).unwrap();
        }
        let total: f64 = taps.iter().map(|taps| size(taps)).sum();
        for (o, y) in y.iter().enumerate() {
            for k in (0..count).step_by(17) {
                let sum = |i: usize| plain(&taps[i * outputs + o], |j| x[i][j as usize], k as u64);
                let expected: f64 = (0..inputs).map(sum).sum();
                assert!((y[k] - expected).abs() < UNITS * total * f64::EPSILON / 2.0, "{o}, {k}");
            }
        }
    }
}

#[test]
fn channels_with_a_shared_response_do_not_disturb_each_other() {
    let response = room::<f32>(1, 900);
    let mut convolver =
        Convolver::new(&Responses::shared(&response, 5).unwrap(), &Stream::default()).unwrap();
    let mut single = Convolver::new(&Responses::one(&response).unwrap(), &Stream::default()).unwrap();
    let count = 3000;
    let x: Vec<Vec<f32>> = (0..5).map(|i| (0..count).map(|k| noise(i, k)).collect()).collect();
    let mut y = vec![vec![0.0; count as usize]; 5];
    convolver.process(&x, &mut y).unwrap();
    let mut alone = vec![0.0; count as usize];
    single.process_one(&x[3], &mut alone).unwrap();
    let error = y[3].iter().zip(&alone).map(|(a, b)| (a - b).abs()).fold(0.0, max_or_nan);
    assert!(error <= 8.0 * size(&response) as f32 * f32::EPSILON, "{error}");
}

/// The crossfade of two plain sums.
fn faded(old: &[f64], new: &[f64], start: u64, fade: u64, k: u64) -> f64 {
    let x = |j| noise(9, j);
    let share = if k < start {
        0.0
    } else if k - start < fade {
        (k - start) as f64 / fade as f64
    } else {
        1.0
    };
    (1.0 - share) * plain(old, x, k) + share * plain(new, x, k)
}

#[test]
fn an_exchange_is_the_crossfade_of_the_two_convolutions() {
    let (old, new) = (room::<f64>(1, 3000), room::<f64>(2, 2500));
    for (block, call) in [(None, 0), (Some(64), 64), (Some(64), 0), (Some(512), 512)] {
        for (before, fade) in [(0, 256), (512, 0), (5120, 256), (7680, 4096), (2560, 10_000)] {
            let stream = Stream { block, ..Stream::default() };
            for evenly in [false, true] {
                let mut convolver = Convolver::new(&Responses::one(&old).unwrap(), &stream).unwrap();
                let prepared = convolver.preparer().prepare(&Responses::one(&new).unwrap()).unwrap();
                let mut output = run(&mut convolver, 9, call, before);
                let exchanged = match evenly {
                    true => convolver.exchange_evenly(prepared, fade).unwrap(),
                    false => convolver.exchange(prepared, fade).unwrap(),
                };
                let start = before as u64 + exchanged.begins_in;
                assert!(evenly || exchanged.begins_in == 0);
                assert!(exchanged.retired.is_none());
                output.extend(run(&mut convolver, 9, call, fade + 12_288));
                let errors = (0..output.len())
                    .step_by(37)
                    .map(|k| (output[k] - faded(&old, &new, start, fade as u64, k as u64)).abs());
                let units = errors.fold(0.0, max_or_nan) / (size(&old) * f64::EPSILON / 2.0);
                let case = format!("{stream:?}, {call}, {before}, {fade}, {evenly}");
                assert!(units < 2.0 * UNITS, "{case}: {units} units");
                assert_eq!((convolver.overruns(), convolver.exchange_left()), (0, 0), "{case}");
                assert!(convolver.take_retired().is_some(), "{case}");
            }
        }
    }
}

#[test]
fn exchanges_follow_each_other_and_the_responses_come_back() {
    let first = room::<f32>(1, 2000);
    let stream = Stream { longest: 3000, ..Stream::default() };
    let mut convolver = Convolver::new(&Responses::one(&first).unwrap(), &stream).unwrap();
    let preparer = convolver.preparer();
    // On another thread, as a program does.
    let prepare = move |seed| preparer.prepare(&Responses::one(&room::<f32>(seed, 3000)).unwrap()).unwrap();
    let mut ready = std::thread::spawn(move || [2, 3].map(prepare)).join().unwrap().into_iter();
    run(&mut convolver, 1, 0, 1000);
    assert!(convolver.exchange(ready.next().unwrap(), 100).unwrap().retired.is_none());
    let Err(ExchangeError::Busy { left: 100, responses }) = convolver.exchange(ready.next().unwrap(), 5)
    else {
        panic!("an exchange began while another was under way");
    };
    run(&mut convolver, 1, 0, 101);
    let old = convolver.exchange(responses, 0).unwrap().retired.unwrap();
    let newest = room::<f32>(3, 3000);
    let output = run(&mut convolver, 1, 0, 500);
    let expected = plain(&newest, |j| noise(1, j), 1101 + 499);
    assert!((f64::from(output[499]) - expected).abs() < UNITS * size(&newest) * f64::from(f32::EPSILON));
    // What came back is whole.
    convolver.exchange(old, 0).unwrap();
    let output = run(&mut convolver, 1, 0, 500);
    let expected = plain(&first, |j| noise(1, j), 1601 + 499);
    assert!((f64::from(output[499]) - expected).abs() < UNITS * size(&first) * f64::from(f32::EPSILON));
}

fn saved<T: Engines>(convolver: &Convolver<T>) -> Vec<u8> {
    let mut bytes = vec![0; convolver.state_bytes()];
    let mut writer = StateWriter::new(&mut bytes);
    convolver.save(&mut writer).unwrap();
    assert_eq!(writer.written(), convolver.state_bytes());
    bytes
}

#[test]
fn a_restored_stream_goes_on_with_the_same_bits() {
    let response = room::<f32>(1, 3000);
    for (block, call, latency) in [(None, 0, 0), (Some(64), 64, 0), (Some(64), 0, 0), (None, 100, 128)] {
        for before in [0, 10, 640, 5000, 40_000] {
            let stream = Stream { block, latency, longest: 0 };
            let make = || Convolver::new(&Responses::one(&response).unwrap(), &stream).unwrap();
            let mut convolver = make();
            run(&mut convolver, 1, call, before);
            let state = saved(&convolver);
            let mut other = make();
            // What it did before does not matter.
            run(&mut other, 7, 0, 3333);
            let mut reader = StateReader::new(&state);
            other.restore(&mut reader).unwrap();
            reader.finish().unwrap();
            let (a, b) = (run(&mut convolver, 1, call, 9000), run(&mut other, 1, call, 9000));
            assert_eq!(a, b, "{stream:?}, {call}, {before}");
            assert_eq!((other.taken(), other.overruns()), (convolver.taken(), 0));
        }
    }
}

#[test]
fn an_exchange_under_way_is_restored_where_the_same_has_begun() {
    let response = |seed| Responses::one(&room::<f64>(seed, 2000)).unwrap();
    let make = || Convolver::new(&response(1), &Stream::default()).unwrap();
    let mut convolver = make();
    run(&mut convolver, 1, 0, 5000);
    convolver.exchange(convolver.preparer().prepare(&response(2)).unwrap(), 1000).unwrap();
    run(&mut convolver, 1, 0, 300);
    let state = saved(&convolver);
    let mut other = make();
    assert!(other.restore(&mut StateReader::new(&state)).is_err());
    other.exchange(other.preparer().prepare(&response(2)).unwrap(), 7).unwrap();
    other.restore(&mut StateReader::new(&state)).unwrap();
    assert_eq!(other.exchange_left(), 700);
    assert_eq!(run(&mut convolver, 1, 0, 4000), run(&mut other, 1, 0, 4000));
}

#[test]
fn the_longest_fade_is_saved_and_restored() {
    let response = |seed| Responses::one(&room::<f32>(seed, 300)).unwrap();
    let make = || {
        let mut convolver = Convolver::new(&response(1), &Stream::default()).unwrap();
        run(&mut convolver, 1, 0, 100);
        convolver.exchange(convolver.preparer().prepare(&response(2)).unwrap(), usize::MAX).unwrap();
        convolver
    };
    let (mut convolver, mut other) = (make(), make());
    assert!(convolver.exchange_left() > u64::from(u32::MAX));
    run(&mut convolver, 1, 0, 1000);
    other.restore(&mut StateReader::new(&saved(&convolver))).unwrap();
    assert_eq!(other.exchange_left(), convolver.exchange_left());
    assert_eq!(run(&mut convolver, 1, 0, 1000), run(&mut other, 1, 0, 1000));
}

#[test]
fn a_state_of_the_same_numbers_in_other_responses_is_refused() {
    let make = |responses| Convolver::<f64>::new(&responses, &Stream::default()).unwrap();
    let divided = |first: &[f64], second: &[f64]| make(Responses::each(&[first, second]).unwrap());
    let given = divided(&[1.0, 2.0], &[3.0, 4.0, 5.0]);
    let state = saved(&given);
    assert!(divided(&[1.0, 2.0], &[3.0, 4.0, 5.0]).restore(&mut StateReader::new(&state)).is_ok());
    assert!(divided(&[1.0, 2.0, 3.0], &[4.0, 5.0]).restore(&mut StateReader::new(&state)).is_err());
    // One for both channels, or half of it for each.
    let state = saved(&make(Responses::shared(&[1.0, 2.0], 2).unwrap()));
    assert!(divided(&[1.0], &[2.0]).restore(&mut StateReader::new(&state)).is_err());
}

/// As many samples later: the same state with another number of samples taken.
fn later<T: Engines>(convolver: &mut Convolver<T>, samples: u64) {
    let mut state = saved(convolver);
    // The count follows the header of six entries.
    let taken = &mut state[4 + 1 + 6 * 8..][..8];
    assert_eq!(taken, convolver.taken().to_le_bytes());
    taken.copy_from_slice(&(convolver.taken() + samples).to_le_bytes());
    convolver.restore(&mut StateReader::new(&state)).unwrap();
}

/// The samples before and after so many, and an exchange across them, against the plain sum.
fn conforms_at<T: Engines>(place: u64) {
    let (old, new) = (room::<T>(1, 3000), room::<T>(2, 2500));
    for (block, call) in [(None, 0), (Some(1), 1), (Some(64), 64), (Some(512), 512)] {
        let stream = Stream { block, ..Stream::default() };
        let mut convolver = Convolver::new(&Responses::one(&old).unwrap(), &stream).unwrap();
        let (first, fade) = (place - 2048, 4000);
        // More than a state holds; the samples are those before `first`.
        let before: Vec<T> = (first - 20_480..first).map(|k| noise(9, k)).collect();
        convolver.process_one(&before, &mut vec![T::zero(); before.len()]).unwrap();
        later(&mut convolver, first - 20_480);
        assert_eq!(convolver.taken(), first);
        let prepared = convolver.preparer().prepare(&Responses::one(&new).unwrap()).unwrap();
        convolver.exchange(prepared, fade).unwrap();
        let output = run(&mut convolver, 9, call, 10_240);
        let sum = |w: &[T], k| {
            let lags = w.iter().enumerate();
            lags.map(|(n, w)| w.to_f64() * noise::<T>(9, k - n as u64).to_f64()).sum::<f64>()
        };
        for (past, y) in output.iter().enumerate().step_by(23) {
            let (k, share) = (first + past as u64, (past as f64 / fade as f64).min(1.0));
            let expected = (1.0 - share) * sum(&old, k) + share * sum(&new, k);
            let units = (y.to_f64() - expected).abs() / (size(&old) * T::EPSILON.to_f64() / 2.0);
            assert!(units < 2.0 * UNITS, "{stream:?}: sample {k}, {units} units");
        }
        assert_eq!((convolver.overruns(), convolver.exchange_left()), (0, 0));
    }
}

#[test]
fn sums_go_on_where_counters_of_32_bits_and_numbers_of_53_end() {
    for place in [1 << 31, 1 << 32, 1 << 53, 1 << 61] {
        conforms_at::<f32>(place);
        conforms_at::<f64>(place);
    }
}

#[test]
fn what_cannot_be_used_is_refused_and_changes_nothing() {
    assert_eq!(Responses::<f64>::one(&[]).unwrap_err().parameter, "samples of a response");
    assert_eq!(Responses::one(&[1.0, f64::NAN]).unwrap_err().parameter, "response");
    assert_eq!(Responses::shared(&[1.0], 0).unwrap_err().parameter, "channels");
    assert_eq!(Responses::<f64>::each(&[[]; 2]).unwrap_err().value, 0.0);
    assert_eq!(Responses::matrix(2, &[[1.0]; 3]).unwrap_err().value, 3.0);
    assert_eq!(Responses::matrix(0, &[[1.0]; 3]).unwrap_err().parameter, "responses");

    let response = room::<f64>(1, 500);
    let responses = Responses::shared(&response, 2).unwrap();
    let mut convolver = Convolver::new(&responses, &Stream::default()).unwrap();
    let mut outputs = [[0.0; 3]; 2];
    let error = convolver.process(&[[1.0; 3]; 3], &mut outputs).unwrap_err();
    assert_eq!(error, StreamError::Channels { what: "inputs", expected: 2, found: 3 });
    let error = convolver.process(&[[1.0; 2]; 2], &mut outputs).unwrap_err();
    assert_eq!(error, StreamError::Samples { what: "outputs", channel: 0, expected: 2, found: 3 });
    let error = convolver.process(&[[1.0; 3], [1.0, f64::INFINITY, 0.0]], &mut outputs).unwrap_err();
    assert_eq!(error, StreamError::NotFinite { channel: 1, sample: 1 });
    assert_eq!(convolver.taken(), 0);
    let longer = Responses::shared(&room(1, 501), 2).unwrap();
    assert_eq!(convolver.preparer().prepare(&longer).err().unwrap().value, 501.0);
    assert_eq!(
        convolver.preparer().prepare(&Responses::one(&[1.0]).unwrap()).err().unwrap().parameter,
        "inputs"
    );
    let other = Convolver::new(&Responses::shared(&room(1, 5000), 2).unwrap(), &Stream::default()).unwrap();
    let foreign = other.preparer().prepare(&responses).unwrap();
    let refused = convolver.exchange(foreign, 1).err().unwrap();
    assert!(matches!(refused, ExchangeError::Foreign { .. }));
    // They can be used where they belong.
    let mut other = other;
    other.exchange(refused.into_responses(), 1).unwrap();
}

#[test]
fn a_cleared_convolver_begins_anew() {
    let response = room::<f64>(1, 4000);
    let stream = Stream { block: Some(64), ..Stream::default() };
    let mut convolver = Convolver::new(&Responses::one(&response).unwrap(), &stream).unwrap();
    let first = run(&mut convolver, 1, 64, 9000);
    convolver.clear();
    assert_eq!(first, run(&mut convolver, 1, 64, 9000));
}
