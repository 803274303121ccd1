"""Fits of rheology beside SciPy's `least_squares` and `nnls` on formulas written here."""

import numpy as np
import pandas
import pytest
from scipy.optimize import least_squares, nnls

import fvi

SAME = 1e-8
OMEGA, TIMES = np.logspace(-2, 2, 41), np.logspace(-2, 2, 41)


def solid(kernel, coefficient=5.0, e=2.0):
    """A spring e beside a damping term."""
    damping = {"coefficient": [coefficient], **kernel}
    return {
        "system": {"mass": [1.0], "potential": "0.5*e*q0^2", "parameters": {"e": e}, "damping": [damping]},
        "time": {"step": 0.1, "steps": 10},
    }


def prony(*times):
    return solid({"kernel": {"form": "prony", "strengths": [1.0] * len(times), "times": list(times)}})


E, RHO, KERNEL = "system.parameters.e", "system.damping[0].coefficient[0]", "system.damping[0].kernel"
ORDER = "system.damping[0].order"


def modulus(what, kernel):
    """A function of the parameters and the frequency from K(s) for all parameters but the first two, e and ρ."""
    part = {"storage": np.real, "loss": np.imag, "magnitude": np.abs, "tan_delta": lambda g: g.imag / g.real}
    return lambda p, omega: [part[name](p[0] + p[1] * kernel(1j * omega, *p[2:])) for name in what]


def zener(s, time):
    return s * time / (1 + s * time)


def fractional(s, order, time):
    return (s * time) ** order / (1 + (s * time) ** order)


def havriliak(s, order, power, time):
    return 1 - (1 + (s * time) ** order) ** -power


def relaxation(p, t):
    return [p[0] + p[1] * np.exp(-t / p[2])]


def creep(p, t):
    """1/(e + ρ τ s/(1 + τ s)) under a unit step."""
    e, rho, tau = p
    return [1 / e - rho / (e * (e + rho)) * np.exp(-t * e / (tau * (e + rho)))]


def voigt_creep(p, t):
    return [(1 - np.exp(-t * p[0] / p[1])) / p[0]]


BOTH = ("storage", "loss")
TAU = f"{KERNEL}.times[0]"
MAXWELL = {"kernel": {"form": "maxwell", "order": 0.5, "time": 1.0}}
HAVRILIAK = {"kernel": {"form": "havriliak-negami", "order": 0.6, "power": 0.6, "time": 1.0}}
# Name: scenario, paths, truth, columns, model, places.
CASES = {
    "standard solid": (prony(1.0), (E, RHO, TAU), (2, 5, 0.3), BOTH, modulus(BOTH, zener), OMEGA),
    "standard solid, storage": (prony(1.0), (E, RHO, TAU), (2, 5, 0.3), BOTH[:1], modulus(BOTH[:1], zener), OMEGA),
    "standard solid, |G|": (prony(1.0), (E, RHO, TAU), (1, 9, 2), ("magnitude",), modulus(("magnitude",), zener), OMEGA),
    "standard solid, G' and tan": (
        prony(1.0), (E, RHO, TAU), (2, 5, 0.3), ("storage", "tan_delta"), modulus(("storage", "tan_delta"), zener), OMEGA,
    ),
    "relaxation": (prony(1.0), (E, RHO, TAU), (2, 5, 0.3), ("relaxation",), relaxation, TIMES),
    "creep": (prony(1.0), (E, RHO, TAU), (2, 5, 0.3), ("creep",), creep, TIMES),
    "Kelvin-Voigt": (
        solid({"order": 1.0}), (E, RHO), (2, 0.7), BOTH, lambda p, w: [p[0] + 0 * w, p[1] * w], OMEGA,
    ),
    "Kelvin-Voigt, creep": (solid({"order": 1.0}), (E, RHO), (2, 0.7), ("creep",), voigt_creep, TIMES),
    "spring-pot": (
        solid({"order": 0.5}), (E, RHO, ORDER), (2, 3, 0.35), BOTH, modulus(BOTH, lambda s, order: s**order), OMEGA,
    ),
    "spring-pot, loss and |G|": (
        solid({"order": 0.5}), (E, RHO, ORDER), (2, 3, 0.6), ("loss", "magnitude"),
        modulus(("loss", "magnitude"), lambda s, order: s**order), OMEGA,
    ),
    "fractional Zener": (
        solid(MAXWELL), (E, RHO, f"{KERNEL}.order", f"{KERNEL}.time"), (2, 5, 0.6, 0.3), BOTH, modulus(BOTH, fractional), OMEGA,
    ),
    "Havriliak-Negami": (
        solid(HAVRILIAK), (E, RHO, f"{KERNEL}.order", f"{KERNEL}.power", f"{KERNEL}.time"), (2, 5, 0.7, 0.5, 0.8), BOTH,
        modulus(BOTH, havriliak), OMEGA,
    ),
}


def noisy(random, model, truth, places, size=0.02):
    """Data with deviations of 2 % of each."""
    return [values * (1 + size * random.standard_normal(len(values))) for values in model(truth, places)]


