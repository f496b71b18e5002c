"""Test on a CPU, as far as possible, what only a GPU does: full lists, launch sizes, blocks, graphs, parallel solves.

The tests also compile every kernel of a step for a GPU, without needing a GPU.
"""

import dataclasses
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from test_checkpoint import mixed_scene

from warpcrete import Simulation, scenes
from warpcrete.core.device.device import divide_work_like_gpu, find_device, parallel
from warpcrete.core.device.launching import Stage, bound, load
from warpcrete.core.errors import InstabilityError
from warpcrete.core.run.run import Run
from warpcrete.dem.batch_run import run_batch
from warpcrete.dem.engine.batch import Batch
from warpcrete.dem.engine.model import build_model
from warpcrete.dem.engine.stable_step import StableStep
from warpcrete.dem.engine.stages import step_stages as element_stages
from warpcrete.dem.engine.state import State
from warpcrete.dem.engine.stepper import Stepper
from warpcrete.dem.measure.probes import contact_sums
from warpcrete.dem.scene.bodies import placed_bodies
from warpcrete.dem.scene.scene import TimeStep
from warpcrete.kernels.common.reductions import BLOCK
from warpcrete.kernels.dem.clump_motion import clump_kernel
from warpcrete.kernels.dem.gathering import ESTIMATE_LANES, gather_kernel
from warpcrete.kernels.dem.subcycling import prediction_kernel, rounds_kernel
from warpcrete.kernels.dem.surfaces import surface_kernel
from warpcrete.kernels.dem.warps import WARP
from warpcrete.kernels.mps import resident_solver
from warpcrete.kernels.mps.two_level import resident_two_level
from warpcrete.mps import stages
from warpcrete.mps.grid import flow as grid_flow
from warpcrete.mps.particles import MovingParticles
from warpcrete.mps.state import FluidState

pytestmark = pytest.mark.thorough

SMALL = dict(length=0.1, diameter=0.06, ramp=0.005, travel=0.01, settle=0.02, size_min=8e-3, size_max=12e-3,
             plug="plate", solid_fraction=0.55)  # fmt: skip
"""A solid fraction is packed in two thirds of the time that a pressure takes, because it needs no trial packing."""


@pytest.fixture
def like_a_gpu():
    with divide_work_like_gpu():
        yield


def test_arguments_are_bound_by_name():
    @wp.kernel(module="unique")
    def two(first: wp.array(dtype=float), second: wp.array(dtype=float)):
        first[wp.tid()] = second[wp.tid()]

    assert bound(two, {"second": 2, "first": 1}) == [1, 2]
    with pytest.raises(
        TypeError, match="missing arguments: second; arguments that are not parameters of the kernel: third"
    ):
        bound(two, {"first": 1, "third": 3})


def launches_of(simulation) -> list[Stage]:
    """Every recorded launch of a step and of a rebuild of its lists."""
    found = simulation.stepper.lists._rebuild(True).kernel_stages()
    return found + [stage for part in element_stages(simulation.stepper.batch) for stage in part]


def test_stages_of_any_dimension_are_recorded(like_a_gpu):
    """The launch whose size is a tuple once broke every run on a GPU."""
    simulation = Simulation(scenes.pipe(**SMALL), device="cpu")
    simulation.prepare()
    batch = simulation.stepper.batch
    assert parallel(batch.device) and batch.parallel and not simulation.model.features.half_list
    stages = launches_of(simulation)
    assert any(isinstance(stage.dim, tuple) for stage in stages)
    for stage in stages:
        assert stage.block in (64, 256) and stage.name in stage.kernel.key
        load([stage], stage.device)
        stage.record()


def same(ours, theirs):
    """Assert that two arrays agree to within rounding, because the same terms are summed in another order.

    The measured relative differences are at most 6e-14, and at most 2e-12 for spins.
    """
    assert np.abs(ours - theirs).max() <= 1e-10 * np.abs(theirs).max()


