"""Gradients of functions of a trajectory."""

import numpy as np
import pytest

import fvi

MODEL = dict(
    mass=[1.0, 2.0],
    potential="k*q0^2 + (q1 - q0)^4",
    parameters={"k": 1.0},
    damping=[fvi.Damping(0.5, [0.3, 0.1]), fvi.Damping(kernel=fvi.Kernel.prony([1.0, 0.5], [1.0, 0.1]), coefficient=[0.2, 0.2])],
    position=[1.0, 0.2],
    velocity=[0.3, 0.0],
    step=0.1,
    steps=50,
)


def cotangents(shape):
    random = np.random.default_rng(3)
    return random.normal(size=shape), random.normal(size=shape)


def test_gradients_are_sums_of_sensitivities():
    model = fvi.Model(**MODEL)
    names = ["k", "damping[0].order", "damping[0].coefficient[1]", "damping[1].kernel.strengths[1]", "mass[0]", "q1", "v0"]
    paths = [
        "system.parameters.k",
        "system.damping[0].order",
        "system.damping[0].coefficient[1]",
        "system.damping[1].kernel.strengths[1]",
        "system.mass[0]",
        "initial.position[1]",
        "initial.velocity[0]",
    ]
    for keys in ({}, {"every": 7}, {"scheme": "galerkin", "degree": 2}):
        forwards = model.integrate(sensitivities=paths, **keys)
        q, p = cotangents(forwards.q.shape)
        found = fvi.Model(**MODEL, **keys).gradient(names, (q, p))
        assert (found.result.q == forwards.q).all()
        for index, name in enumerate(names):
            terms = q * forwards.dq[:, index] + p * forwards.dp[:, index]
            assert abs(found[name] - terms.sum()) < 1e-10 * np.abs(terms).sum(), (name, keys)


def test_functions_with_exact_matrices_have_the_derivatives_of_words():
    """A potential, a force of the velocity, and its reaction on the other coordinate, in Python and in words."""
    words = dict(potential="1.3*q0^2 + (q1 - q0)^4 + 0.2*q0*q1", force=["sin(t) - 0.3*v0^3*q1", "-0.1*v1*v0"])

    def gradient(q):
        return [2.6 * q[0] - 4 * (q[1] - q[0]) ** 3 + 0.2 * q[1], 4 * (q[1] - q[0]) ** 3 + 0.2 * q[0]]

    def hessian(q):
        stiff = 12 * (q[1] - q[0]) ** 2
        return [[2.6 + stiff, 0.2 - stiff], [0.2 - stiff, stiff]]

    functions = dict(
        potential=fvi.Potential(lambda q: 1.3 * q[0] ** 2 + (q[1] - q[0]) ** 4 + 0.2 * q[0] * q[1], gradient, hessian),
        force=fvi.Force(
            lambda t, q, v: [np.sin(t) - 0.3 * v[0] ** 3 * q[1], -0.1 * v[1] * v[0]],
            jacobian=lambda t, q, v: [[0.0, -0.3 * v[0] ** 3], [0.0, 0.0]],
            velocity_jacobian=lambda t, q, v: [[-0.9 * v[0] ** 2 * q[1], 0.0], [-0.1 * v[1], -0.1 * v[0]]],
        ),
    )
    names = ["damping[0].order", "damping[1].kernel.strengths[1]", "mass[0]", "q1", "v0"]
    paths = ["system.damping[0].order", "system.damping[1].kernel.strengths[1]", "system.mass[0]", "initial.position[1]",
             "initial.velocity[0]"]
    others = {key: MODEL[key] for key in MODEL if key not in ("potential", "parameters")}
    for keys in ({}, {"scheme": "galerkin", "degree": 2}, {"scheme": "collocation", "stages": 2}):
        expected = fvi.integrate(**others, **words, **keys, sensitivities=paths)
        found = fvi.integrate(**others, **functions, **keys, sensitivities=paths)
        for one, other in ((found.dq, expected.dq), (found.dp, expected.dp)):
            assert np.abs(one - other).max() < 1e-10 * np.abs(other).max(), keys
        q, p = cotangents(expected.q.shape)
        gradients = [fvi.Model(**others, **terms, **keys).gradient(names, (q, p)) for terms in (functions, words)]
        for name in names:
            assert gradients[0][name] == pytest.approx(gradients[1][name], rel=1e-9), (name, keys)
        assert np.abs(gradients[0].force - gradients[1].force).max() < 1e-9 * np.abs(gradients[1].force).max()


@pytest.mark.parametrize(
    ("which", "terms"),
    [
        ("potential.hessian", dict(potential=fvi.Potential(lambda q: (q**4).sum(), lambda q: 4 * q**3, lambda q: np.diag(11 * q**2)))),
        ("force.jacobian", dict(force=fvi.Force(lambda t, q: -(q**3), lambda t, q: np.diag(-2 * q**2)))),
        (
            "force.velocity_jacobian",
            dict(force=fvi.Force(lambda t, q, v: -(v**3), lambda t, q, v: np.zeros((2, 2)), lambda t, q, v: np.diag(-v))),
        ),
    ],
)
def test_wrong_matrices_are_refused_where_a_derivative_is_asked_for(which, terms):
    given = dict(mass=[1.0, 2.0], position=[1.0, 0.2], velocity=[0.3, -0.5], step=0.1, steps=10, **terms)
    assert fvi.integrate(**given).t[-1] == pytest.approx(1.0)
    with pytest.raises(fvi.InputError, match=rf"{which}: entry \(0, 0\) is .* where differences of"):
        fvi.integrate(**given, sensitivities=["initial.position[0]"])
    with pytest.raises(fvi.InputError, match=which):
        fvi.Model(**given).record(["q0"])


