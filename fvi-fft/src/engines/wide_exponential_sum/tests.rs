//! The cost of steps and its division among threads, on which the bits of the result do not depend and which
//! are therefore counted here by hand; and channels that are redistributed among memories.

use super::*;

/// One slowly decaying sum and two others.
const TABLE: ExponentialTable<&[f64]> = ExponentialTable {
    stages: 1,
    head: &[2.0, 1.0],
    exponentials: &[1e-3, 0.3, 0.5, 0.0, 1.0, 1.0, 1.0, 0.0],
    slow_blocks: 0,
    far_blocks: 0,
    horizon: 100,
    step_size: 1.0,
};

fn three_kernels(channels: usize) -> WideExponentialSum<f64, f32> {
    WideExponentialSum::of_kernels(&[TABLE; 3], channels).unwrap()
}

#[test]
fn bytes_are_those_of_the_object_and_of_every_number() {
    // Two tiles of 32 channels.
    let memory = three_kernels(40);
    let (chunk, sums, row) = (32, 3, 8 * size_of::<f64>());
    // Eight weights for each earlier sample of the chunk, each sum and each sample of the previous chunk.
    let kernel = size_of::<KernelPlan<f64>>() + (8 + 16 + 24) * row + 4 * (sums + chunk) * row;
    // Coefficients of each sample for up to eight sums; three leading weights; the loss of each sum.
    let plan = 3 * kernel + chunk * row + (3 + sums) * size_of::<f64>();
    // Three kernels' places, the sums, and the rest of the slow one, each of four bytes.
    let channel = (3 * chunk + sums + 1) * 4;
    assert_eq!(memory.channel_bytes(), channel);
    let groups = 3 * chunk / 8 * size_of::<Vec<Lanes<f32>>>();
    assert_eq!(memory.bytes(), size_of_val(&memory) + plan + 64 * channel + groups);
}

#[test]
fn a_step_costs_its_products_and_what_it_reads_and_writes() {
    let plan = three_kernels(1).plan;
    // The five newest samples on three terms, each of which is also read and written.
    let terms = MULTIPLY_ADD * 15 + FETCH * 5 + FETCH_OUTSIDE * 12;
    assert_eq!([5, 13, 29].map(|place| plan.cost_of_terms(place)), [terms; 3]);
    assert_eq!(plan.cost_of_terms(8), FETCH_OUTSIDE * 12);
    // Within a group a sample is stored.
    assert_eq!([0, 14].map(|place| plan.cost_of_sample(place)), [FETCH * 2 + FETCH_OUTSIDE; 2]);
    // After sixteen samples the next eight terms of each kernel get their contribution.
    let due = MULTIPLY_ADD * (3 * 8 * 16) + FETCH * (16 + 3 * (8 + 8)) + FETCH_OUTSIDE;
    assert_eq!(plan.cost_of_sample(15), due);
    // At the end 32 terms of each kernel from 32 samples and three sums, and these sums from the samples.
    let products = 3 * 32 * (32 + 3) + 3 * 32;
    let numbers = 32 + 3 * 32 + (3 + 3);
    assert_eq!(plan.cost_of_sample(31), MULTIPLY_ADD * products + FETCH * numbers + FETCH_OUTSIDE);
}

#[test]
fn work_is_shared_where_it_is_worth_a_thread() {
    // A hundred tiles.
    const CHANNELS: usize = 3200;
    let memory = three_kernels(CHANNELS).on_threads(4);
    let shared = |work: usize, awake| memory.shares(work / CHANNELS, |_| awake);
    assert_eq!(shared(2 * WAKE - CHANNELS, false), (1, 100));
    assert_eq!(shared(2 * WAKE, false), (2, 5));
    assert_eq!(shared(4 * WAKE, false), (4, 3));
    assert_eq!(shared(4 * SHARE - CHANNELS, true), (1, 100));
    // No short parts.
    assert_eq!(shared(4 * SHARE, true), (4, 13));
    // Sixteen parts for each thread.
    assert_eq!(shared(64 * SHORTEST_PART, true), (4, 2));
    // More parts where they would be long.
    assert_eq!(shared(100 * LONGEST_PART, false), (4, 1));
    let alone = three_kernels(CHANNELS).on_threads(0);
    assert_eq!(alone.shares(100 * LONGEST_PART / CHANNELS, |_| false), (1, 100));
}