@pytest.mark.parametrize("features", ["clumps, bonds, mesh, plate", "spheres, lubrication, elbow", "no friction"])
def test_elements_move_the_same_either_way(features):
    """Full lists and half lists give the same results after 300 steps from one packing.

    The test compares positions, spins, wall impulses, counts of contacts and bonds, and dissipated energy.
    """
    if features == "no friction":
        scene = scenes.pipe(friction=0.0, bonds=False, **SMALL)
    elif features.startswith("spheres"):
        parameters = SMALL | dict(unit="bend-to-horizontal", elbow_radius=0.1, plug="balls", plug_ball=0.02)
        scene = scenes.pipe(layer_yield=20.0, layer_viscosity=300.0, energy_balance=True, **parameters)
    else:
        scene = mixed_scene()
    scene = dataclasses.replace(scene, precision="float64", settle=None)
    simulation = Simulation(scene, device="cpu", threads=1)
    simulation.prepare()
    table, outcomes = simulation.state.table(), []
    for gpu in (False, True):
        with divide_work_like_gpu() if gpu else nullcontext():
            outcomes.append(moved(scene, table))
    (position, spin, wall, counts, lost), (position_2, spin_2, wall_2, counts_2, lost_2) = outcomes
    same(position, position_2)
    same(spin, spin_2)
    same(wall, wall_2)
    assert counts == counts_2 and counts[0] > 50
    assert lost == pytest.approx(lost_2, rel=1e-5)


def moved(scene, table):
    model = build_model(scene, find_device("cpu"), "float64")
    state = State(model, table)
    stepper = Stepper(model, state, scene.time_step)
    assert model.features.half_list != parallel(model.device)
    if scene.bonds is not None:
        stepper.bond(scene.bonds, 1)
    stepper.take(300)
    sums = contact_sums(model, state, coordination=True)
    found = state.table()
    counts = (sums.contacts, sums.bonded, sums.broken_tension, sums.broken_shear)
    lost = float(state.spheres.dissipated_energy.numpy().sum())
    return found.position, found.spin, state.walls.impulse.numpy(), counts, lost


def test_a_batch_holds_the_bits_of_each_alone_in_full_lists(like_a_gpu):
    some = [scenes.pipe(velocity=v, seed=s, **SMALL) for v, s in ((0.3, 0), (0.6, 1), (0.6, 2))]
    together = run_batch([Simulation(scene, device="cpu", threads=1) for scene in some])
    for scene, other in zip(some, together):
        assert isinstance(other, Run) and other.finished
        assert Simulation(scene, device="cpu", threads=1).run().result["state_hash"] == other.result["state_hash"]


def test_a_run_resumes_to_the_same_bits_in_full_lists(like_a_gpu, tmp_path):
    scene = scenes.pipe(shapes="reference", **SMALL)
    first = Simulation(scene, device="cpu")
    first.prepare()
    first.save(tmp_path / "a.npz")
    whole = first.run()
    second = Simulation(scene, device="cpu")
    second.resume(tmp_path / "a.npz")
    assert second.run().result["state_hash"] == whole.result["state_hash"]


def test_a_fresh_scene_and_a_resumed_one_go_on_together_in_full_lists(like_a_gpu, tmp_path):
    """Lists of one come from a checkpoint, those of the other from nothing, in either order."""
    some = [scenes.pipe(seed=seed, **SMALL) for seed in (0, 1)]
    alone = []
    for seed, scene in enumerate(some):
        one = Simulation(scene, device="cpu")
        one.prepare()
        one.save(tmp_path / f"{seed}.npz")
        alone.append(one.run().result["state_hash"])
    for fresh in (0, 1):
        paths = [None if seed == fresh else tmp_path / f"{seed}.npz" for seed in (0, 1)]
        runs = run_batch([Simulation(scene, device="cpu") for scene in some], checkpoints=paths)
        assert [run.result["state_hash"] for run in runs if isinstance(run, Run)] == alone


def grained(fraction: float):
    """A tube at 10 mm, with grains that are large enough for that."""
    scene = scenes.tube(spacing=10e-3, aggregates=True, aggregate_fraction=fraction, precision="float64")
    large = dataclasses.replace(scene.aggregates, sizes=((20e-3, 30e-3, 1.0),))
    return dataclasses.replace(scene, aggregates=large)


FLOWS = {
    "channel": lambda: scenes.channel(spacing=10e-3, precision="float64"),
    "channel, coarse grid": lambda: scenes.channel(spacing=6e-3, precision="float64"),
    "two phases": lambda: scenes.channel(spacing=5e-3, aggregates=True, precision="float64"),
    "tube": lambda: scenes.tube(spacing=10e-3, precision="float64"),
    "tube, coarse grid": lambda: scenes.tube(spacing=10e-3, length=0.5, precision="float64"),
    "tube, two phases": lambda: grained(0.05),
}


