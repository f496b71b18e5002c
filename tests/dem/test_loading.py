"""Kernels are compiled together before they are launched, and users are told."""

import os
import signal
import threading
from contextlib import nullcontext
from types import SimpleNamespace

import pytest
import warp as wp
from pumping import TINY

from warpcrete import Simulation, scenes
from warpcrete.core.device import launching
from warpcrete.core.device.interrupts import StopAtSample
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


@pytest.mark.posix
@pytest.mark.parametrize("stop", [False, True], ids=["at once", "at the next sample"])
def test_ctrl_c_is_heard_while_other_threads_compile(monkeypatch, stop):
    """Python handles signals in its main thread only, so this thread must not wait for a compiler."""
    begun, end = threading.Event(), threading.Event()

    def compile(module, device, block_dim):
        begun.set()
        assert end.wait(60.0)

    monkeypatch.setattr(launching, "load_module", compile)
    stage = SimpleNamespace(module=SimpleNamespace(kernels={}))
    simulation = SimpleNamespace(finishing=False, stop_requested=False)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    sender = threading.Thread(target=lambda: begun.wait(60.0) and os.kill(os.getpid(), signal.SIGINT))
    try:
        sender.start()
        with pytest.raises(KeyboardInterrupt), StopAtSample([simulation]) if stop else nullcontext():
            load([stage], wp.get_device("cpu"))
        assert simulation.stop_requested is stop
    finally:
        end.set()
        signal.signal(signal.SIGINT, before)
        sender.join()


def test_a_compiler_that_fails_ends_the_run_with_its_error(monkeypatch):
    def compile(module, device, block_dim):
        raise IndexError("no such thing")

    monkeypatch.setattr(launching, "load_module", compile)
    with pytest.raises(IndexError, match="no such thing"):
        load([SimpleNamespace(module=SimpleNamespace(kernels={})) for _ in range(3)], wp.get_device("cpu"))