def scipy_fit(model, start, data, places, deviations):
    def left(p):
        return np.concatenate([(told - datum) / sigma for told, datum, sigma in zip(model(p, places), data, deviations)])

    found = least_squares(left, start, jac="3-point", x_scale=np.abs(start), xtol=1e-15, ftol=None, gtol=1e-15, max_nfev=500)
    return found.x, np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))


@pytest.mark.parametrize("name", CASES)
def test_least_squares_says_the_same(name):
    scenario, paths, truth, columns, model, places = CASES[name]
    data = noisy(np.random.default_rng(len(name)), model, truth, places)
    # Deviations known beforehand, not from the noisy data, as in SciPy's.
    deviations = [0.02 * values for values in model(truth, places)]
    over = "t" if places is TIMES and columns[0] in ("relaxation", "creep") else "omega"
    start = np.array(truth) * 1.2 ** np.where(np.arange(len(truth)) % 2, 1, -1)
    table = {over: places, **dict(zip(columns, data)), "deviation": dict(zip(columns, deviations))}
    if columns == ("magnitude",):
        table["quantity"] = "modulus"
    found = fvi.fit(scenario, dict(zip(paths, start.tolist())), table)
    estimates, errors = scipy_fit(model, start, data, places, deviations)
    assert found.converged
    np.testing.assert_allclose([found.estimates[path] for path in paths], estimates, rtol=SAME)
    np.testing.assert_allclose([found.standard_errors[path] for path in paths], errors, rtol=1e-5)


@pytest.mark.parametrize("terms", [2, 4, 6, 8])
@pytest.mark.parametrize("what", ["moduli", "relaxation"])
def test_nnls_says_the_same(what, terms):
    random, times = np.random.default_rng(terms), np.logspace(-2, 2, terms)
    strengths = random.uniform(1, 5, terms) * (random.uniform(size=terms) > 0.3)
    if what == "moduli":
        units = [np.stack([1 + 0 * OMEGA, *(zener(1j * OMEGA, tau).real for tau in times)], 1),
                 np.stack([0 * OMEGA, *(zener(1j * OMEGA, tau).imag for tau in times)], 1)]
    else:
        units = [np.stack([1 + 0 * TIMES, *(np.exp(-TIMES / tau) for tau in times)], 1)]
    truth = np.array([2.0, *strengths])
    exact = [unit @ truth for unit in units]
    data = [values * (1 + 0.02 * random.standard_normal(len(values))) for values in exact]
    deviations = [0.02 * values for values in exact]
    columns = BOTH if what == "moduli" else ("relaxation",)
    table = {"omega" if what == "moduli" else "t": OMEGA, **dict(zip(columns, data)), "deviation": dict(zip(columns, deviations))}
    free = {E: {"bounds": (0, 1e6)}, KERNEL: {"terms": terms}}
    found = fvi.fit(solid({"kernel": prony(1.0)["system"]["damping"][0]["kernel"]}, 1.0), free, table)
    matrix = np.concatenate([unit / sigma[:, None] for unit, sigma in zip(units, deviations)])
    right = np.concatenate([values / sigma for values, sigma in zip(data, deviations)])
    best, _ = nnls(matrix, right)
    np.testing.assert_allclose(list(found.estimates.values()), best, rtol=SAME, atol=SAME * best.max())
    assert fvi.fit(found.scenario, [E], table).converged


LAWS = {
    "wlf": ({"law": "wlf", "c1": 5.0, "c2": 80.0}, ("shift.c1", "shift.c2"), lambda t, p: -p[0] * (t - 20) / (p[1] + t - 20), (8, 120)),
    "arrhenius": (
        {"law": "arrhenius", "energy": 5e4}, ("shift.energy",),
        lambda t, p: p[0] / 8.31446261815324 * (1 / (t + 273.15) - 1 / 293.15) / np.log(10), (9e4,),
    ),
    "free": (
        {"law": "free"}, ("shift.log10[0]", "shift.log10[2]", "shift.log10[3]"),
        lambda t, p: {0: p[0], 20: 0.0, 35: p[1], 60: p[2]}[t], (1.6, -0.9, -2.0),
    ),
}


@pytest.mark.parametrize("name", LAWS)
def test_master_curves_are_those_of_scipy(name):
    law, paths, log10, truth = LAWS[name]
    temperatures, omega = (0, 20, 35, 60), np.logspace(-1, 1, 21)
    of_solid, random = modulus(BOTH, zener), np.random.default_rng(7)

    def model(p, omega):
        return [part for t in temperatures for part in of_solid(p[:3], omega * 10 ** log10(t, p[3:]))]

    truth = (2, 5, 0.3, *truth)
    data, exact = noisy(random, model, truth, omega), model(truth, omega)
    deviations = [0.02 * values for values in exact]
    tables = [
        {"omega": omega, "storage": data[2 * k], "loss": data[2 * k + 1], "temperature": float(t),
         "deviation": {"storage": deviations[2 * k], "loss": deviations[2 * k + 1]}}
        for k, t in enumerate(temperatures)
    ]
    free = {E: 1.8, RHO: 4.5, TAU: 0.4, **({"shift.log10": None} if name == "free" else {path: None for path in paths})}
    found = fvi.fit(prony(1.0), free, tables, shift={**law, "reference": 20.0})
    start = np.array([1.8, 4.5, 0.4, *np.array(truth[3:]) * 0.9])
    estimates, _ = scipy_fit(model, start, data, omega, deviations)
    np.testing.assert_allclose([found.estimates[path] for path in (E, RHO, TAU, *paths)], estimates, rtol=SAME)
    np.testing.assert_allclose([table.log10_shift for table in found.tables], [log10(t, estimates[3:]) for t in temperatures], rtol=1e-7)
    assert "shift" not in found.scenario
    pytest.importorskip("matplotlib").use("Agg")
    assert found.plot_master_curve()[0].get_xlabel() == "a ω"


