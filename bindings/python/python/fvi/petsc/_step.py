"""Steps of the midpoint rule, damped at its node, of a linear system whose matrices are distributed."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from petsc4py import PETSc

from fvi._errors import InputError, StepError
from fvi.petsc._arguments import Layout
from fvi.petsc._damping import Damping
from fvi.petsc._together import Together

MOST_CORRECTIONS = 3
"""So many times a solution is corrected by its residual before the step fails."""

SHARE_OF_SOLVER = 0.01
"""The part of the tolerance at which the solver stops by itself; errors of many steps add up, and rounding adds to its residual."""


class Stepper:
    """The equations of a step,

        A e = p_k − h/2 (K q_k + Σ ρ (w₀ s_k + r_k)) + J₀ ,      A = M/h + h/4 (K + Σ w₀ ρ) ,
        q_{k+1} = q_k + e ,      p_{k+1} = p_k − h (K X_k + Σ ρ D X_k) + J₀ + J₁ ,      X_k = q_k + e/2 ,

    with J₀ and J₁ the impulses of the loads on the momenta at both ends of the step (h F/2 each, where F is smooth).
    Source: book/src/theory/node-form.md.
    """

    def __init__(
        self,
        together: Together,
        layout: Layout,
        mass: Any,
        stiffness: Any,
        damping: list[Damping],
        step: float,
        tolerance: float,
        ksp: Any,
        near_null_space: Any,
    ) -> None:
        self.together, self.layout, self.tolerance, self.step = together, layout, tolerance, step
        self.mass, self.stiffness, self.damping = mass, stiffness, damping
        self.matrix = _matrix_of_step(mass, stiffness, damping, step)
        near_null_space = near_null_space or stiffness.getNearNullSpace()
        if near_null_space and near_null_space.handle:
            self.matrix.setNearNullSpace(near_null_space)
        self.solver = ksp or _solver(self.matrix, "fvi_", tolerance, PETSc.PC.Type.GAMG)
        if ksp is not None:
            ksp.setOperators(self.matrix)
        self.solver.setInitialGuessNonzero(False)
        self.setup_seconds = -time.perf_counter()
        self.solver.setUp()
        self.setup_seconds += time.perf_counter()
        self.mass_solver = None if isinstance(mass, PETSc.Vec) else _solver(mass, "fvi_mass_", tolerance, PETSc.PC.Type.JACOBI)
        make = self.matrix.createVecRight
        self.position, self.momentum, self.increment = make(), make(), make()
        self.right_hand_side, self.force, self.residual, self.scratch, self.correction = make(), make(), make(), make(), make()
        self.iterations = self.most_iterations = self.corrections = 0
        self.seconds = {"solver": 0.0, "memory": 0.0, "products": 0.0}
        # For -log_view.
        self.memory_event = PETSc.Log.Event("fvi memory")
        self.whole_step = PETSc.Log.Event("fvi step")
        diagonal = make()
        self.matrix.getDiagonal(diagonal)
        if not diagonal.min()[1] > 0.0:
            message = (
                "stiffness: the matrix of the step, M/h + h/4 (K + Σ w₀ ρ), is not positive definite: K pushes; a shorter step is needed"
            )
            raise InputError(message, "stiffness", str(diagonal.min()[1]))
        self.root_diagonal = np.sqrt(diagonal.getArray())
        self.sum_of_diagonal = together.sum(float(np.square(self.root_diagonal).sum()))

    def multiply_mass(self, vector: Any, product: Any) -> None:
        """M v."""
        if self.mass_solver is None:
            product.pointwiseMult(self.mass, vector)
        else:
            self.mass.mult(vector, product)

    def velocity(self, momentum: Any, velocity: Any) -> None:
        """v = M⁻¹ p."""
        if self.mass_solver is None:
            velocity.pointwiseDivide(momentum, self.mass)
            return
        self.mass_solver.solve(momentum, velocity)
        self._check(self.mass_solver, "the mass")

    def energy(self) -> float:
        """½ pᵀM⁻¹p + ½ qᵀKq, plus the energy of the springs of kernels."""
        velocity, product = self.scratch, self.force
        self.velocity(self.momentum, velocity)
        self.multiply_mass(velocity, product)
        # 2 pᵀv − vᵀMv differs from pᵀM⁻¹p by the square of the solver's error only.
        kinetic = float(self.momentum.dot(velocity)) - 0.5 * float(velocity.dot(product))
        self.stiffness.mult(self.position, product)
        energy = kinetic + 0.5 * float(self.position.dot(product))
        springs = [term for term in self.damping if term.term.spring != 0.0]
        return energy + self.together.sum(sum(term.energy(self.position) for term in springs)) if springs else energy

    def begin(self) -> None:
        """Passes the initial state to the damping terms."""
        if any(term.subtracts_velocity for term in self.damping):
            self.velocity(self.momentum, self.scratch)
        for term in self.damping:
            term.begin(self.position, self.scratch)

    def prepare(self, impulses: Any) -> BaseException | None:
        """Computes the right-hand side; `impulses` adds J₀. Returns an error of this rank, if any."""
        begin = time.perf_counter()
        self.stiffness.mult(self.position, self.force)
        error = None
        remembering = time.perf_counter()
        with self.memory_event:
            for term in self.damping:
                error = term.ask() or error
        remembering -= time.perf_counter()
        self.seconds["memory"] -= remembering
        for term in self.damping:
            term.add_known(self.force)
        self.momentum.copy(self.right_hand_side)
        self.right_hand_side.axpy(-0.5 * self.step, self.force)
        impulses(0, self.right_hand_side)
        self.seconds["products"] += time.perf_counter() - begin + remembering
        return error

    def solve(self, impulses: Any, index: int) -> None:
        """Solves for the increment, corrects it if its residual is too large, and completes the step."""
        place = f"step {index} (t = {index * self.step:g})"
        begin = time.perf_counter()
        self.solver.solve(self.right_hand_side, self.increment)
        self.seconds["solver"] += time.perf_counter() - begin
        self._check(self.solver, place)
        iterations = self.solver.getIterationNumber()
        scale = self.right_hand_side.norm()
        allowed = self.tolerance * scale
        found = self._balance(impulses)
        corrections = 0
        # Whatever is not finite is larger than nothing.
        while not found <= allowed and not found <= allowed + self._rounding():
            if corrections == MOST_CORRECTIONS or not np.isfinite(found):
                message = (
                    f"{place} failed: the residual of its equations is {found:.3e} after {corrections} corrections, where "
                    f"solver_tolerance = {self.tolerance:g} allows {allowed:.3e}"
                )
                raise StepError(message)
            begin = time.perf_counter()
            self.solver.solve(self.residual, self.correction)
            self.seconds["solver"] += time.perf_counter() - begin
            self._check(self.solver, place)
            iterations += self.solver.getIterationNumber()
            self.increment.axpy(1.0, self.correction)
            corrections += 1
            found = self._balance(impulses)
        self.iterations += iterations
        self.most_iterations = max(self.most_iterations, iterations)
        self.corrections += corrections
        self.momentum.axpy(-self.step, self.force)
        impulses(0, self.momentum)
        impulses(1, self.momentum)
        self.position.axpy(1.0, self.increment)

    def _balance(self, impulses: Any) -> float:
        """Computes the forces at the midpoint, and the residual of the equations of the step."""
        begin = time.perf_counter()
        self.scratch.waxpy(0.5, self.increment, self.position)
        self.stiffness.mult(self.scratch, self.force)
        for term in self.damping:
            term.add_force(self.increment, self.force)
        self.multiply_mass(self.increment, self.residual)
        self.residual.aypx(-1.0 / self.step, self.momentum)
        self.residual.axpy(-0.5 * self.step, self.force)
        impulses(0, self.residual)
        norm = float(self.residual.norm())
        self.seconds["products"] += time.perf_counter() - begin
        return norm

    def _rounding(self) -> float:
        """Bound on the rounding errors of the residual itself, as on one machine: 32 ε √A_ii max_j √A_jj (|e_j| + |q_j|) in each
        row."""
        e, q = self.increment.getArray(readonly=True), self.position.getArray(readonly=True)
        here = float((self.root_diagonal * (np.abs(e) + np.abs(q))).max(initial=0.0))
        largest = self.together.largest(here if np.isfinite(here) else 0.0)
        return float(32.0 * np.finfo(float).eps * np.sqrt(self.sum_of_diagonal) * largest)

    def push(self) -> None:
        """Pushes the samples of the step to the memories; local to this rank."""
        begin = time.perf_counter()
        with self.memory_event:
            for term in self.damping:
                term.push()
        self.seconds["memory"] += time.perf_counter() - begin

    def _check(self, solver: Any, place: str) -> None:
        reason = solver.getConvergedReason()
        if reason < 0:
            names = {value: name for name, value in vars(PETSc.KSP.ConvergedReason).items() if isinstance(value, int)}
            message = (
                f"{place} failed: the solver {solver.getType()} with {solver.getPC().getType()} ends with {names.get(reason, reason)} "
                f"after {solver.getIterationNumber()} iterations, residual {solver.getResidualNorm():.3e}"
            )
            raise StepError(message)


def _matrix_of_step(mass: Any, stiffness: Any, damping: list[Damping], step: float) -> Any:
    """A = M/h + h/4 (K + Σ w₀ ρ)."""
    matrix = stiffness.duplicate(copy=True)
    matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
    for term in damping:
        term.channels.add_to(matrix, term.leading)
    matrix.scale(0.25 * step)
    if isinstance(mass, PETSc.Vec):
        inertia = mass.copy()
        inertia.scale(1.0 / step)
        matrix.setDiagonal(inertia, PETSc.InsertMode.ADD_VALUES)
        inertia.destroy()
    else:
        matrix.axpy(1.0 / step, mass, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    matrix.assemble()
    matrix.setOption(PETSc.Mat.Option.SPD, True)
    return matrix


def _solver(matrix: Any, prefix: str, tolerance: float, preconditioner: str) -> Any:
    """Conjugate gradients until the residual is a fraction of the tolerance, in the unpreconditioned norm."""
    solver = PETSc.KSP().create(matrix.getComm())
    solver.setOptionsPrefix(prefix)
    solver.setOperators(matrix)
    solver.setType(PETSc.KSP.Type.CG)
    solver.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
    solver.getPC().setType(preconditioner)
    solver.setTolerances(rtol=SHARE_OF_SOLVER * tolerance, atol=0.0, max_it=2000)
    try:
        solver.setFromOptions()
    except PETSc.Error as error:
        # Each line begins with the rank in brackets.
        reason = str(error).splitlines()[-1].partition("] ")[2]
        raise InputError(f"ksp: options with the prefix {prefix}: {reason}", "ksp", reason) from None
    return solver
