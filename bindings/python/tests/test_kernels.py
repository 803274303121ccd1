"""Kernels other than s^β."""

import numpy as np
import pytest

import fvi

KERNELS = [
    fvi.Kernel.tempered(order=0.5, rate=0.3),
    fvi.Kernel.maxwell(order=0.6, time=1.5),
    fvi.Kernel.maxwell(order=0.9, time=0.5, inner=0.4),
    fvi.Kernel.prony([1.0, 0.7], [1.0, 0.1]),
    fvi.Kernel.havriliak_negami(order=0.7, power=0.5, time=1.0),
    fvi.Kernel.distributed(0.2, 0.9, time=0.5),
    fvi.Kernel.symbol("s^0.6/(1 + s^0.6)"),
    fvi.Kernel.symbol("0.4 + s^0.6/(1 + s^0.6)"),
]


def decay(kernel, **keys):
    return fvi.integrate(
        mass=[1.0],
        potential="0.5*q0^2",
        damping=fvi.Damping(kernel=kernel, coefficient=[1.5], derivative="riemann-liouville"),
        position=[1.0],
        step=0.05,
        steps=100,
        **keys,
    )


@pytest.mark.parametrize("kernel", KERNELS, ids=repr)
def test_every_engine_gives_the_motion_of_the_plain_sum(kernel):
    direct = decay(kernel, engine="direct")
    assert abs(direct.q[-1, 0]) < 1.0
    engines = ["block-fft", "real-time", "exponential-sum", "exponential-sum-core"]
    if "distributed" in repr(kernel):
        # Its best table is within 7.9e-15, where 4e-15 is the default: refused.
        engines = engines[:2]
    for engine in engines:
        np.testing.assert_allclose(decay(kernel, engine=engine).q, direct.q, rtol=0, atol=1e-13)


@pytest.mark.parametrize("kernel", KERNELS, ids=repr)
def test_memories_and_derivatives_sum_the_weights(kernel):
    weights = fvi.weights(kernel=kernel, step=0.1, order=2, count=50)
    samples = np.cos(0.3 * np.arange(50))
    expected = np.convolve(weights, samples)[:50]
    by_derivative = fvi.derivative(samples, kernel, 0.1, quadrature="bdf2", start="riemann-liouville")
    np.testing.assert_allclose(by_derivative, expected, rtol=0, atol=1e-13 * weights[0])
    memory = fvi.Memory(kernel=kernel, step=0.1, order=2, length=50)
    for sample, value in zip(samples, expected, strict=True):
        found = memory.leading * sample + memory.next_term()[0]
        assert abs(found - value) < 1e-13 * weights[0]
        memory.push([sample])


def test_what_a_kernel_is_at_zero_is_in_its_first_weight():
    plain, stiff = (fvi.weights(kernel=fvi.Kernel.symbol(text), step=0.1, count=20) for text in ("s^0.5", "0.3 + s^0.5"))
    np.testing.assert_allclose(stiff - plain, [0.3] + [0.0] * 19, rtol=0, atol=1e-14)
    # A constant signal, long after its beginning.
    derived = fvi.derivative(np.ones(2000), fvi.Kernel.symbol("0.3 + s/(1 + s)"), 0.1, start="riemann-liouville")
    assert abs(derived[-1] - 0.3) < 1e-13


def test_one_maxwell_element_has_rational_weights():
    # K(1 − z) = (1 − z)/(2 − z)
    weights = fvi.weights(kernel=fvi.Kernel.prony([1.0], [1.0]), step=1.0, count=6)
    np.testing.assert_allclose(weights, [0.5] + [-(0.5 ** (n + 1)) for n in range(1, 6)], rtol=1e-15)


def test_a_power_is_the_exponent():
    by_kernel = fvi.weights(kernel=fvi.Kernel.power(0.5), step=0.1, count=20)
    np.testing.assert_array_equal(by_kernel, fvi.weights(exponent=0.5, step=0.1, count=20))


@pytest.mark.parametrize(
    ("kernel", "words"),
    [
        (fvi.Kernel.maxwell(order=1.5, time=1.0), "greater than 0 and at most 1"),
        (fvi.Kernel.prony([1.0, -0.5], [1.0, 0.1]), "passive"),
        (fvi.Kernel.symbol("sin(s)"), "not sin"),
        ({"form": "maxwel"}, "maxwell"),
    ],
)
def test_kernels_that_cannot_be_used_are_refused(kernel, words):
    with pytest.raises(fvi.InputError, match=words) as caught:
        decay(kernel)
    assert caught.value.key.startswith("damping[0].kernel")


def test_an_active_kernel_is_taken_where_it_is_wanted():
    term = fvi.Damping(kernel=fvi.Kernel.prony([1.0, -0.5], [1.0, 0.1]), coefficient=[0.1], allow_active=True)
    result = fvi.integrate(mass=[1.0], potential="0.5*q0^2", damping=term, position=[1.0], step=0.05, steps=20)
    assert np.isfinite(result.q).all()


def test_exponent_and_kernel_are_one_of_two():
    with pytest.raises(fvi.InputError, match="one of them"):
        fvi.weights(step=0.1, count=3)
    with pytest.raises(fvi.InputError, match="cannot stand beside"):
        fvi.weights(exponent=0.5, kernel=fvi.Kernel.power(0.5), step=0.1, count=3)
    with pytest.raises(fvi.InputError, match="fvi.Kernel"):
        fvi.weights(kernel="maxwell", step=0.1, count=3)


