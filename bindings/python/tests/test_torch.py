"""Models in programs of PyTorch, where it is installed."""

import numpy as np
import pytest
from test_gradient import MODEL

import fvi

torch = pytest.importorskip("torch")
import fvi.torch  # noqa: E402


def test_torch_differentiates_models():
    model = fvi.Model(**MODEL)
    k = torch.tensor(1.3, dtype=torch.float64, requires_grad=True)
    strengths = torch.tensor([0.8, 0.7], dtype=torch.float64, requires_grad=True)
    q, p = fvi.torch.integrate(model, {"k": k, "damping[1].kernel.strengths": strengths})
    ((q**2).sum() + (p**4).sum()).backward()
    given = {"k": 1.3, "damping[1].kernel.strengths": np.array([0.8, 0.7])}
    run = model.gradient(given, lambda r: (2 * r.q, 4 * r.p**3))
    assert k.grad.shape == () and k.grad.item() == pytest.approx(run["k"], rel=1e-12)
    assert np.allclose(strengths.grad.numpy(), run["damping[1].kernel.strengths"], rtol=1e-12)
    # The motion has the bits of a run.
    assert (q.detach().numpy() == model.run(given).q).all()


def test_the_graph_goes_on_before_and_behind_a_model():
    model = fvi.Model(**MODEL)

    def loss(logarithm):
        q, _ = fvi.torch.integrate(model, {"k": torch.exp(logarithm)})
        return torch.tanh(q[-1, 0])

    logarithm = torch.tensor(0.2, dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(loss(logarithm), logarithm)
    h = 1e-4
    with torch.no_grad():
        pairs = [(loss(logarithm + by * h) - loss(logarithm - by * h)).item() for by in (1, 2)]
    assert slope.item() == pytest.approx((8 * pairs[0] - pairs[1]) / (12 * h), rel=1e-9)


def test_single_precision_and_numbers_without_gradients_are_taken():
    model = fvi.Model(**MODEL)
    k = torch.tensor([1.3], dtype=torch.float32, requires_grad=True)
    q, _ = fvi.torch.integrate(model, {"k": k[0], "damping[1].kernel.strengths": [0.8, 0.7]})
    assert q.dtype == torch.float64
    q.sum().backward()
    assert k.grad.dtype == torch.float32 and torch.isfinite(k.grad).all()
    with pytest.raises(fvi.InputError, match="nothing"):
        fvi.torch.integrate(model, {"nothing": k[0]})


def test_a_kernel_is_learned():
    """Strengths of a Prony series, by L-BFGS from the motion of the true one."""
    truth = fvi.Model(**MODEL).run({"damping[1].kernel.strengths": np.array([0.8, 0.7])}).q
    model, target = fvi.Model(**MODEL), torch.from_numpy(truth.copy())
    logarithms = torch.zeros(2, dtype=torch.float64, requires_grad=True)
    optimizer = torch.optim.LBFGS([logarithms], max_iter=60, line_search_fn="strong_wolfe", tolerance_change=1e-14)

    def loss():
        optimizer.zero_grad()
        q, _ = fvi.torch.integrate(model, {"damping[1].kernel.strengths": torch.exp(logarithms)})
        value = ((q - target) ** 2).mean() * 1e6
        value.backward()
        return value

    optimizer.step(loss)
    assert np.allclose(torch.exp(logarithms).detach().numpy(), [0.8, 0.7], rtol=1e-4)


def test_names_are_told_and_a_single_number_stands_for_a_vector():
    model = fvi.Model(mass=[1.0, 1.0], stiffness=[4.0, 1.0], position=[1.0, 2.0], step=0.05, steps=40)
    for given, said in (({"positon": 1.0}, "did you mean position"), (["k"], "names"), ({"position": [1.0] * 3}, "3 numbers, where 2")):
        with pytest.raises(fvi.InputError, match=said):
            fvi.torch.integrate(model, given)
    with pytest.raises(fvi.InputError, match="model"):
        fvi.torch.integrate({}, {})
    start = torch.tensor(1.5, dtype=torch.float64, requires_grad=True)
    fvi.torch.integrate(model, {"position": start})[0].sum().backward()
    run = model.gradient({"position": [1.5, 1.5]}, lambda r: np.ones_like(r.q))
    assert start.grad.shape == () and start.grad.item() == pytest.approx(run["position"].sum(), rel=1e-12)
