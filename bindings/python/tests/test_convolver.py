"""Finite responses on a stream against NumPy's convolution."""

import pickle

import numpy as np
import pytest

import fvi

RANDOM = np.random.default_rng(7)
ROOM = RANDOM.standard_normal(3000) * np.exp(-np.arange(3000) / 500.0)
OTHER = RANDOM.standard_normal(2500) * np.exp(-np.arange(2500) / 400.0)
SIGNAL = RANDOM.uniform(-1.0, 1.0, 12_000)


def streamed(convolver, signal, sizes=(1, 64, 1000, 17, 333)):
    """The output of a signal in blocks of these sizes."""
    parts, first, turn = [], 0, 0
    while first < signal.shape[-1]:
        count = sizes[turn % len(sizes)]
        parts.append(convolver.process(signal[..., first : first + count]))
        first, turn = first + count, turn + 1
    return np.concatenate(parts, axis=-1)


def plain(response, signal=SIGNAL):
    return np.convolve(response, signal)[: len(signal)]


def bound(*responses, dtype=np.float64):
    return 16 * np.finfo(dtype).eps * sum(np.abs(response).sum() for response in responses)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("latency, block", [(0, None), (64, None), (0, 64), (1000, 1000)])
def test_blocks_give_the_convolution(dtype, latency, block):
    convolver = fvi.Convolver(ROOM.astype(dtype), latency, block=block)
    found = streamed(convolver, SIGNAL, (1, 64, 1000, 17, 333) if block is None else (block,))
    expected = np.concatenate([np.zeros(latency), plain(ROOM)])[: len(SIGNAL)]
    assert found.dtype == convolver.dtype == dtype and convolver.taken == len(SIGNAL)
    # The response and the signal are rounded as well.
    assert np.abs(found - expected).max() < bound(ROOM, dtype=dtype)


def test_channels_and_matrices_of_responses():
    two = np.stack([SIGNAL, SIGNAL[::-1]])
    shared = streamed(fvi.Convolver(ROOM, channels=2), two)
    each = streamed(fvi.Convolver(np.stack([ROOM, ROOM[::-1]])), two)
    matrix = np.stack([[ROOM, OTHER.repeat(2)[:3000], ROOM], [ROOM, ROOM, 0.0 * ROOM]])
    sums = fvi.Convolver(matrix)
    assert (sums.inputs, sums.outputs) == (2, 3)
    sums = streamed(sums, two)
    for output in range(2):
        assert np.abs(shared[output] - plain(ROOM, two[output])).max() < bound(ROOM)
        assert np.abs(each[output] - plain([ROOM, ROOM[::-1]][output], two[output])).max() < bound(ROOM)
    for output in range(3):
        expected = plain(matrix[0, output], two[0]) + plain(matrix[1, output], two[1])
        assert np.abs(sums[output] - expected).max() < bound(ROOM, OTHER, ROOM)


@pytest.mark.parametrize("fade", [0, 1, 256, 5000])
def test_an_exchange_is_the_crossfade(fade):
    convolver, first = fvi.Convolver(ROOM), 4321
    before = streamed(convolver, SIGNAL[:first])
    convolver.exchange(OTHER, fade=fade)
    assert convolver.exchange_left == fade
    found = np.concatenate([before, streamed(convolver, SIGNAL[first:])])
    share = np.clip((np.arange(len(SIGNAL)) - first) / max(fade, 1), 0.0, 1.0)
    share[first:] = share[first:] if fade else 1.0
    expected = (1.0 - share) * plain(ROOM) + share * plain(OTHER)
    assert np.abs(found - expected).max() < bound(ROOM, OTHER)
    assert convolver.exchange_left == 0


def test_one_exchange_at_a_time():
    convolver = fvi.Convolver(OTHER, longest=3000)
    convolver.exchange(ROOM, fade=100)
    with pytest.raises(RuntimeError, match="ends in 100 samples"):
        convolver.exchange(OTHER)
    convolver.process(SIGNAL[:100])
    convolver.exchange(OTHER, fade=0)
    found = convolver.process(SIGNAL[100:])
    assert np.abs(found - plain(OTHER)[100:]).max() < bound(OTHER)


@pytest.mark.parametrize("exchanged", [None, 0, 200, 2000])
def test_a_pickled_convolver_goes_on_with_the_same_bits(exchanged):
    convolver = fvi.Convolver(ROOM, 10, block=64)
    convolver.process(SIGNAL[:5000])
    if exchanged is not None:
        convolver.exchange(OTHER, fade=exchanged)
    convolver.process(SIGNAL[5000:6000])
    copy = pickle.loads(pickle.dumps(convolver))
    assert copy.taken == 6000 and copy.exchange_left == convolver.exchange_left
    assert (copy.process(SIGNAL[6000:]) == convolver.process(SIGNAL[6000:])).all()


def test_what_cannot_be_used_is_refused():
    for arguments, key in [
        (dict(response=[]), "response"),
        (dict(response=1.0), "response"),
        (dict(response=[1.0, np.nan]), "response[1]"),
        (dict(response=[1.0], latency=-1), "latency"),
        (dict(response=[1.0], latency=2**40), "latency"),
        (dict(response=[[1.0]], channels=2), "channels"),
        (dict(response=[1.0], block=0), "block"),
        (dict(response=[1.0], longest=2**40), "longest"),
    ]:
        with pytest.raises(fvi.InputError) as raised:
            fvi.Convolver(**arguments)
        assert key.split("[")[0] in raised.value.key, raised.value
    convolver = fvi.Convolver(ROOM)
    for block in ([[1.0]], [1.0, np.inf], 1.0):
        with pytest.raises(fvi.InputError):
            convolver.process(block)
    with pytest.raises(fvi.InputError, match="samples of a response"):
        convolver.exchange(np.ones(3001))
    with pytest.raises(fvi.InputError, match="new_response"):
        convolver.exchange([[1.0]])
    with pytest.raises(fvi.InputError, match="state"):
        convolver.restore(fvi.Convolver(OTHER).save())
    assert convolver.taken == 0
