"""Kernels are compiled together before they are launched, and users are told."""

from types import SimpleNamespace

import pytest
import warp as wp
from pumping import TINY

from warpcrete import Simulation, scenes
from warpcrete.core.device import launching
from warpcrete.core.device.launching import load, report_compiling
from warpcrete.dem.engine.stages import step_stages


@pytest.mark.parametrize("shapes", ["spheres", "reference"])
def test_a_run_launches_nothing_that_was_not_loaded_with_the_rest(device, shapes, monkeypatch):
    """Each alone would be compiled by one thread while the others wait."""
    together: set[tuple[int, int]] = set()
    apart: list[tuple[str, int, int]] = []
    load_one, load_any = launching.load_module, wp.Module.load

    def loads(module, device, block_dim):
        together.add((id(module), block_dim))
        load_one(module, device=device, block_dim=block_dim)

    def load_module(self, device, block_dim=None, *arguments, **named):
        if "kernel" in self.name or self.name.startswith("warpcrete_"):
            apart.append((self.name, id(self), block_dim))
        return load_any(self, device, block_dim, *arguments, **named)

    monkeypatch.setattr(launching, "default_threads", lambda: 1)
    monkeypatch.setattr(launching, "load_module", loads)
    monkeypatch.setattr(wp.Module, "load", load_module)
    small = TINY | dict(shapes=shapes, plug="balls", plug_ball=0.012, travel=0.002, ramp=0.001)
    scene = scenes.pipe(hydration=0.1, hydration_modulus=2e6, **small)
    Simulation(scene, device=device).run()
    assert len(together) > 25
    assert not [name for name, module, block in apart if (module, block) not in together], apart


def test_long_compilations_go_first():
    modules = [
        SimpleNamespace(kernels={"k": SimpleNamespace(adj=SimpleNamespace(args=[None] * n))}) for n in (3, 9, 20, 12)
    ]
    ordered = [each for each, _ in launching._in_order([(each, 1) for each in modules])]
    assert [len(each.kernels["k"].adj.args) for each in ordered] == [20, 12, 9, 3]


def test_who_waits_for_the_compiler_is_told(monkeypatch):
    simulation = Simulation(scenes.pipe(**TINY), device="cpu")
    simulation.prepare()
    stages, told = step_stages(simulation.stepper.batch)[0], []
    with report_compiling(lambda phase, fraction: told.append((phase, fraction))):
        load(stages, simulation.device)
        assert not told  # all is there
        monkeypatch.setattr(launching, "COMPILE_PROGRESS_DELAY", -1.0)
        load(stages, simulation.device)
    assert told and {phase for phase, _ in told} == {"compiling"} and told[-1][1] == 1.0
    assert [f for _, f in told] == sorted(f for _, f in told)
    told.clear()
    load(stages, simulation.device)
    assert not told
