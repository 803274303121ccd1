"""Derivatives, weights, memories and operators against sums written out."""

import math

import numpy as np
import pytest

import fvi

ENGINES = ["direct", "block-fft", "real-time", "exponential-sum", "exponential-sum-core"]


def plain_sum(weights, x):
    return np.array([math.fsum(weights[: k + 1] * x[k::-1]) for k in range(len(x))])


def grunwald(exponent, count):
    w = [1.0]
    for n in range(1, count):
        w.append(w[-1] * (n - 1 - exponent) / n)
    return np.array(w)


@pytest.mark.parametrize("exponent", [-0.7, -0.5, 0.0, 0.3, 1.0, 1.6])
def test_weights_of_order_one_are_those_of_grunwald_and_letnikov(exponent):
    w = fvi.weights(exponent=exponent, step=0.1, count=50)
    assert np.allclose(w, grunwald(exponent, 50) * 0.1**-exponent, rtol=1e-12, atol=1e-300)


def test_matrix_weights_begin_with_the_power_of_the_inverse_matrix():
    w = fvi.weights(exponent=1.0, step=0.5, count=3, family="radau-iia", stages=2)
    assert w.shape == (3, 2, 2)
    assert np.allclose(w[0], [[3.0, 1.0], [-9.0, 5.0]])
    for change in (dict(stages=4), dict(stages=None), dict(family="gauss")):
        with pytest.raises(fvi.InputError):
            fvi.weights(**(dict(exponent=1.0, step=0.5, count=3, family="radau-iia", stages=2) | change))
    with pytest.raises(fvi.InputError) as caught:
        fvi.weights(exponent=1.9, step=1e-300, count=3)
    assert caught.value.key == "step"


@pytest.mark.parametrize("quadrature", [1, 2, 6])
@pytest.mark.parametrize("order", [-0.6, 0.4, 1.0, 1.7])
def test_a_derivative_has_the_error_of_the_plain_sum(order, quadrature):
    rng = np.random.default_rng(4)
    x = np.cumsum(rng.standard_normal(3000))
    w = fvi.weights(exponent=order, step=0.01, count=3000, order=quadrature)
    expected = plain_sum(w, x)
    scale = plain_sum(np.abs(w), np.abs(x))
    for engine in [None, *ENGINES]:
        y = fvi.derivative(x, order, 0.01, quadrature=f"bdf{quadrature}", start="riemann-liouville", engine=engine)
        assert (np.abs(y - expected) <= 16 * np.finfo(float).eps * scale).all(), engine


def test_a_long_sequence_has_it_too():
    x = np.random.default_rng(5).standard_normal(40_000)
    y = fvi.derivative(x, 0.5, 1.0, start="riemann-liouville")
    w = fvi.weights(exponent=0.5, step=1.0, count=len(x))
    for k in (0, 1, 20_000, 39_999):
        terms = w[: k + 1] * x[k::-1]
        assert abs(y[k] - math.fsum(terms)) <= 16 * np.finfo(float).eps * math.fsum(np.abs(terms))


def test_axes_and_layouts():
    x = np.random.default_rng(6).standard_normal((4, 50, 3))
    one_by_one = np.empty_like(x)
    for i in range(4):
        for j in range(3):
            one_by_one[i, :, j] = fvi.derivative(x[i, :, j], 1.4, 0.1, quadrature="bdf3")
    for array in (x, np.asfortranarray(x), x.astype(np.longdouble)):
        y = fvi.derivative(array, 1.4, 0.1, axis=1, quadrature="bdf3")
        assert y.shape == x.shape and np.allclose(y, one_by_one, rtol=0, atol=1e-12 * np.abs(one_by_one).max())
    assert np.array_equal(fvi.derivative(x[..., ::2], 1.4, 0.1, axis=-2), fvi.derivative(x[..., ::2].copy(), 1.4, 0.1, axis=1))
    single = fvi.derivative(x.astype(np.float32), 0.5, 0.1, axis=0)
    assert np.array_equal(single, fvi.derivative(x.astype(np.float32).astype(float), 0.5, 0.1, axis=0))
    assert fvi.derivative(np.empty((0, 3)), 0.5, 0.1, axis=0).shape == (0, 3)
    assert fvi.derivative([[]], 0.5, 0.1).shape == (1, 0)