def compiled(kernel, *, use_ptx: bool):
    """Compile the module of a kernel for an H100 or H200, and return the file.

    The file is in Warp's cache of kernels, by the hash of code and options, so each kernel is compiled once.
    """
    (path,) = wp.compile_aot_module(kernel.module, device=None, arch=90, use_ptx=use_ptx)
    assert path.suffix == (".ptx" if use_ptx else ".cubin")
    return path


def registers(kernel):
    """Return the registers of a thread, for each function in the binary of a kernel; they are in the attribute 0x2f."""
    binary, found = compiled(kernel, use_ptx=False).read_bytes(), []
    at = binary.find(b"\x04\x2f\x08\x00")
    while at >= 0:
        found.append(int.from_bytes(binary[at + 8 : at + 12], "little"))
        at = binary.find(b"\x04\x2f\x08\x00", at + 4)
    return found


SOLVES = [(2, False), (2, True), (3, False), (3, True), (2, True, True), (3, True, True)]


@pytest.mark.parametrize("scalar", [wp.float32, wp.float64], ids=["float32", "float64"])
@pytest.mark.parametrize("kind", SOLVES, ids=str)
def test_blocks_that_wait_for_one_another_have_room_at_once(kind, scalar):
    """Registers: 65,536 of a multiprocessor. Were one block too many, the others would wait for it for ever."""
    rigid = len(kind) == 3
    for width, resident in ((BLOCK, resident_solver.RESIDENT), (resident_solver.WIDE, 1)):
        kernels = [resident_solver.resident_solver(scalar, *kind[:2], rigid, width)]
        if not rigid:
            kernels.append(resident_two_level(scalar, *kind, width))
        for kernel in kernels:
            kernel.module.options["block_dim"] = width
            found = registers(kernel)
            assert found and 8 < max(found) <= 65_536 // (width * resident)


def test_blocks_of_a_solve_are_no_more_than_it_has_work_for_or_the_gpu_room():
    gpu = SimpleNamespace(is_cuda=True, sm_count=10)
    asked = ((2000, 20, 1), (2001, 20, 1), (256_000, 20, 1), (256_000, 20, 4), (256_000, 20, 31))
    given = [resident_solver.resident_blocks(gpu, *one) for one in asked]
    assert given == [(1024, 1), (256, 8), (256, 30), (256, 7), (256, 1)]
    assert resident_solver.resident_blocks(SimpleNamespace(is_cuda=False, sm_count=0), 256_000, 20, 1) == (256, 1)


@pytest.mark.parametrize("name", FLOWS)
def test_flows_go_the_same_either_way(name, monkeypatch):
    """Solves in blocks against solves in a row, lists by entry against lists by row.

    Velocities are solved for to the end: iterations make more of rounding, where grains are rigid most of all.
    """
    monkeypatch.setattr(stages, "VELOCITY_ERROR", 1e-11)
    scene = FLOWS[name]()
    found = []
    for gpu in (False, True):
        with divide_work_like_gpu() if gpu else nullcontext():
            flow = MovingParticles(FluidState(scene, find_device("cpu"), "float64"), threads=1)
            assert flow.parallel == gpu
            flow.take(6)
        particles = flow.particles
        found.append([a.numpy().astype(float) for a in (particles.position, particles.velocity, particles.pressure)])
    (x, v, p), (x2, v2, p2) = found
    same(x, x2)
    same(v, v2)
    same(p, p2)


GRIDS = {
    "periodic pipe": lambda: scenes.tube(ends="periodic", length=0.1, yield_stress=400.0),
    "slump": lambda: scenes.slump(spacing=0.0167, yield_stress=500.0, lift_time=0.05),
    "L-box": lambda: scenes.lbox(concrete="own", density=2300.0, viscosity=20.0, yield_stress=30.0, spacing=0.0167,
                                 lift_time=0.02, length=0.22, column_height=0.2, width=0.14, time_step=2e-3,
                                 step_error=0.0),
}  # fmt: skip


@pytest.mark.parametrize("pick", GRIDS)
def test_a_grid_steps_abreast_as_it_does_in_turn(pick, monkeypatch):
    """Bins filled in any order and sorted, sums of blocks, solves in blocks; velocities solved for to the end."""
    monkeypatch.setattr(grid_flow, "VELOCITY_ERROR", 1e-11)
    found = []
    for gpu in (False, True):
        with divide_work_like_gpu() if gpu else nullcontext():
            simulation = Simulation(GRIDS[pick](), device="cpu", precision="float64")
            simulation.prepare()
            flow = simulation.flow
            assert flow.parallel == gpu
            flow.take(15 if pick == "L-box" else 8)  # The gate of the L-box rises for ten steps.
        rubbed = flow.mesh.wall_force if flow.state.layout.kind.cut else flow.mesh.traction
        found.append([array.numpy() for array in (flow.particles.position, flow.particles.velocity, rubbed)])
    for one, two in zip(*found, strict=True):
        assert np.abs(one).max() > 1e-3 and two == pytest.approx(one, rel=1e-6, abs=1e-6 * np.abs(one).max())


