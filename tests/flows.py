"""Small flows for tests, and their steps one stage at a time."""

import dataclasses

import numpy as np

from warpcrete import scenes
from warpcrete.core.device.device import find_device
from warpcrete.mps.particles import MovingParticles
from warpcrete.mps.stages import step_parts
from warpcrete.mps.state import FluidState

SCENES = {2: scenes.channel, 3: scenes.tube}


def flow_of(device, precision="float64", dimensions=2, **parameters):
    """Particles of a scene, shaken by a hundredth of the spacing so that nothing holds by symmetry alone."""
    scene = SCENES[dimensions](**{"spacing": 10e-3, "ends": "piston", **parameters})
    state = FluidState(scene, find_device(device), precision)
    rng = np.random.default_rng(1)
    shift = 0.01 * state.layout.spacing * rng.uniform(-1, 1, (state.count, dimensions))
    state.particles.position.assign(state.particles.position.numpy() + shift)
    return MovingParticles(state, threads=1)


def begin(simulation, steps=0):
    """Prepare a simulation, take some steps of its flow, and return the simulation."""
    simulation.begin()
    if steps:
        simulation.flow.take(steps)
    return simulation


def step(flow):
    """One step; what it worked with stays in the arrays of `flow`."""
    flow.take(1)
    return flow


def neighbours(flow):
    """Rows (i, j, coefficient) of the pairs within reach."""
    count, near = flow.lists.near_count.numpy(), flow.lists.near.numpy()
    coefficient = flow.matrix.coefficient.numpy()
    n, capacity = flow.state.count, flow.lists.near_capacity
    rows = []
    for i in range(n):
        for k in range(count[i]):
            at = k * n + i if flow.parallel else i * capacity + k
            rows.append((i, near[at], coefficient[at]))
    return np.array(rows)


def stage_named(flow, name):
    """The stage of a step with this kernel."""
    (found,) = [s for s in flow.step[0] if getattr(s, "name", None) == name]
    return found


def forces(flow):
    """Everything of a step up to the forces, before any solve."""
    (part,) = step_parts(flow)
    for stage in (*part.geometry(), *part.wall_scale(), *part.momentum()):
        stage()


def two_phase_flow(device, dimensions=2, **parameters):
    """Grains and mortar of quite different densities, at the start."""
    spacing = 5e-3 if dimensions == 2 else 10e-3
    scene = SCENES[dimensions](
        spacing=spacing, aggregates=True, aggregate_density=5000.0, aggregate_fraction=0.15, **parameters
    )
    if dimensions == 3:
        large = dataclasses.replace(scene.aggregates, sizes=((20e-3, 30e-3, 1.0),))
        scene = dataclasses.replace(scene, aggregates=large)
    return MovingParticles(FluidState(scene, find_device(device), "float64"), threads=1)
