"""Sweeps on a local Dask cluster of two processes reached over TCP, with failures provoked."""

import os
import select
import signal
import socket
import threading

import numpy as np
import pytest

import fvi
from test_sweep import OSCILLATOR, table_bytes

distributed = pytest.importorskip("distributed")

SWEEP = {
    "scenario": OSCILLATOR | {"time": {"step": 0.05, "steps": 40_000}},
    "axes": {
        "system.damping[0].order": {"from": 0.1, "to": 1.9, "count": 40},
        "system.parameters.k": [1.0, 4.0, 1e5],
    },
}


class Cable:
    """Forwards traffic to an address until it is cut; then again for new connections."""

    def __init__(self, address):
        self.there = address
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.pairs = []
        threading.Thread(target=self._accept, daemon=True).start()

    @property
    def address(self):
        return "tcp://{}:{}".format(*self.listener.getsockname())

    def _accept(self):
        while True:
            try:
                here, _ = self.listener.accept()
            except OSError:
                return
            pair = here, socket.create_connection(self.there)
            self.pairs.append(pair)
            threading.Thread(target=self._hand_on, args=pair, daemon=True).start()

    @staticmethod
    def _hand_on(here, there):
        others = {here: there, there: here}
        try:
            while True:
                for ready in select.select([here, there], [], [])[0]:
                    content = ready.recv(65536)
                    if not content:
                        raise OSError
                    others[ready].sendall(content)
        except (OSError, ValueError):
            here.close()
            there.close()

    def cut(self):
        for pair in self.pairs:
            for end in pair:
                try:
                    end.shutdown(socket.SHUT_RDWR)
                except OSError:
                    pass
        self.pairs.clear()


@pytest.fixture(scope="module")
def cluster():
    # Loggers report lost connections at length.
    settings = {"distributed.comm.timeouts.connect": "20s", "distributed.admin.tick.limit": "60s"}
    import dask

    with dask.config.set(settings), distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, protocol="tcp", dashboard_address=None, silence_logs=50
    ) as cluster:
        yield cluster


@pytest.fixture(autouse=True)
def tasks_of_one_run(monkeypatch):
    """Many short tasks: so that failures occur in the middle of a sweep, however fast the machine is."""
    monkeypatch.setattr("fvi._cluster.TASK_SECONDS", 0.0)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    directory = tmp_path_factory.mktemp("undisturbed")
    return fvi.sweep(SWEEP, out=directory), directory


def test_a_killed_worker_a_new_one_and_a_cut_connection_cost_no_row(cluster, undisturbed, tmp_path):
    host, port = cluster.scheduler_address.removeprefix("tcp://").rsplit(":", 1)
    cable = Cable((host, int(port)))
    with distributed.Client(cable.address) as client:
        workers = client.run(os.getpid)
        assert len(workers) == 2 and os.getpid() not in workers.values()
        happened = []

        def happen(done, all):
            if len(happened) == 0 and done >= 5:
                happened.append("killed")
                os.kill(next(iter(workers.values())), signal.SIGKILL)
            elif len(happened) == 1:
                happened.append("added")
                cluster.scale(3)
            elif len(happened) == 2 and done < all:
                happened.append("cut")
                cable.cut()

        table = fvi.sweep(SWEEP, client=client, out=tmp_path, progress=happen)
        assert happened == ["killed", "added", "cut"]
    expected, directory = undisturbed
    assert table.equals(expected)
    assert table_bytes(tmp_path) == table_bytes(directory)


def test_what_is_done_stays_done_and_a_cluster_goes_on(cluster, undisturbed, tmp_path):
    class Enough(Exception):
        pass

    def stop(done, all):
        if done >= 10:
            raise Enough

    with distributed.Client(cluster) as client:
        with pytest.raises(Enough) as caught:
            fvi.sweep(SWEEP, client=client, out=tmp_path, progress=stop)
        assert 10 <= len(caught.value.result) < 120
        heard = []
        table = fvi.sweep(SWEEP, client=client, out=tmp_path, progress=lambda done, all: heard.append((done, all)))
        assert heard[0][0] >= 10 and heard[-1] == (120, 120)
    assert table.equals(undisturbed[0])


def test_workers_see_no_files(cluster, tmp_path):
    record = tmp_path / "drive.csv"
    record.write_text("t,u0\n0,0.5\n1,0\n")
    (tmp_path / "other.csv").write_text("t,u0\n0,-0.5\n1,0\n")
    axes = '[axes]\n"input.file" = ["drive.csv", "other.csv"]\n[keep]\ntrajectories = true\n'
    (tmp_path / "scenario.toml").write_text(
        'system = { mass = "mass.mtx", potential = "0.5*q0^2", load = [{ pattern = "pattern.npy", amplitude = "sin(t)" }] }\n'
        'time = { step = 0.1, steps = 20 }\ninput = { file = "drive.csv" }\n'
        "initial = { position = [1.0], momentum = [0.0] }\n"
    )
    (tmp_path / "sweep.toml").write_text(f'scenario = "scenario.toml"\n{axes}')
    (tmp_path / "mass.mtx").write_text("%%MatrixMarket matrix coordinate real symmetric\n1 1 1\n1 1 1.0\n")
    np.save(tmp_path / "pattern.npy", [0.5])
    here = fvi.sweep(tmp_path / "sweep.toml", out=tmp_path / "here")
    with distributed.Client(cluster) as client:
        there = fvi.sweep(tmp_path / "sweep.toml", out=tmp_path / "there", client=client)
    assert here.equals(there) and here["q0"][0] != here["q0"][1]
    for run in ("000000.npz", "000001.npz"):
        assert (tmp_path / "here/runs" / run).read_bytes() == (tmp_path / "there/runs" / run).read_bytes()


def test_what_is_no_client_is_refused(cluster):
    with pytest.raises(fvi.InputError, match="dask.distributed.Client"):
        fvi.sweep(SWEEP, client=cluster)
