"""Runs of mortar with aggregates that an interruption or a failed solve ends within a time step."""

import dataclasses
import json

import pytest

import warpcrete
from warpcrete import ConvergenceError, scenes
from warpcrete.kernels.mps.grid.cells import NOW
from warpcrete.suspension.solve import CoupledSolve

TUBE = dict(
    aggregate_fraction=0.1, aggregate_smallest=0.04, spacing=0.0125, diameter=0.1, length=0.125, duration=0.02,
    sample_interval=0.02, courant=0.02, concrete="no1",
)  # fmt: skip


def ended_in_step(number, how, out, device, monkeypatch):
    """Return the simulation and result.json of a run that ends within a coupled solve, `number` counted from 1."""
    simulation = warpcrete.Simulation(scenes.tube(**TUBE), device=device, out=out)
    solve, orthogonalise, solves = CoupledSolve.solve, CoupledSolve._orthogonalise, []

    def counted(self):
        solves.append(self)
        if len(solves) == number and how == "failed solve":
            self.tolerances = dataclasses.replace(self.tolerances, outer=1)
        solve(self)

    def interrupted(self, direction):
        if len(solves) == number and direction == 1 and how == "interruption":
            raise KeyboardInterrupt
        return orthogonalise(self, direction)

    monkeypatch.setattr(CoupledSolve, "solve", counted)
    monkeypatch.setattr(CoupledSolve, "_orthogonalise", interrupted)
    error = None
    try:
        run = simulation.run()
        assert run.interrupted
    except ConvergenceError as failed:
        error = failed
    assert (error is None) == (how == "interruption") and len(solves) == number
    return simulation, json.loads((out / "result.json").read_text(encoding="utf-8")), error


@pytest.mark.parametrize("how", ["interruption", "failed solve"])
@pytest.mark.parametrize("number", [1, 3])
def test_a_run_that_ends_within_a_step_has_results(number, how, device, tmp_path, monkeypatch):
    simulation, result, error = ended_in_step(number, how, tmp_path / "run", device, monkeypatch)
    assert result["ended"]["reason"] == ("interrupted" if how == "interruption" else "unconverged")
    assert not result["finished"] and result["aggregates"]["count"] > 0
    # Velocities at the beginning and at the end of an incomplete step do not belong to one step.
    assert "momentum_balance" not in result
    assert (tmp_path / "run" / "series.csv").is_file()
    # The number of steps, the time and the hash of the state belong together.
    now = simulation.flow.mesh.clock.numpy()[int(NOW)]
    assert result["steps"] == simulation.flow.steps == number - 1
    assert result["simulated_time"]["value"] == simulation.flow.time and (simulation.flow.time > 0) == (number > 1)
    assert simulation.flow.time == now
    if error is not None:
        assert error.time == simulation.flow.time and error.iterations == 1 == len(error.history) - 1
        assert "did not converge in 1 iterations; its residual" in str(error)
        assert "maximum_iterations" not in str(error) and "'courant'" in str(error)


def test_a_completed_step_has_a_balance_also_after_an_interruption_between_steps(device):
    simulation = warpcrete.Simulation(scenes.tube(**TUBE), device=device)
    simulation.begin()
    assert "momentum_balance" not in simulation.aggregate_sizes()
    simulation.flow.take(1)
    assert abs(simulation.aggregate_sizes()["momentum_balance"]["error"]) < 0.02
    again = warpcrete.Simulation(scenes.tube(**TUBE), device=device)
    again.load_state_dict(simulation.state_dict())
    assert "momentum_balance" not in again.aggregate_sizes() and again.flow.steps == 1
    again.result(False)
    assert again.flow.steps == 1 and again.flow.time == simulation.flow.time