def test_vectors_and_other_values_are_taken():
    model = fvi.Model(**MODEL)
    given = {"k": 1.3, "position": [0.9, 0.1], "damping[1].kernel.strengths": np.array([0.8, 0.7])}
    found = model.gradient(given, lambda result: result.q)
    assert [np.shape(found[name]) for name in given] == [(), (2,), (2,)]

    def loss(k=1.3, position=(0.9, 0.1), strengths=(0.8, 0.7)):
        damping = [MODEL["damping"][0], fvi.Damping(kernel=fvi.Kernel.prony(strengths, [1.0, 0.1]), coefficient=[0.2, 0.2])]
        return 0.5 * (model.integrate(parameters={"k": k}, position=position, damping=damping).q ** 2).sum()

    h = 1e-5
    assert found["k"] == pytest.approx((loss(k=1.3 + h) - loss(k=1.3 - h)) / (2 * h), rel=1e-7)
    ahead, behind = (loss(strengths=(0.8, 0.7 + change)) for change in (h, -h))
    assert found["damping[1].kernel.strengths"][1] == pytest.approx((ahead - behind) / (2 * h), rel=1e-6)
    assert np.allclose(found["position"], found.position, rtol=1e-12)


def test_a_force_in_each_step_is_differentiated():
    keys = {name: value for name, value in MODEL.items() if name != "steps"} | {"end": 1.0}
    samples = np.random.default_rng(5).normal(size=(10, 2))

    def loss(samples):
        run = fvi.integrate(**keys, overrides={"input.samples": samples.tolist(), "input.period": 0.1})
        return 0.5 * (run.q**2).sum()

    model = fvi.Model(**keys, overrides={"input.samples": samples.tolist(), "input.period": 0.1})
    found = model.gradient([], lambda result: result.q).force
    assert found.shape == (10, 2)
    for place in ((0, 0), (4, 1), (9, 0)):
        change = np.zeros((10, 2))
        change[place] = 1e-5
        difference = (loss(samples + change) - loss(samples - change)) / 2e-5
        assert found[place] == pytest.approx(difference, rel=1e-6)


def test_stretches_that_are_made_again_change_nothing():
    model = fvi.Model(**MODEL)
    whole, short = model.record(["k"]), model.record(["k"], most_bytes=1)
    q, p = cotangents(whole.result.q.shape)
    assert short.gradient(q, p)["k"] == whole.gradient(q, p)["k"]


@pytest.mark.parametrize(
    ("arguments", "parameters", "part"),
    [
        ({}, ["kk"], "kk"),
        ({"precision": "f32"}, ["k"], "precision"),
        ({"potential": fvi.Potential(lambda q: (q**2).sum(), lambda q: 2 * q)}, ["q0"], "functions"),
        ({"scheme": "collocation", "grid": "adaptive", "tolerance": 1e-6, "steps": None, "step": None, "end": 2.0}, ["k"], "equal steps"),
        ({"scheme": "collocation", "grid": "adaptive", "tolerance": 1e-6, "steps": None, "step": None, "end": 2.0}, [], "a gradient"),
        ({"past": ([-0.1, 0.0], [[0.9, 0.2], [1.0, 0.2]])}, ["k"], "past"),
    ],
)
def test_what_has_no_gradient_is_refused(arguments, parameters, part):
    with pytest.raises(fvi.InputError, match=part):
        fvi.Model(**{**MODEL, **arguments}).gradient(parameters, lambda result: result.q)


def test_cotangents_have_the_shape_of_the_result():
    recording = fvi.Model(**MODEL).record(["k"])
    with pytest.raises(fvi.InputError, match=r"q: shape \(3, 2\)"):
        recording.gradient(np.zeros((3, 2)))


def test_an_entry_off_the_diagonal_stands_with_its_mirror_image() -> None:
    def model(entry: float = -1.0) -> fvi.Model:
        stiffness = [[3.0, entry], [entry, 2.0]]
        return fvi.Model(mass=[1.0, 1.0], stiffness=stiffness, position=[1.0, 0.0], step=0.05, steps=60)

    def value(result: fvi.Result) -> float:
        return float((result.q[:, 1] ** 2).sum())

    change = 1e-5
    slope = (value(model(-1.0 + change).integrate()) - value(model(-1.0 - change).integrate())) / (2.0 * change)
    one, other = "stiffness[0][1]", "stiffness[1][0]"

    def by(names: dict[str, float] | list[str]) -> fvi.Gradient:
        return model().gradient(names, lambda r: 2.0 * r.q * [0.0, 1.0])

    assert by([one])[one] == pytest.approx(slope, rel=1e-6)
    # Each of both has half of what they have together.
    both = by({one: -1.0, other: -1.0})
    assert both[one] == both[other] and both[one] + both[other] == pytest.approx(slope, rel=1e-6)
    changed = model(-1.1).integrate().q
    np.testing.assert_array_equal(model().run({one: -1.1}).q, changed)
    runs = model().batch({one: [-1.1, -1.0]})
    np.testing.assert_array_equal(runs[0].q, changed)
    assert list(runs.parameters) == [one]
    np.testing.assert_array_equal(by({one: -1.1}).result.q, changed)


@pytest.mark.parametrize("returned", [None, (None, None)])
def test_a_function_without_a_value_has_no_gradient(returned: object) -> None:
    model = fvi.Model(mass=[1.0], stiffness=[1.0], position=[1.0], step=0.1, steps=5)
    with pytest.raises(fvi.InputError, match="returned None"):
        model.gradient(["mass[0]"], lambda r: returned)
