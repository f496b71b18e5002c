"""Verification of concrete that spreads on a plate in two dimensions: speed of the front, and shape of the heap."""

import numpy as np

from ..mps.free.probes import surface
from ..mps.free.scene import FreeScene
from ..mps.free.simulation import FreeSimulation
from ..mps.grid.state import NO_SLIP_VISCOSITY
from ..theory.pipe import Concrete
from ..theory.vessels import heap_at_rest, heap_depth, viscous_front
from .case import Case, Row

HALF = 0.2, 0.05
"""Width and height of the box of concrete on one side of the plane of symmetry [m]."""


def let_go(yield_stress: float, width: float, duration: float) -> FreeScene:
    """Return the scene of a box-shaped volume of concrete that is released on a plate and spreads for `duration` [s].

    `width` is the width of the plate beside the plane of symmetry [m]. The concrete has the yield stress `yield_stress`
    [Pa] and a viscosity of 10 Pa s, and it sticks to the plate.
    """
    concrete = Concrete(
        density=2000.0, viscosity=10.0, yield_stress=yield_stress, slip_viscosity=NO_SLIP_VISCOSITY, slip_yield=0.0
    )
    box = ((0.0, 0.0), (HALF[0], 0.0), HALF, (0.0, HALF[1]))
    return FreeScene(
        name="dam", concrete=concrete, axial=False, width=width, height=1.2 * HALF[1], spacing=5e-3,
        outline=box, sides={"left": "mirror"}, duration=duration, sample_interval=duration / 20,
    )  # fmt: skip


def dam_break(device: str, precision: str) -> list[Row]:
    """Compare the position of the front of a spreading Newtonian fluid with theory."""
    simulation = FreeSimulation(let_go(0.0, 0.6, 8.0), device=device, precision=precision)
    run = simulation.run()
    paste, rows = simulation.scene.concrete, []
    # The measured error of the front's position is 2.1 % after 4 s and 2.0 % after 8 s. The measured error of the
    # volume is 0.5 %. Cells of half the size do not reduce the error of the front, because the theory itself is
    # inexact: it assumes a thin layer, whereas the front is steep.
    for time in (4.0, 8.0):
        front = float(np.interp(time, run.series["time"], run.series["spread"]))
        theory = viscous_front(HALF[0] * HALF[1], paste.viscosity, paste.density, time)
        rows.append(Row(f"front after {time:g} s", front, theory, 0.03, "m"))
    return [*rows, Row("volume", 1 + run.result["volume_error"], 1.0, 8e-3)]


def heap(device: str, precision: str) -> list[Row]:
    """Compare the heap in which concrete comes to rest with theory, for a yield stress of 50 Pa."""
    simulation = FreeSimulation(let_go(50.0, 0.45, 10.0), device=device, precision=precision)
    run = simulation.run()
    paste = simulation.scene.concrete
    reach, depth = heap_at_rest(HALF[0] * HALF[1], paste.yield_stress, paste.density, form="plane")
    across, height = surface(simulation.flow)
    inner = across < reach - depth
    exact = heap_depth(reach - across[inner], paste.yield_stress, paste.density, form="plane")
    off = float(np.sqrt(np.mean((height[inner] - exact) ** 2))) / depth
    # Measured errors:
    # - reach: 0.6 %, because the heap is still creeping outwards,
    # - depth in the middle: 1.2 %,
    # - profile (rms): 1.2 %,
    # - volume: 0.25 %.
    return [
        Row("reach", float(run.series["spread"][-1]), reach, 0.012, "m"),
        Row("depth in the middle", float(run.series["top"][-1]), depth, 0.02, "m"),
        Row("rms error of the profile, divided by the depth", off, 0.0, 0.02, scale=1.0),
        Row("volume", 1 + run.result["volume_error"], 1.0, 5e-3),
    ]


CASES = [
    Case("front of a dam break", "Huppert", dam_break, "flows"),
    Case("heap at rest in a plane", "shallow theory with stretch", heap, "flows"),
]
