"""Links that a GPU chooses as near, and what else its steps and the host exchange."""

import numpy as np
import pytest
import warp as wp

from warpcrete import Simulation, scenes
from warpcrete.core.device import find_device, share_out_like_a_gpu
from warpcrete.core.exchange import Exchange
from warpcrete.core.launching import Launcher, Stage
from warpcrete.dem import stages
from warpcrete.dem.batch import Batch
from warpcrete.dem.batch_run import run_batch
from warpcrete.kernels.common.types import types
from warpcrete.kernels.dem.motion import rotation_functions

SMALL = dict(length=0.1, diameter=0.06, ramp=0.005, travel=0.01, settle=0.02, size_min=8e-3, size_max=12e-3)


@pytest.fixture
def outrun(monkeypatch):
    """After every launch, of each scene: may near links miss a contact?"""
    found: list[int] = []
    launch = Batch.launch

    def noting(self):
        flags = launch(self)
        found.extend(self.links.outrun.numpy().tolist())
        return flags

    monkeypatch.setattr(Batch, "launch", noting)
    return found


@pytest.mark.thorough
@pytest.mark.parametrize("shapes", ["spheres", "reference"])
def test_whatever_links_are_near_the_bits_are_the_same(shapes, monkeypatch, outrun):
    """Chosen every twenty steps, or only with new lists, so that spheres outrun them and all links are looked at."""
    scene, found = scenes.pipe(shapes=shapes, hydration=0.2, healing=True, **SMALL), []
    with share_out_like_a_gpu():
        for chosen in (stages.CHOSEN, 1, 10**6):
            monkeypatch.setattr(stages, "CHOSEN", chosen)
            outrun.clear()
            simulation = Simulation(scene, device="cpu")
            run = simulation.run()
            links = simulation.stepper.batch.links
            near, every = int(links.near_count.numpy()[0]), int((links.link.numpy()[:, 0] >= 0).sum())
            assert 0.1 * every < near < 0.8 * every
            found.append((run.result["state_hash"], np.mean(outrun)))
    assert len({state for state, _ in found}) == 1
    now_and_then, by_every_step, never_again = (share for _, share in found)
    assert by_every_step < 0.1 < 0.5 < never_again and now_and_then < 0.5 * never_again


@pytest.mark.thorough
def test_links_are_chosen_anew_however_short_graphs_are(outrun):
    """Batches go eight steps at a time."""
    with share_out_like_a_gpu():
        run_batch([Simulation(scenes.pipe(seed=seed, **SMALL), device="cpu") for seed in (0, 1)])
    assert len(outrun) > 100 and np.mean(outrun) < 0.3


def test_a_stage_that_is_due_now_and_then_is_left_out_else():
    @wp.kernel(module="unique")
    def count_up(counts: wp.array(dtype=wp.int32), place: wp.int32):
        counts[place] = counts[place] + 1

    device = find_device("cpu")
    counts = wp.zeros(2, dtype=wp.int32, device=device)
    step = [[Stage(count_up, 1, {"counts": counts, "place": k}, device, every=every) for k, every in ((0, 1), (1, 4))]]
    launcher = Launcher(1, device)
    for sizes, now_and_then in (([8], 2), ([2], 1), ([1], 0), ([4, 1, 6], 1 + 0 + 2)):
        counts.zero_()
        launcher.replay(step, lambda: step, sizes, lambda: False)
        assert counts.numpy().tolist() == [sum(sizes), now_and_then]


def test_what_the_host_writes_and_reads_is_the_same(device):
    exchange = Exchange(find_device(device))
    small = wp.zeros((3, 2), dtype=wp.float64, device=device)
    whole = wp.zeros(5, dtype=wp.int32, device=device)
    for value in range(4):  # nothing waits for what was written in the turn before
        exchange.write(small, np.full((3, 2), value))
        exchange.write(whole, np.arange(5) + value)
    a, b = exchange.read(small, whole)
    assert a.tolist() == [[3.0, 3.0]] * 3 and b.tolist() == [3, 4, 5, 6, 7]
    exchange.write(small, np.zeros((3, 2)))
    assert a[0, 0] == 3.0  # a copy
    assert not exchange.read(small)[0].any()


@pytest.mark.parametrize("scalar", [wp.float32, wp.float64], ids=["float32", "float64"])
def test_turns_of_any_size_are_exact(device, scalar):
    t = types(scalar)
    turned, _ = rotation_functions(scalar)

    @wp.kernel(module="unique")
    def turn(rotation: wp.array(dtype=t.vec3), out: wp.array(dtype=t.quat)):
        i = wp.tid()
        out[i] = turned(t.quat(scalar(0.0), scalar(0.0), scalar(0.0), scalar(1.0)), rotation[i])

    angle = np.array([0.0, 1e-9, 0.05, 0.0999, 0.1001, 0.3, 1.0, 3.0, 30.0])
    axis = np.array([2.0, -3.0, 6.0]) / 7
    out = wp.zeros(len(angle), dtype=t.quat, device=device)
    wp.launch(
        turn, len(angle), inputs=[wp.array(angle[:, None] * axis, dtype=t.vec3, device=device), out], device=device
    )
    exact = np.concatenate([np.sin(angle / 2)[:, None] * axis, np.cos(angle / 2)[:, None]], axis=1)
    error = np.abs(out.numpy() - exact).max(axis=1)
    eps = np.finfo(out.numpy().dtype).eps
    # Each doubling doubles what rounding made of the part.
    assert np.all(error <= eps * np.maximum(1.0, 8 * angle))