/// Pushes samples that differ between channels; the first channel of the memory is channel `first` of all.
fn push(memory: &mut WideExponentialSum<f64, f32>, first: usize, steps: core::ops::Range<u16>) {
    for k in steps {
        let sample: Vec<f64> =
            (0..memory.channels()).map(|channel| (f64::from(k) * (first + channel) as f64).sin()).collect();
        memory.push(&sample).unwrap();
    }
}

fn saved(memory: &WideExponentialSum<f64, f32>) -> Vec<u8> {
    let mut bytes = vec![0; memory.state_bytes()];
    memory.save(&mut StateWriter::new(&mut bytes)).unwrap();
    bytes
}

#[test]
fn channels_that_are_divided_anew_go_on_with_their_bits() {
    // From 70 and 40 channels to 25 and 85, in the middle of a chunk and of eight places.
    let [mut first, mut second, mut whole] = [70, 40, 110].map(three_kernels);
    push(&mut first, 0, 0..77);
    push(&mut second, 70, 0..77);
    push(&mut whole, 0, 0..80);
    let states = [saved(&first), saved(&second)];
    let [mut short, mut long] = [25, 85].map(three_kernels);
    let take = |memory: &mut WideExponentialSum<f64, f32>, state: usize, first, count, to| {
        let channels = SavedChannels { of: [70, 40][state], first, count, to };
        memory.restore_channels(&mut StateReader::new(&states[state]), channels)
    };
    assert_eq!(take(&mut short, 0, 0, 25, 0), Ok(()));
    assert_eq!(take(&mut long, 0, 25, 45, 0), Ok(()));
    assert_eq!(take(&mut long, 1, 0, 40, 45), Ok(()));
    assert_eq!((short.len(), long.len()), (77, 77));
    push(&mut short, 0, 77..80);
    push(&mut long, 25, 77..80);
    let terms = |memory: &mut WideExponentialSum<f64, f32>| {
        let mut terms = vec![0.0; 3 * memory.channels()];
        memory.next_term(&mut terms).unwrap();
        terms
    };
    let (expected, parts) = (terms(&mut whole), [terms(&mut short), terms(&mut long)]);
    for kernel in 0..3 {
        let found = [&parts[0][25 * kernel..][..25], &parts[1][85 * kernel..][..85]].concat();
        assert!(found == expected[110 * kernel..][..110], "kernel {kernel}");
    }
}

#[test]
fn channels_that_are_not_there_and_other_numbers_of_samples_are_refused() {
    let [mut source, mut memory] = [40, 40].map(three_kernels);
    push(&mut source, 0, 0..9);
    push(&mut memory, 0, 0..10);
    let (state, before) = (saved(&source), saved(&memory));
    let mut take = |bytes: &[u8], channels| memory.restore_channels(&mut StateReader::new(bytes), channels);
    let all = SavedChannels { of: 40, first: 0, count: 40, to: 0 };
    let too_large = |what| Err(StateError::TooLarge { what, limit: 40, found: 41 });
    assert_eq!(take(&state, SavedChannels { first: 1, ..all }), too_large("channels of the state"));
    assert_eq!(take(&state, SavedChannels { to: 1, ..all }), too_large("channels"));
    assert_eq!(
        take(&state, SavedChannels { of: 41, ..all }),
        Err(StateError::Mismatch { what: "channels", expected: 41, found: 40 })
    );
    assert_eq!(take(&state, all), Err(StateError::Mismatch { what: "samples", expected: 10, found: 9 }));
    assert!(matches!(take(&state[..state.len() - 1], all), Err(StateError::Truncated { .. })));
    assert!(saved(&memory) == before);
}