def test_caputo_forgets_how_the_sequence_starts():
    t = 0.01 * np.arange(200)
    assert np.abs(fvi.derivative(5.0 + 0 * t, 0.5, 0.01)).max() == 0.0
    line = 3.0 + 2.0 * t
    assert np.abs(fvi.derivative(line, 1.5, 0.01, quadrature="bdf2")).max() < 1e-9
    assert np.abs(fvi.derivative(line, 1.5, 0.01, slope=2.0)).max() < 1e-9
    # The half derivative of t² is 2 t^1.5/Γ(2.5), for either form of the derivative.
    expected = 2 * t**1.5 / math.gamma(2.5)
    shifted = fvi.derivative(7.0 + t**2, 0.5, 0.01, quadrature="bdf2")
    assert np.abs(shifted - expected)[50:].max() < 1e-4
    with_starting = fvi.derivative(t**2, 0.5, 0.01, quadrature="bdf2", starting=[0.0, 1.0, 2.0])
    assert np.abs(with_starting - expected)[2:].max() < 1e-12


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (dict(x=[1.0, np.nan]), "x"),
        (dict(x=1.0), "x"),
        (dict(x=np.array([1, None])), "x"),
        (dict(x=["1"]), "x"),
        (dict(order=2.0), "order"),
        (dict(order=-1.0), "order"),
        (dict(step=0.0), "step"),
        (dict(step=[0.1]), "step"),
        (dict(axis=1), "axis"),
        (dict(quadrature="bdf7"), "quadrature"),
        (dict(start="weyl"), "start"),
        (dict(slope=1.0), "slope"),
        (dict(order=1.5, slope=[1.0, 2.0]), "slope"),
        (dict(engine="quick"), "engine"),
    ],
)
def test_what_cannot_be_used_is_named(change, key):
    with pytest.raises(fvi.InputError) as caught:
        fvi.derivative(**(dict(x=[1.0, 2.0, 4.0], order=0.5, step=0.1) | change))
    assert caught.value.key == key


@pytest.mark.parametrize("engine", ENGINES)
def test_memories_give_the_plain_sum_and_go_on_from_their_state(engine):
    def make():
        return fvi.Memory(exponent=0.5, step=0.01, order=2, channels=3, length=200, engine=engine)

    m, x = make(), np.random.default_rng(7).standard_normal((200, 3))
    w = fvi.weights(exponent=0.5, step=0.01, count=201, order=2)
    assert m.engine == engine and m.leading == pytest.approx(w[0])
    for k in range(120):
        expected = w[1 : k + 1] @ x[:k][::-1] if k else np.zeros(3)
        assert np.allclose(m.next_term(), expected, rtol=0, atol=1e-12 * np.abs(w).sum())
        m.push(x[k])
    state, other = m.save(), make()
    other.restore(state)
    assert len(other) == len(m) == 120
    for k in range(120, 200):
        assert np.array_equal(m.next_term(), other.next_term())
        m.push(x[k])
        other.push(x[k])
    for bad in (b"", state[:-1], state + b"x", b"\0" * len(state)):
        with pytest.raises(fvi.InputError):
            other.restore(bad)
    m.clear()
    assert len(m) == 0 and not m.next_term().any()


@pytest.mark.parametrize("exponent", [-0.5, 0.5, 1.5])
@pytest.mark.parametrize(("family", "stages"), [("radau-iia", 3), ("lobatto-iiic", 2)])
def test_memories_of_stages_give_the_plain_sum_of_values(family, stages, exponent):
    m = fvi.Memory(exponent=exponent, step=0.1, family=family, stages=stages, channels=2, length=40)
    w = fvi.weights(exponent=exponent, step=0.1, count=41, family=family, stages=stages)
    x = np.random.default_rng(8).standard_normal((40, 2, stages))
    for k in range(40):
        expected = sum((x[k - n] @ w[n].T for n in range(1, k + 1)), np.zeros((2, stages)))
        assert np.allclose(m.next_term(), expected, rtol=0, atol=1e-11 * np.abs(w).sum())
        m.push(x[k])


