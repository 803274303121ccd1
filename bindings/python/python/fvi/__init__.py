"""Fractional variational integrators with a fast memory.

Mechanical systems with fractional damping,

    d/dt (M q̇) + ∇U(q) = F(t, q) − Σ ρ D^β q ,      0 ≤ β < 2 ,

integrated by variational schemes whose memory of the whole past is exact to rounding and fast.

======================  ==============================================================
`run`                   a scenario from a file or a dictionary
`integrate`             a system given by arrays, expressions and functions
`Model`                 a system that is integrated several times: `Model.run`, and `Model.batch` for
                        many runs on all cores; `Model.gradient` for derivatives by many parameters
`System`                a system made once, for all calls that take one
`run_cases`,            several load cases of a linear system together
`integrate_cases`
`solve_fde`             fractional differential equations D^α x = f(t, x)
`derivative`            fractional derivatives and integrals of samples
`weights`               weights of convolution quadrature
`exponentials`          the same as decaying exponentials, and as a system of first order
`Kernel`                transfer functions in place of s^β
`read_capytaine`, `read_bemio`   added mass and radiation damping from files of boundary-element codes
`Memory`, `Operator`    the engines and the operator D^β, sample by sample
`Convolver`             finite responses on a stream without end, block by block
`FractionalPid`         a fractional PID controller, sample by sample
`load`                  a result that was saved
`sweep`                 one scenario with many values of its keys, here or on a cluster
`converge`              errors and orders of a scenario over step sizes
`compare_engines`       the memory engines compared
`response`              frequency response, poles, moduli, creep and relaxation
`fit`                   numbers of a scenario from data, with their errors
`tune`                  gains and orders of a fractional controller for a plant
`extremal`              two-point fractional Euler–Lagrange problems
`fvi.mechanism`         chains, linkages and rigid bodies in words, and pictures of their motion
`fvi.jax`, `fvi.torch`  models in programs of JAX and PyTorch, which differentiate them; imported separately
`fvi.petsc`             one large run on MPI ranks, with PETSc; imported separately
======================  ==============================================================

The compiled part releases the interpreter lock while it computes; results are bit-identical to those of the program `fvi`.
"""

from fvi._controller import FractionalPid
from fvi._convolver import Convolver
from fvi._equation import Solution, solve_fde
from fvi._errors import InputError, StepError
from fvi._exponentials import Exponentials, StateSpace, exponentials
from fvi._fit import Estimate, Fit, FitTable, fit
from fvi._fvi import __version__
from fvi._gradient import Gradient, Recording
from fvi._hydrodynamics import Hydrodynamics, read_bemio, read_capytaine
from fvi._integrate import integrate, integrate_cases
from fvi._kernel import Kernel
from fvi._memory import Memory, Operator
from fvi._model import Model
from fvi._response import KernelCurves, Mode, Response, response
from fvi._result import Convergence, Extremal, Result, Table, load
from fvi._run import run, run_cases
from fvi._runs import Runs
from fvi._sequences import derivative, weights
from fvi._studies import compare_engines, converge, extremal
from fvi._sweep import sweep
from fvi._system import System
from fvi._terms import Damping, Element, Event, Force, Load, Potential
from fvi._tune import Tuning, tune

__all__ = [
    "Convergence",
    "Convolver",
    "Damping",
    "Element",
    "Estimate",
    "Event",
    "Exponentials",
    "Extremal",
    "Fit",
    "FitTable",
    "Force",
    "FractionalPid",
    "Gradient",
    "Hydrodynamics",
    "InputError",
    "Kernel",
    "KernelCurves",
    "Load",
    "Memory",
    "Mode",
    "Model",
    "Operator",
    "Potential",
    "Recording",
    "Response",
    "Result",
    "Runs",
    "Solution",
    "StateSpace",
    "StepError",
    "System",
    "Table",
    "Tuning",
    "__version__",
    "compare_engines",
    "converge",
    "derivative",
    "exponentials",
    "extremal",
    "fit",
    "integrate",
    "integrate_cases",
    "load",
    "read_bemio",
    "read_capytaine",
    "response",
    "run",
    "run_cases",
    "solve_fde",
    "sweep",
    "tune",
    "weights",
]
