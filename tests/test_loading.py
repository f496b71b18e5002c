"""Kernels are compiled together before they are launched, by threads that share headers, and users are told."""

import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
import warp
import warp as wp
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
        if "kernel" in self.name or self.name.startswith("warpcrete_"):
            apart.append((self.name, id(self), block_dim))
        return load_any(self, device, block_dim, *arguments, **named)

    monkeypatch.setattr(launching, "default_threads", lambda: 1)
    monkeypatch.setattr(launching, "_load", loads)
    monkeypatch.setattr(warp._src.context.Module, "load", load_module)
    scene = scenes.pipe(shapes=shapes, hydration=0.1, hydration_modulus=2e6, **SMALL | dict(travel=0.002, settle=0.01))
    Simulation(scene, device=device).run()
    assert len(together) > 25
    assert not [name for name, module, block in apart if (module, block) not in together], apart


def test_headers_are_compiled_once_for_each_flags():
    """Or each thread would compile them anew, and that is what takes longest."""
    known, folders, made = wp._src.context.runtime._pch_dirs, [], []
    before = dict(known)
    headers = launching._Headers()

    def used(compiled: bool) -> None:
        with headers.used():
            folder = Path(known[threading.get_ident()].name)
            folders.append(folder)
            made.append(len(list(folder.iterdir())))
            if compiled:
                (folder / "headers.pch").touch()

    threads = [threading.Thread(target=used, args=(k > 0,)) for k in range(4)]
    for thread in threads:
        thread.start()
        thread.join()
    assert len(set(folders)) == 1
    assert made == [0, 0, 1, 1]  # the first found its module in the cache and compiled none
    assert dict(known) == before
    first, second = launching._Headers(), launching._Headers()
    assert first._folder.name != second._folder.name


def test_who_comes_second_waits_until_headers_are_compiled():
    headers, order = launching._Headers(), []
    inside, go_on, asking = threading.Event(), threading.Event(), threading.Event()

    def first() -> None:
        with headers.used():
            inside.set()
            go_on.wait(10)
            (Path(headers._folder.name) / "headers.pch").touch()
            order.append("first")

    def second() -> None:
        asking.set()
        with headers.used():
            order.append("second")

    threads = [threading.Thread(target=each) for each in (first, second)]
    threads[0].start()
    assert inside.wait(10)
    threads[1].start()
    assert asking.wait(10)
    time.sleep(0.05)
    go_on.set()
    for thread in threads:
        thread.join()
    assert order == ["first", "second"]


def test_long_compilations_and_one_of_each_flags_go_first():
    def module(parameters: int, flags: str):
        kernel = SimpleNamespace(adj=SimpleNamespace(args=[None] * parameters))
        return SimpleNamespace(kernels={"k": kernel}, options={"cpu_compiler_flags": flags})

    modules = [module(n, flags) for n, flags in ((3, ""), (9, "-a"), (20, ""), (12, "-a"), (15, ""))]
    ordered = [each for each, _ in launching._in_order([(each, 1) for each in modules])]
    sizes = [len(each.kernels["k"].adj.args) for each in ordered]
    assert sorted(sizes[:2]) == [12, 20]
    assert sizes[2:] == [15, 9, 3]


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