def kernels_of_a_step(pick):
    """Kernels of the steps of both methods, and of a rebuild, as a GPU has them."""
    with divide_work_like_gpu():
        if pick == "elements":
            scene = scenes.pipe(shapes="reference", wall="mesh", facets=12, layer_viscosity=10.0, energy_balance=True,
                                healing=True, **SMALL)  # fmt: skip
            simulation = Simulation(scene, device="cpu")
            simulation.prepare()
            batch, features = simulation.stepper.batch, simulation.model.features
            law, wall_law = features.pair_law, features.wall_law
            # A CPU's warp is one thread; those of a GPU compile another text.
            warps = [
                gather_kernel(batch.scalar, law, wall_law, False, True, True, ESTIMATE_LANES),
                clump_kernel(batch.scalar, True, True, True, False, True, True, 4, WARP),
                surface_kernel(batch.scalar, wall_law, True, False, WARP),
                prediction_kernel(batch.scalar, True, False, True),
                rounds_kernel(batch.scalar, law, True, True, True),
            ]
            stages = [*launches_of(simulation), *(SimpleNamespace(kernel=kernel) for kernel in warps)]
        elif pick in GRIDS:
            simulation = Simulation(GRIDS[pick](), device="cpu")
            simulation.prepare()
            stages = simulation.flow.step[0]
        else:
            scene = grained(0.05) if pick == "two phases" else scenes.tube(spacing=20e-3)
            flow = MovingParticles(FluidState(scene, find_device("cpu"), "float32"), threads=1)
            stages = flow.step[0]
    return {id(stage.kernel): stage.kernel for stage in stages}


@pytest.mark.parametrize("pick", ["elements", "one phase", "two phases", *GRIDS])
def test_every_kernel_of_a_step_compiles_for_a_gpu(pick):
    """For an H100's or H200's architecture, by the compiler that Warp brings along."""
    kernels = kernels_of_a_step(pick)
    assert len(kernels) > 8
    for kernel in kernels.values():
        assert ".entry" in compiled(kernel, use_ptx=True).read_text(encoding="utf-8")


@pytest.mark.parametrize("shapes", ["spheres", "shape-1.5"])
def test_the_device_estimates_the_step_as_the_host_would(like_a_gpu, monkeypatch, shapes):
    """Steps go on over several estimates without the host, and end in the same bits."""
    scene = scenes.pipe(seed=1, shapes=shapes, **SMALL)
    asked, estimate = [], StableStep.__call__
    monkeypatch.setattr(StableStep, "__call__", lambda self, s: (asked.append(s), estimate(self, s)))
    by_device = Simulation(scene, device="cpu").run()
    few = len(asked)
    use_step = Batch.use_step
    monkeypatch.setattr(Batch, "use_step", lambda self, step, *by_device: use_step(self, step, None, None))
    by_host = Simulation(scene, device="cpu").run()
    assert by_device.result["state_hash"] == by_host.result["state_hash"]
    assert np.array_equal(by_device.series["time_step"], by_host.series["time_step"])
    assert len(np.unique(by_device.series["time_step"])) > 3
    assert len(asked) - 2 * few > 5  # what the device took over


def test_a_device_that_finds_a_step_unstable_leaves_it_to_the_host(like_a_gpu):
    """A scene that stiffens under way, at a step that is given: the same words as on a CPU."""
    scene = dataclasses.replace(mixed_scene(), duration=1.0)
    stepper = started_with(scene, TimeStep())
    stable = stepper.estimate()
    stepper = started_with(scene, TimeStep(fixed=0.9 * stable, interval=5))
    stepper.running = True
    stepper.take(1)
    mass = stepper.state.bodies.mass
    mass.assign(0.5 * mass.numpy())
    with pytest.raises(InstabilityError, match="above the largest stable time step of this scene"):
        stepper.advance(100 * stable)
    assert stepper.steps == 5


def started_with(scene, time_step):
    model = build_model(scene, find_device("cpu"), "float32")
    return Stepper(model, State(model, placed_bodies(scene)), time_step)
