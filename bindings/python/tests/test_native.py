"""Potentials and forces that are functions of C."""

import ctypes
import math
import threading

import numba
import numpy as np
import pytest

import fvi

NUMBERS = ctypes.POINTER(ctypes.c_double)
OF_POSITION = ctypes.CFUNCTYPE(None, NUMBERS, NUMBERS)
OF_TIME = ctypes.CFUNCTYPE(None, ctypes.c_double, NUMBERS, NUMBERS)
IN_MOTION = ctypes.CFUNCTYPE(None, ctypes.c_double, NUMBERS, NUMBERS, NUMBERS)


@ctypes.CFUNCTYPE(ctypes.c_double, NUMBERS)
def value(q):
    return q[0] ** 4 / 4 + (q[1] - q[0]) ** 2


@OF_POSITION
def gradient(q, out):
    out[0] = q[0] ** 3 - 2 * (q[1] - q[0])
    out[1] = 2 * (q[1] - q[0])


@OF_POSITION
def hessian(q, out):
    for place, number in enumerate((3 * q[0] ** 2 + 2, -2.0, -2.0, 2.0)):
        out[place] = number


@OF_TIME
def force(t, q, out):
    out[1] = math.sin(3 * t) - 0.2 * q[1] ** 3


@IN_MOTION
def drag(t, q, v, out):
    out[0] = -0.3 * v[0] ** 3
    out[1] = math.sin(3 * t)


GIVEN = dict(mass=[1.0, 2.0], damping=fvi.Damping(0.5, [0.1, 0.3]), position=[1.0, 0.2], step=0.05, steps=80)
WORDS = "0.25*q0^4 + (q1 - q0)^2"


@pytest.mark.parametrize(
    ("of_c", "in_words"),
    [
        (force, ["0", "sin(3*t) - 0.2*q1^3"]),
        (drag, ["-0.3*v0^3", "sin(3*t)"]),
        (fvi.Force(drag, velocity_jacobian=None), ["-0.3*v0^3", "sin(3*t)"]),
    ],
)
def test_functions_of_c_move_a_system_as_words_do(of_c, in_words):
    found = fvi.integrate(potential=fvi.Potential(value, gradient, hessian), force=of_c, **GIVEN)
    expected = fvi.integrate(potential=WORDS, force=in_words, **GIVEN)
    assert np.abs(found.q - expected.q).max() < 1e-13
    assert np.abs(found.energy - expected.energy).max() < 1e-12


def test_what_is_not_the_function_that_is_needed_is_refused():
    undeclared = ctypes.CDLL(None).cos
    with pytest.raises(fvi.InputError, match=r"potential.value: the function of C has no `argtypes`.*double U"):
        fvi.integrate(potential=fvi.Potential(undeclared, gradient), **GIVEN)
    with pytest.raises(fvi.InputError, match=r"potential.gradient: .* something else; allowed: void gradient"):
        fvi.integrate(potential=fvi.Potential(value, value), **GIVEN)
    with pytest.raises(fvi.InputError, match="force: .* something else; allowed: void F"):
        fvi.integrate(force=hessian, **GIVEN)
    with pytest.raises(fvi.InputError, match="force.jacobian: a function with the arguments of the force"):
        fvi.integrate(force=fvi.Force(force, drag), **GIVEN)
    with pytest.raises(fvi.InputError, match="potential.gradient: entry 0 is .* differences of potential.value"):
        fvi.integrate(potential=fvi.Potential(value, hessian), **GIVEN)


def test_a_batch_of_functions_of_c_has_the_bits_of_single_runs_and_uses_threads():
    """The functions know the threads that call them: several, though no Python holds them together."""
    threads = set()

    @OF_POSITION
    def watched(q, out):
        threads.add(threading.get_ident())
        gradient(q, out)

    model = fvi.Model(potential=fvi.Potential(value, watched, hessian), **GIVEN)
    starts = np.linspace(0.5, 1.5, 200)
    runs = model.batch({"q0": starts}, jobs=2)
    assert len(threads) > 1
    for index in (0, 77, 199):
        alone = model.integrate(position=[starts[index], 0.2])
        assert (runs[index].q == alone.q).all()
        assert (runs[index].energy == alone.energy).all()


def test_functions_of_c_can_be_mixed_with_those_of_python():
    found = fvi.integrate(potential=fvi.Potential(value, lambda q: [q[0] ** 3 - 2 * (q[1] - q[0]), 2 * (q[1] - q[0])]), **GIVEN)
    expected = fvi.integrate(potential=WORDS, **GIVEN)
    assert np.abs(found.q - expected.q).max() < 1e-13


def test_what_numba_compiles_is_taken():
    pointer = numba.types.CPointer(numba.types.float64)

    @numba.cfunc(numba.types.float64(pointer))
    def energy(q):
        return q[0] ** 4 / 4 + (q[1] - q[0]) ** 2

    @numba.cfunc(numba.types.void(pointer, pointer))
    def slope(q, out):
        out[0] = q[0] ** 3 - 2 * (q[1] - q[0])
        out[1] = 2 * (q[1] - q[0])

    found = fvi.integrate(potential=fvi.Potential(energy, slope, hessian), **GIVEN)
    expected = fvi.integrate(potential=WORDS, **GIVEN)
    assert np.abs(found.q - expected.q).max() < 1e-13
