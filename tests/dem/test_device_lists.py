"""Lists that a GPU builds by itself, as far as a CPU can do it."""

import pytest
from pumping import TINY

from warpcrete import Simulation, scenes
from warpcrete.dem.engine import device_rebuild as rebuilding
from warpcrete.dem.engine.launch_planner import DEVICE_CHECK_INTERVAL

pytestmark = [pytest.mark.thorough, pytest.mark.usefixtures("like_a_gpu")]


@pytest.mark.parametrize(
    "more", [dict(wall="mesh"), dict(shapes="shape-1.5", travel=0.015), dict(hydration=0.2, hydration_modulus=1e7)]
)
def test_the_device_builds_lists_as_the_host_would(monkeypatch, shared_packings, more):
    """The device leaves the lists to the host where there is no room for them."""
    scene = scenes.pipe(**TINY | dict(travel=0.02) | more)
    found = {}
    for way in ("device", "no room", "host"):
        if way == "no room":
            monkeypatch.setattr(rebuilding.DeviceRebuild, "room", lambda self: 100)
        elif way == "host":
            monkeypatch.setattr(rebuilding.DeviceRebuild, "possible", lambda batch: False)
        simulation = Simulation(scene, device="cpu")
        hash = simulation.run().result["state_hash"]
        lists = simulation.stepper.lists
        found[way] = hash, int(lists.by_device.numpy()[0]), int(lists.builds[0]) - int(lists.by_device.numpy()[0])
    (one, by_device, by_host), (other, none, without_room), (third, never, by_host_alone) = found.values()
    assert one == other == third
    assert by_device > 2 and none == never == 0
    assert by_host + by_device >= by_host_alone and without_room > by_host + 1


def test_a_goal_of_many_steps_does_not_keep_a_device_from_its_lists():
    """Without estimates it looks after them every twenty steps."""
    simulation = Simulation(scenes.pipe(**TINY), device="cpu")
    simulation.prepare()
    stepper = simulation.stepper
    launched, launch = [], stepper.batch.planner.launch_sizes
    stepper.batch.planner.launch_sizes = lambda *now: launched.append(launch(*now)) or launched[-1]
    before = int(stepper.lists.by_device.numpy()[0])
    stepper.choose_dt()
    stepper.take(500)
    assert int(stepper.lists.by_device.numpy()[0]) > before + 1
    assert all(max(launch_sizes) <= DEVICE_CHECK_INTERVAL for launch_sizes in launched) and len(launched) < 4


def test_a_device_has_cells_for_a_scene_that_came_with_its_lists(tmp_path):
    simulation = Simulation(scenes.pipe(**TINY), device="cpu")
    simulation.prepare()
    simulation.stepper.take(5)
    simulation.save(tmp_path / "a.npz")
    other = Simulation(scenes.pipe(**TINY), device="cpu")
    other.resume(tmp_path / "a.npz")
    other.stepper.take(1)
    assert other.stepper.batch.planner.rebuilds_on_device and other.stepper.lists._cells._dims.prod() > 30