def test_intervals_cover_as_often_as_they_say():
    scenario, paths, truth, columns, model, places = CASES["fractional Zener"]
    random, covered, count = np.random.default_rng(1), np.zeros(4), 200
    deviations = [0.02 * values for values in model(truth, places)]
    for _ in range(count):
        data = noisy(random, model, truth, places)
        table = {"omega": places, **dict(zip(columns, data)), "deviation": dict(zip(columns, deviations))}
        found = fvi.fit(scenario, dict(zip(paths, map(float, truth))), table)
        covered += [low <= own <= high for (low, high), own in zip((found.intervals[path] for path in paths), truth)]
    assert (covered >= 0.91 * count).all() and (covered <= 0.99 * count).all(), covered


def test_models_are_compared_in_one_table():
    data = noisy(np.random.default_rng(3), CASES["relaxation"][4], (2, 5, 1.0), TIMES)[0]
    table = {"t": TIMES, "relaxation": data, "relative_deviation": 0.02}
    free = {E: {"bounds": (0, 1e6)}, KERNEL: {"terms": (1, 4), "between": (0.01, 100.0)}}
    found = fvi.fit(prony(1.0), free, table)
    rows = found.comparison
    assert list(rows) == ["1 term", "2 terms", "3 terms", "4 terms"] and found.name in rows
    assert rows[found.name]["aic_difference"] == 0 and min(row["aic_difference"] for row in rows.values()) == 0
    assert sum(row["aic_weight"] for row in rows.values()) == pytest.approx(1)
    pytest.importorskip("matplotlib").use("Agg")
    assert len(found.plot_models()[0].lines) == 4
    with pytest.raises(fvi.InputError, match="one model only"):
        fvi.fit(prony(1.0), [E], table).plot_models()


def test_units_of_a_frame_are_read_as_those_of_a_file():
    """In Hz, behind the name of a column, with that name or without its unit, with and without `columns`."""
    frequencies = OMEGA / (2 * np.pi)
    modulus_there = 2.0 + 5.0 * zener(1j * OMEGA, 0.4)
    parts = {"storage": modulus_there.real, "loss": modulus_there.imag}
    names = {"omega": "Frequency", "storage": "G'", "loss": "G''"}
    named = pandas.DataFrame({"Frequency [Hz]": frequencies, "G' [kPa]": parts["storage"], "G'' [kPa]": parts["loss"]})
    tables = [
        {"frame": named, "columns": names},
        {"frame": named, "columns": {"omega": "Frequency [Hz]", "storage": "G' [kPa]", "loss": "G'' [kPa]"}},
        pandas.DataFrame({"omega / Hz": frequencies, **parts}),
        {"frame": named.rename(columns={"Frequency [Hz]": "f"}), "columns": {**names, "omega": "f"}, "units": {"omega": "Hz"}},
    ]
    for table in tables:
        scenario = solid({"kernel": {"form": "prony", "strengths": [1.0], "times": [1.0]}})
        found = fvi.fit(scenario, {E: 1.0, RHO: 1.0, f"{KERNEL}.times[0]": 1.0}, table)
        for path, truth in ((E, 2.0), (RHO, 5.0 * 0.4 / 0.4), (f"{KERNEL}.times[0]", 0.4)):
            assert found.estimates[path] == pytest.approx(truth, rel=SAME)
    with pytest.raises(fvi.InputError, match="MPa.*kPa|kPa.*MPa"):
        fvi.fit(scenario, {E: 1.0}, {"frame": named.rename(columns={"G'' [kPa]": "G'' [MPa]"}), "columns": names})


def test_messages_about_arrays_name_their_rows():
    scenario = solid({"order": 0.5})
    scenario["initial"] = {"position": [1.0]}
    times = np.linspace(0.1, 1.2, 12)
    with pytest.raises(fvi.InputError, match=r"^data\[0\], row 10: column 1 \(t\): t = 1.09.* is after the motion ends") as caught:
        fvi.fit(scenario, {E: 1.0}, {"t": times, "q0": np.cos(times)})
    assert caught.value.key == "data[0]"
    times, positions = times[:8], np.cos(times[:8])
    positions[3] = np.nan
    found = fvi.fit(scenario, {E: 1.0}, {"t": times, "q0": positions})
    assert "data[0]: 1 of 8 rows is left out, in which a number is missing: row 3" in found.notes
