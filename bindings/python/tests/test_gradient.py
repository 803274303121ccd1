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
