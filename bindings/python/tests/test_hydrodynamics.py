"""Floating bodies from added mass and radiation damping, and the files of boundary-element codes."""

import numpy as np
import pytest

import fvi

OMEGA = np.arange(0.05, 20.01, 0.05)


def retardation(s):
    """K̂ of a positive real fraction."""
    return s * (s + 1.2) / ((s * s + 1.1 * s + 1.3) * (s + 0.7))


ADDED = 2 + retardation(1j * OMEGA).imag / OMEGA
DAMPING = retardation(1j * OMEGA).real


def decay(kernel, mass=3.0, **more):
    size = np.size(mass)
    return fvi.integrate(
        mass=np.atleast_1d(mass), stiffness=np.full(size, 4.0), damping=[fvi.Damping(kernel=kernel)], position=np.ones(size),
        step=0.01, steps=1000, order=2, **more,
    ).q


def test_a_table_and_its_equations_of_states_move_alike():
    of_table = decay(fvi.Kernel.radiation(OMEGA, ADDED, DAMPING))
    # (s² + 1.2 s)/(s³ + 1.8 s² + 2.07 s + 0.91) in companion form.
    A = [[-1.8, -2.07, -0.91], [1, 0, 0], [0, 1, 0]]
    of_states = decay(fvi.Kernel.states(A, [[1], [0], [0]], [[1, 1.2, 0]], infinite=2.0))
    of_symbol = fvi.integrate(
        mass=[5.0], stiffness=[4.0], position=[1.0], step=0.01, steps=1000, order=2,
        damping=[fvi.Damping(coefficient=[1.0], kernel=fvi.Kernel.symbol("s^2/(s^2 + 1.1*s + 1.3)*((s + 1.2)/(s + 0.7))"))],
    ).q
    assert np.max(np.abs(of_states - of_symbol)) < 1e-11
    assert np.max(np.abs(of_table - of_symbol)) < 1e-3


def test_what_contradicts_is_refused():
    with pytest.raises(fvi.InputError, match="Ogilvie"):
        decay(fvi.Kernel.radiation(OMEGA, ADDED, 2 * DAMPING))
    with pytest.raises(fvi.InputError, match="activity"):
        decay(fvi.Kernel.radiation(OMEGA, ADDED, DAMPING - 0.01))
    with pytest.raises(fvi.InputError, match="stable"):
        decay(fvi.Kernel.states([[0.1]], [[1]], [[1]]))


def test_files_of_capytaine(tmp_path):
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    omega = np.concatenate([OMEGA[::-1], [np.inf]])
    added = np.concatenate([ADDED[::-1], [2.0]])[:, None, None] * np.array([[1, 0.1], [0.1, 1]])
    damping = np.concatenate([DAMPING[::-1], [np.nan]])[:, None, None] * np.array([[1, 0.1], [0.1, 1]])
    dims = ("omega", "radiating_dof", "influenced_dof")
    data = xarray.Dataset(
        {"added_mass": (dims, added), "radiation_damping": (dims, damping)},
        coords={"omega": omega, "radiating_dof": ["Heave", "Pitch"], "influenced_dof": ["Heave", "Pitch"]},
    )
    data.to_netcdf(tmp_path / "buoy.nc", engine="h5netcdf")
    read = fvi.read_capytaine(tmp_path / "buoy.nc")
    assert read.dofs == ["Heave", "Pitch"] and np.array_equal(read.omega, OMEGA)
    assert np.array_equal(read.infinite, 2 * np.array([[1, 0.1], [0.1, 1]]))
    alone = decay(read.kernel(["Heave"]))
    assert np.array_equal(alone, decay(fvi.Kernel.radiation(OMEGA, ADDED, DAMPING, infinite=2.0)))
    assert decay(read.kernel(), [3.0, 3.0]).shape == (1001, 2)
    assert read.left_out == 0 and "2 degrees of freedom" in repr(read)
    with pytest.raises(fvi.InputError, match="Heave"):
        read.kernel(["Surge"])
    with pytest.raises(fvi.InputError, match="none twice"):
        read.kernel(["Heave", 0])
    with pytest.raises(fvi.InputError, match="radiation_damping"):
        fvi.read_capytaine(data.drop_vars("radiation_damping"))


def test_forces_are_rows_and_motions_columns():
    xarray = pytest.importorskip("xarray")
    # Over periods, with the degrees of freedom in another order, and one row that was not solved for.
    period = 2 * np.pi / np.array([2.0, 1.0, 0.5])
    added = np.arange(12.0).reshape(3, 2, 2)
    added[1, 0, 0] = np.nan
    data = xarray.Dataset(
        {
            "added_mass": (("period", "radiating_dof", "influenced_dof"), added),
            "radiation_damping": (("period", "radiating_dof", "influenced_dof"), added + 100),
            "omega": ("period", 2 * np.pi / period, {"units": "rad/s"}),
        },
        coords={"period": period, "radiating_dof": ["Pitch", "Heave"], "influenced_dof": ["Heave", "Pitch"]},
    )
    read = fvi.read_capytaine(data)
    assert np.allclose(read.omega, [0.5, 2.0]) and read.left_out == 1 and read.infinite is None
    # At ω = 0.5 the heave force by a pitch motion is the entry (pitch, heave) of the dataset.
    assert read.added_mass[0, 0, 1] == added[2, 0, 0] and read.damping[1, 1, 0] == added[0, 1, 1] + 100