def test_weights_are_a_kernel(tmp_path):
    form = fvi.Kernel.tempered(order=0.7, rate=2.5)
    weights = fvi.weights(kernel=form, step=0.05, order=2, count=101)
    expected = decay(form).q
    given = fvi.Kernel.weights(weights, step=0.05)
    np.testing.assert_allclose(decay(given).q, expected, rtol=0, atol=1e-12)
    file = tmp_path / "w.csv"
    file.write_text("n,weight\n" + "".join(f"{n},{weight!r}\n" for n, weight in enumerate(weights.tolist())))
    np.testing.assert_array_equal(decay(fvi.Kernel.weights(file)).q, decay(given).q)
    np.testing.assert_array_equal(fvi.weights(kernel=given, step=0.05, count=101), weights)
    samples = np.sin(np.arange(80.0))
    derived = fvi.derivative(samples, given, 0.05, start="riemann-liouville")
    np.testing.assert_allclose(derived, np.convolve(weights, samples)[:80], rtol=0, atol=1e-12 * weights[0])
    for make, message in [
        (lambda: decay(fvi.Kernel.weights(weights[:100])), "100 weights where a run of 100 steps needs 101"),
        (lambda: decay(fvi.Kernel.weights(weights, step=0.1)), "time.step"),
        (lambda: decay(given, engine="exponential-sum"), "weights do not tell the kernel"),
        (lambda: decay(fvi.Kernel.weights(-weights)), "passive"),
        (lambda: fvi.weights(kernel=given, step=0.05, count=102), "number of weights"),
        (lambda: fvi.weights(kernel=given, step=0.1, count=10), "step of the weights"),
        (lambda: fvi.Kernel.weights([]), "weights"),
    ]:
        with pytest.raises(fvi.InputError, match=message):
            make()


def test_energies_of_memories_balance(tmp_path):
    kernel = fvi.Kernel.maxwell(order=0.55, time=0.8)
    result = decay(kernel, memory_energy=True)
    total = result.energy + result.memory_stored + result.memory_dissipated
    np.testing.assert_allclose(total, total[0], rtol=1e-12)
    assert result.memory_stored[0] > result.energy[0] and (np.diff(result.memory_dissipated) >= 0).all()
    assert decay(kernel).memory_stored is None
    result.save(tmp_path / "r.npz")
    np.testing.assert_array_equal(fvi.load(tmp_path / "r.npz").memory_dissipated, result.memory_dissipated)
    with pytest.raises(fvi.InputError, match="a scheme without an exact balance of energies"):
        decay(kernel, memory_energy=True, scheme="galerkin", degree=2)


def waves(kernels, **keys):
    return fvi.integrate(
        mass=[1.0, 2.0],
        stiffness=[[5.0, -1.0], [-1.0, 3.0]],
        damping=[fvi.Damping(kernel=kernel, coefficient=rho) for kernel, rho in kernels],
        position=[1.0, -0.5],
        step=0.02,
        steps=300,
        **keys,
    )


def test_a_matrix_of_relaxation_functions_is_the_sum_of_its_entries(tmp_path):
    times = np.linspace(0.0, 8.0, 801)
    couplings = [(np.array([1.0, 0.5]), 1.0), (np.array([-0.3, 0.8]), 0.2)]

    def entry(i, j):
        moduli = sum(a[i] * a[j] * np.exp(-times / tau) for a, tau in couplings)
        path = tmp_path / f"G{min(i, j)}{max(i, j)}.csv"
        np.savetxt(path, np.column_stack([times, moduli]), delimiter=",", header="t,G", comments="", fmt="%.17g")
        return path

    files = [[entry(i, j) for j in range(2)] for i in range(2)]
    found = waves([(fvi.Kernel.relaxation_matrix(files, decay=1.0), None)])
    known = waves([(fvi.Kernel.prony([1.0], [tau]), np.outer(a, a)) for a, tau in couplings])
    assert np.abs(found.q - known.q).max() < 1e-4  # linear between rows
    alone = waves([(fvi.Kernel.relaxation_matrix([[files[0][0], ""], ["", files[1][1]]], decay=1.0), None)])
    assert np.abs(alone.q - known.q).max() > 1e-2
    for wrong in ("G.csv", [["G.csv"], ["G.csv"]], [[1.0]]):
        with pytest.raises(fvi.InputError, match="files"):
            fvi.Kernel.relaxation_matrix(wrong)


def test_steps_of_any_length_take_kernels_that_relax():
    def end(kernel, **keys):
        return fvi.integrate(
            mass=[1.0],
            potential="0.5*q0^2",
            damping=fvi.Damping(kernel=kernel, coefficient=[1.0]),
            position=[1.0],
            scheme="collocation",
            **keys,
        ).q[-1, 0]

    zener = fvi.Kernel.maxwell(order=0.6, time=1.0)
    graded = end(zener, grid="graded", exponent=3.0, end=3.0, steps=60)
    assert abs(graded - end(zener, step=1e-3, steps=3000)) < 1e-8
    with pytest.raises(fvi.InputError, match="steps of any length"):
        end(fvi.Kernel.symbol("0.5*s*(s + 0.1)/((s + 0.1)^2 + 4)"), grid="graded", exponent=3.0, end=3.0, steps=60)


def test_curves_of_states_are_their_transfer_function():
    a, b, c = np.array([[-0.6, 0.9], [-0.9, -0.6]]), np.array([[1.0], [0.0]]), np.array([[1.0, -0.6 / 0.9]])
    omega = np.array([1.0, 2.0])
    known = [(1j * w * c @ np.linalg.inv(1j * w * np.eye(2) - a) @ b)[0, 0] for w in omega]
    assert np.allclose(fvi.Kernel.states(a, b, c).curves(omega).moduli, known, rtol=1e-12)
    with pytest.raises(fvi.InputError, match="a matrix of 2 rows"):
        fvi.Kernel.states(a, np.eye(2), np.eye(2)).curves(omega)
    with pytest.raises(fvi.InputError, match="omega"):
        fvi.Kernel.power(0.5).curves([])
