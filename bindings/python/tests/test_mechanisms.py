"""Lagrangians, constraints and elongations from Python."""

import numpy as np
import pytest

import fvi


def test_a_pendulum_by_its_angle_and_by_its_place_swings_alike() -> None:
    usual = dict(step=0.02, steps=100, scheme="galerkin", degree=3)
    angle = fvi.integrate(
        kinetic="0.5*v0^2", potential="-9.81*cos(q0)", position=[2.0], velocity=[1.0],
        damping=fvi.Damping(order=0.5, coefficient=0.6, along="q0"), **usual,
    )
    place = fvi.integrate(
        mass=[1.0, 1.0], potential="9.81*q1", constraints=["q0^2 + q1^2 - 1"],
        position=[np.sin(2.0), -np.cos(2.0)], velocity=[np.cos(2.0), np.sin(2.0)],
        damping=fvi.Damping(order=0.5, coefficient=0.6, along="atan2(q0, -q1)"), **usual,
    )
    assert np.abs(place.q[:, 0] - np.sin(angle.q[:, 0])).max() < 1e-6
    assert np.abs((place.q**2).sum(axis=1) - 1).max() < 1e-13
    assert place.multipliers is not None and place.multipliers.shape == (101, 1)
    # The rod carries the weight and the centripetal force.
    tension = 9.81 * np.cos(angle.q[:, 0]) + angle.p[:, 0] ** 2
    assert np.abs(2 * place.multipliers[:, 0] - tension).max() < 1e-3
    assert angle.multipliers is None


def test_several_elongations_take_a_matrix() -> None:
    r = fvi.integrate(
        mass=1.0, potential="q0^2 + 2*q1^2", position=[0.5, -0.2], step=0.01, steps=50, memory_energy=True,
        damping=fvi.Damping(order=0.5, coefficient=[[0.7, 0.2], [0.2, 0.5]], along=["q0*q1 + q0", "q1"]),
    )
    total = r.energy + r.memory_stored + r.memory_dissipated
    assert np.abs(total - total[0]).max() < 1e-13


def test_a_start_is_moved_onto_the_constraints_on_request() -> None:
    system = dict(mass=[1.0, 1.0], constraints=["q0^2 + q1^2 - 1"], position=[1.2, 0.9], step=0.1, steps=1)
    with pytest.raises(fvi.InputError, match="initial.project"):
        fvi.integrate(**system)
    r = fvi.integrate(**system, project=True)
    assert abs((r.q[0] ** 2).sum() - 1) < 1e-14


def test_mass_and_kinetic_are_one_or_the_other() -> None:
    with pytest.raises(fvi.InputError, match="kinetic"):
        fvi.integrate(mass=[1.0], kinetic="0.5*v0^2", position=[1.0], step=0.1, steps=1)


def test_velocities_are_those_of_the_momenta_where_the_mass_depends_on_the_position() -> None:
    moved = fvi.integrate(
        kinetic="0.5*(1 + q0^2)*v0^2 + 0.4*q0*v0 + 0.5*m*v1^2", parameters={"m": 2.0}, potential="q0^2 + q1^2",
        position=[1.0, 0.3], velocity=[2.0, -0.5], step=0.02, steps=40, scheme="galerkin", degree=3,
    )
    q, p = moved.q, moved.p
    exact = np.column_stack([(p[:, 0] - 0.4 * q[:, 0]) / (1.0 + q[:, 0] ** 2), p[:, 1] / 2.0])
    assert np.abs(moved.v - exact).max() < 1e-13
    assert np.abs(moved.v[0] - [2.0, -0.5]).max() < 1e-14
    # Slopes of the interpolation between rows.
    assert np.abs((moved(0.4001) - moved(0.3999)) / 2e-4 - moved.v[20]).max() < 1e-6


def test_a_singular_mass_has_the_velocities_that_constraints_allow() -> None:
    pendulum = fvi.integrate(
        kinetic="0.5*(q0*v1 - q1*v0)^2", potential="9.81*q1", constraints=["(q0^2 + q1^2 - 1)/2"],
        position=[1.0, 0.0], velocity=[0.0, 0.7], step=0.02, steps=20,
    )
    q, p = pendulum.q, pendulum.p
    turning = q[:, 0] * p[:, 1] - q[:, 1] * p[:, 0]
    assert np.abs(pendulum.v - turning[:, None] * np.column_stack([-q[:, 1], q[:, 0]])).max() < 1e-12


@pytest.mark.parametrize("mass", [1.0, [1.0, 1.0]])
def test_a_scenario_as_a_dictionary_asks_for_a_projection_with_a_flag(mass: object) -> None:
    scenario = {
        "system": {"mass": mass, "constraints": ["q0^2 + q1^2 - 1"]},
        "initial": {"position": [1.2, 0.9], "project": True},
        "time": {"step": 0.1, "steps": 1},
    }
    assert abs((fvi.run(scenario).q[0] ** 2).sum() - 1) < 1e-14


def test_a_model_has_a_kinetic_energy_in_place_of_a_mass() -> None:
    system = dict(kinetic="0.5*(1 + a*q0^2)*v0^2", potential="q0^2", position=[1.0], velocity=[0.5], step=0.02, steps=50)
    model = fvi.Model(**system, parameters={"a": 0.3})
    expected = fvi.integrate(**system, parameters={"a": 0.5})
    for found in (model.integrate(parameters={"a": 0.5}), model.run({"a": 0.5})):
        assert (found.q == expected.q).all() and (found.p == expected.p).all()
    assert (model.batch({"a": np.array([0.3, 0.5])}).q[1] == expected.q).all()
    with pytest.raises(fvi.InputError, match="kinetic"):
        fvi.Model(potential="q0^2")


def test_a_batch_tells_velocities_that_depend_on_parameters() -> None:
    model = fvi.Model(kinetic="0.5*a*(1 + q0^2)*v0^2", potential="q0^2", parameters={"a": 1.0}, position=[1.0], step=0.02, steps=5)
    runs = model.batch({"a": np.array([1.0, 2.0])})
    assert np.abs(runs[1].v[:, 0] - runs.p[1, :, 0] / (2.0 * (1.0 + runs.q[1, :, 0] ** 2))).max() < 1e-14