@pytest.mark.parametrize(
    ("exponent", "settings", "error"),
    [(0.5, {}, 1e-13), (1.4, dict(tolerance=1e-8), 1e-7), (0.5, dict(tolerance=1e-6, states="f32"), 1e-5)],
)
def test_memories_take_differences_and_settings_of_exponential_sums(exponent, settings, error):
    m = fvi.Memory(exponent=exponent, step=0.1, order=2, channels=100, length=200, samples="differences",
                   engine="exponential-sum", threads=1, **settings)  # fmt: skip
    assert m.samples == "increments"
    w = fvi.weights(exponent=exponent, step=0.1, count=200, order=2)
    x = np.cumsum(np.random.default_rng(3).standard_normal((200, 100)), axis=0)
    for k in range(200):
        increment = x[k] - x[k - 1] if k else x[0]
        found = m.leading * increment + m.next_term()
        assert np.abs(found - w[: k + 1] @ x[: k + 1][::-1]).max() < error * np.abs(w).sum() * np.abs(x).max()
        m.push(increment)
    # Orders close to zero gain nothing from differences.
    assert fvi.Memory(exponent=0.05, step=0.1, samples="differences").samples == "values"
    assert fvi.Memory(exponent=0.5, step=0.1).samples == "values"


def test_channels_are_divided_among_memories_anew():
    def make(channels):
        return fvi.Memory(exponent=0.5, step=0.1, channels=channels, length=300, engine="exponential-sum")

    x = np.random.default_rng(5).standard_normal((130, 250))
    whole, first, second, third = make(250), make(120), make(130), make(99)
    for sample in x:
        whole.push(sample)
        first.push(sample[:120])
        second.push(sample[120:])
    third.restore_channels(first.save(), of=120, first=100, count=20, to=0)
    third.restore_channels(second.save(), of=130, first=0, count=79, to=20)
    assert len(third) == 130 and np.array_equal(third.next_term(), whole.next_term()[100:199])
    for state, channels in (
        (first.save(), (120, 100, 21, 0)),
        (first.save(), (120, 0, 20, 80)),
        (b"", (120, 0, 1, 0)),
        (make(120).save(), (120, 0, 1, 0)),
    ):
        with pytest.raises(fvi.InputError, match="state"):
            third.restore_channels(state, *channels)
    assert np.array_equal(third.next_term(), whole.next_term()[100:199])


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (dict(samples="raw"), "samples"),
        (dict(tolerance=1e-3), "tolerance"),
        (dict(tolerance=1e-20), "tolerance"),
        (dict(tolerance=1e-8, engine="direct"), "tolerance"),
        (dict(tolerance=1e-8, family="radau-iia", stages=2), "tolerance"),
        (dict(states="f16"), "states"),
        (dict(states="f32"), "states"),
        (dict(states="f32", tolerance=1e-8), "states"),
        (dict(threads=0), "threads"),
        (dict(threads=2000), "threads"),
    ],
)
def test_settings_of_memories_that_cannot_be_used_are_named(change, key):
    with pytest.raises(fvi.InputError) as caught:
        fvi.Memory(**(dict(exponent=0.5, step=0.1) | change))
    assert caught.value.key == key


def test_memories_refuse_what_does_not_fit():
    m = fvi.Memory(exponent=0.5, step=0.1, length=2, engine="direct")
    for sample in (np.nan, [1.0, 2.0], "a", None):
        with pytest.raises(fvi.InputError):
            m.push(sample)
    m.push(1.0)
    m.push([2.0])
    with pytest.raises(RuntimeError, match="length"):
        m.push(3.0)
    staged = fvi.Memory(exponent=0.5, step=0.1, family="radau-iia", stages=2, channels=3)
    assert staged.next_term().shape == (3, 2) and staged.leading.shape == (2, 2)
    staged.push(np.ones((3, 2)))
    w = fvi.weights(exponent=0.5, step=0.1, count=2, family="radau-iia", stages=2)
    assert np.allclose(staged.next_term(), np.tile(w[1] @ [1.0, 1.0], (3, 1)))


def test_operators_give_the_values_of_whole_sequences():
    x = np.sin(0.1 * np.arange(300)) + 2.0
    for exponent, start, slope in [(0.5, "caputo", None), (-0.5, "riemann-liouville", None), (1.5, "caputo", 1.0)]:
        operator = fvi.Operator(exponent=exponent, step=0.1, order=2, start=start, slope=slope)
        one_by_one = [operator.push(value) for value in x[:150]]
        rest = operator.push_many(x[150:])
        whole = fvi.derivative(x, exponent, 0.1, quadrature="bdf2", start=start, slope=slope)
        assert np.allclose([*one_by_one, *rest], whole, rtol=0, atol=1e-11)
    with pytest.raises(fvi.InputError, match="slope"):
        fvi.Operator(exponent=1.5, step=0.1, start="caputo")
    with pytest.raises(fvi.InputError):
        operator.push(math.inf)