def dataset(**changes):
    xarray = pytest.importorskip("xarray")
    dims = changes.get("dims", ("omega", "radiating_dof", "influenced_dof"))
    shape = changes.get("shape", (2, 1, 1))
    made = xarray.Dataset(
        {"added_mass": (dims, np.ones(shape)), "radiation_damping": (dims, np.ones(shape))},
        coords={
            "omega": ("omega", changes.get("omega", [1.0, 2.0]), {"units": changes.get("units", "rad/s")}),
            "radiating_dof": [changes.get("radiating", "Heave")],
            "influenced_dof": ["Heave"],
        },
    )
    return made.drop_vars("omega") if changes.get("without") else made


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"units": "Hz"}, "Hz; allowed: rad/s"),
        ({"radiating": "Surge"}, "Surge.*allowed: each of `influenced_dof`"),
        ({"omega": [1.0, -2.0]}, "a frequency is -2.0"),
        ({"without": True}, "no `omega`"),
        ({"dims": ("omega", "radiating_dof", "influenced_dof", "body_name"), "shape": (2, 1, 1, 2)}, "2 entries along `body_name`"),
        ({"dims": ("omega", "radiating_dof", "other"), "shape": (2, 1, 1)}, "no dimension .*influenced_dof"),
    ],
)
def test_other_datasets_are_refused(changes, part):
    with pytest.raises(fvi.InputError, match=part):
        fvi.read_capytaine(dataset(**changes))


def test_files_of_bemio(tmp_path):
    h5py = pytest.importorskip("h5py")
    rho, heave = 1000.0, np.zeros((6, 12, len(OMEGA)))
    with h5py.File(tmp_path / "two.h5", "w") as file:
        file["simulation_parameters/w"], file["simulation_parameters/rho"] = OMEGA[None], rho
        for body in (1, 2):
            added, damping, infinite = heave.copy(), heave.copy(), np.zeros((6, 12))
            place = (2, 6 * (body - 1) + 2)
            added[place], damping[place], infinite[place] = ADDED / rho, DAMPING / OMEGA / rho, 2 / rho
            coefficients = f"body{body}/hydro_coeffs"
            file[f"{coefficients}/added_mass/all"], file[f"{coefficients}/radiation_damping/all"] = added, damping
            file[f"{coefficients}/added_mass/inf_freq"] = infinite
    read = fvi.read_bemio(tmp_path / "two.h5")
    assert len(read.dofs) == 12 and read.dofs[8] == "body2 heave" and read.added_mass.shape == (len(OMEGA), 12, 12)
    second = decay(read.kernel(["body2 heave"]))
    assert np.max(np.abs(second - decay(fvi.Kernel.radiation(OMEGA, ADDED, DAMPING, infinite=2.0)))) < 1e-11
    only = fvi.read_bemio(tmp_path / "two.h5", bodies=[2])
    assert only.dofs[2] == "body2 heave" and np.allclose(only.damping[:, 2, 2], DAMPING)
    with pytest.raises(fvi.InputError, match="1 to 2"):
        fvi.read_bemio(tmp_path / "two.h5", bodies=[3])


def write_bemio(path, **changes):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        # As MATLAB writes them: columns of one row, and a file for infinite depth.
        file["simulation_parameters/scaled"] = [[changes.get("scaled", 0.0)]]
        file["simulation_parameters/rho"] = [[changes.get("rho", 1025.0)]]
        file["simulation_parameters/w"] = np.array([[1.0], [2.0]])
        if "without" not in changes:
            file["body1/hydro_coeffs/added_mass/all"] = np.ones((6, changes.get("columns", 6), 2))
        file["body1/hydro_coeffs/radiation_damping/all"] = np.ones((6, 6, 2))


def test_a_file_of_bemio_is_read_in_si_units(tmp_path):
    write_bemio(tmp_path / "one.h5")
    read = fvi.read_bemio(tmp_path / "one.h5")
    # A = ρ Ā and B = ρ ω B̄.
    assert (read.added_mass == 1025).all() and (read.damping[0] == 1025).all() and (read.damping[1] == 2050).all()
    assert read.infinite is None


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"scaled": 1.0}, "scaled` is not 0"),
        ({"rho": 0.0}, "one positive number"),
        ({"columns": 8}, "shape .6, 8, 2."),
        ({"without": "added_mass"}, "body1/hydro_coeffs/added_mass/all"),
    ],
)
def test_other_files_of_bemio_are_refused(tmp_path, changes, part):
    write_bemio(tmp_path / "other.h5", **changes)
    with pytest.raises(fvi.InputError, match=part):
        fvi.read_bemio(tmp_path / "other.h5")


def test_what_is_no_such_file_is_refused(tmp_path):
    pytest.importorskip("h5py")
    pytest.importorskip("h5netcdf")
    (tmp_path / "text").write_text("A, B")
    with pytest.raises(fvi.InputError, match="HDF5"):
        fvi.read_bemio(tmp_path / "text")
    with pytest.raises(fvi.InputError, match="NetCDF"):
        fvi.read_capytaine(tmp_path / "text")
    with pytest.raises(FileNotFoundError):
        fvi.read_bemio(tmp_path / "missing.h5")


def test_a_misspelt_array_of_a_state_space_is_refused(tmp_path):
    file = tmp_path / "states.npz"
    scenario = {
        "system": {"mass": [1.0], "stiffness": [1.0], "damping": [{"kernel": {"states": str(file)}}]},
        "initial": {"position": [1.0]},
        "time": {"step": 0.01, "steps": 10},
    }
    np.savez(file, A=[[-1.0]], B=[[1.0]], C=[[1.0]], D=[[0.5]])
    assert fvi.run(scenario).success
    for other in ("Dd", "infinite"):
        np.savez(file, A=[[-1.0]], B=[[1.0]], C=[[1.0]], **{other: [[0.5]]})
        with pytest.raises(fvi.InputError, match=f"`{other}` is none of them"):
            fvi.run(scenario)
