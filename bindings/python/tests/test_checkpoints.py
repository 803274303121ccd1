"""Runs into a directory, and resumed runs."""

import numpy as np
import pytest

import fvi
from test_run import PENDULUM


def same(one, other):
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("t", "q", "p", "energy"))


class Enough(Exception):
    pass


def test_an_interrupted_run_goes_on_to_the_same_bits(tmp_path):
    # Long enough for the callback, which is called at intervals of milliseconds, to be called before the end.
    steps = 1_000_000
    whole = fvi.run(PENDULUM, steps=steps, engine="exponential-sum", every=100, out=tmp_path / "whole")
    assert same(whole, fvi.run(PENDULUM, steps=steps, engine="exponential-sum", every=100))

    def stop(done, all):
        if done < all:
            raise Enough

    out = tmp_path / "part"
    with pytest.raises(Enough) as caught:
        fvi.run(PENDULUM, steps=steps, engine="exponential-sum", every=100, out=out, progress=stop, checkpoint_every=10_000)
    part = caught.value.result
    assert part.status == 1 and 0 < part.summary["steps"] < steps
    assert same(fvi.run(PENDULUM, steps=steps, engine="exponential-sum", every=100, out=out, resume=True), whole)
    for name in ("trajectory.npz",):
        assert (out / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_a_run_that_has_ended_is_carried_further(tmp_path):
    fvi.run(PENDULUM, out=tmp_path, checkpoint_every="1min")
    further = fvi.run(PENDULUM, steps=900, out=tmp_path, resume=True)
    assert same(further, fvi.run(PENDULUM, steps=900))


def test_what_does_not_go_together_is_refused(tmp_path):
    fvi.run(PENDULUM, out=tmp_path, checkpoint_every="1min")
    with pytest.raises(fvi.InputError):
        fvi.run(PENDULUM, step=0.01, out=tmp_path, resume=True)
    for keys in (dict(resume=True), dict(checkpoint_every=10), dict(out=tmp_path, checkpoint_every="often")):
        with pytest.raises(fvi.InputError) as caught:
            fvi.run(PENDULUM, **keys)
        assert caught.value.key in ("resume", "checkpoint_every")
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError):
        fvi.run(PENDULUM, out=tmp_path / "file")
