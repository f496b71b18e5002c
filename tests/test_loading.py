"""Kernels are compiled together before they are launched, by threads that share headers, and users are told."""

import threading

import pytest
import warp
from pumping import SMALL

from warpcrete import Simulation, scenes
from warpcrete.core import launching
from warpcrete.core.launching import load, telling
from warpcrete.dem.stages import step_stages


@pytest.mark.parametrize("shapes", ["spheres", "reference"])
def test_a_run_launches_nothing_that_was_not_loaded_with_the_rest(device, shapes, monkeypatch):
    """Each alone would be compiled by one thread while the others wait."""
    together: set[tuple[int, int]] = set()
    apart: list[tuple[str, int, int]] = []
    load_one, load_any = launching._load, warp._src.context.Module.load

    def loads(module, device, block):
        together.add((id(module), block))
        load_one(module, device, block)

    def load_module(self, device, block_dim=None, *arguments, **named):
        if "kernel" in self.name:
            apart.append((self.name, id(self), block_dim))
        return load_any(self, device, block_dim, *arguments, **named)

    monkeypatch.setattr(launching, "default_threads", lambda: 1)
    monkeypatch.setattr(launching, "_load", loads)
    monkeypatch.setattr(warp._src.context.Module, "load", load_module)
    scene = scenes.pipe(shapes=shapes, hydration=0.1, hydration_modulus=2e6, **SMALL | dict(travel=0.002, settle=0.01))
    Simulation(scene, device=device).run()
    assert len(together) > 30
    assert not [name for name, module, block in apart if (module, block) not in together], apart


def test_threads_have_the_headers_of_the_one_that_sets_out():
    """Or each would compile them anew, and that is what takes longest."""
    here, there = launching._headers_folder(), []
    assert here is not None
    home = threading.get_ident()
    for share in (lambda: None, lambda: launching._share_headers(home)):
        thread = threading.Thread(target=lambda share=share: (share(), there.append(launching._headers_folder())))
        thread.start()
        thread.join()
    assert there[0] != here and there[1] == here


def test_who_waits_for_the_compiler_is_told(monkeypatch):
    simulation = Simulation(scenes.pipe(**SMALL), device="cpu")
    simulation.prepare()
    stages, told = step_stages(simulation.stepper.batch)[0], []
    with telling(lambda phase, fraction: told.append((phase, fraction))):
        load(stages, simulation.device)
        assert not told  # all is there
        monkeypatch.setattr(launching, "PATIENCE", -1.0)
        load(stages, simulation.device)
    assert told and {phase for phase, _ in told} == {"compiling"} and told[-1][1] == 1.0
    assert [f for _, f in told] == sorted(f for _, f in told)
    told.clear()
    load(stages, simulation.device)
    assert not told
