"""State of a particle flow on a device, and the initial positions of its particles."""

from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp

from ..core.device.arrays import host_copy
from ..core.device.device import scalar_of
from ..kernels.common.control import FLAGS
from ..kernels.mps.structs import array_structs, flow_struct
from .common.allocation import allocate
from .grains import Grains, place_grains
from .layout import Layout, layout
from .scene import FluidScene

OPERATOR_REACH = 2.1
"""Range within which neighbours enter gradient, divergence and Laplacian, in particle spacings. Xu et al. 2021 use 2.1
for gradients and 4.1 for the Laplacian."""
DENSITY_REACH = 3.1
"""Range within which neighbours enter the density sum, in particle spacings."""


class FluidState:
    """State of a flow computed with particles only: arrays that change in a run, and constants of the initial layout.

    The arrays of particles have one entry per fluid particle, in an order that never changes. The structs `Particles`
    and `Grains` in `kernels/mps/structs.py` give meaning, unit and shape of the arrays.
    """

    flags: wp.array
    """Control flags, such as the number of completed steps. The constants in `kernels/common/control.py` are the
    indices of this array, shape (FLAGS,)."""
    particles: Any
    """Position, velocity and pressure of each fluid particle: arrays in a struct `Particles`."""
    grain_arrays: Any
    """Position, spin and rotation of each rigid grain of aggregate: arrays in a struct `Grains`; None for a flow with
    one phase."""

    def __init__(self, scene: FluidScene, device: wp.Device, precision: str) -> None:
        self.scene, self.device, self.scalar = scene, device, scalar_of(precision)
        self.structs = array_structs(self.scalar, scene.dimensions)
        self.layout: Layout = layout(scene)
        self.grains: Grains | None = None
        fluid = self.layout.fluid
        group, density = np.zeros(0, np.int32), np.zeros(0)
        if scene.aggregates is not None and scene.aggregates.fraction > 0:
            self.grains = place_grains(scene, self.layout)
            fluid = fluid[self.grains.order]
            group = self.grains.group
            density = np.where(group >= 0, scene.aggregates.density, scene.aggregates.mortar.density)
        self.count = len(fluid)
        start = np.zeros_like(fluid)
        start[:, -1] = scene.velocity
        surface = self.layout.height - 0.5 * self.layout.spacing
        self.particles = allocate(
            self.structs.Particles,
            self.device,
            position=fluid,
            rounding=self.count,
            velocity=start,
            pressure=scene.concrete.density * scene.gravity * (surface - fluid[:, -1]),
            density=density,
            group=group,
        )
        self.flags = wp.zeros(FLAGS, dtype=wp.int32, device=device)
        self.grain_arrays = self._place_grains(fluid) if self.grains is not None else None

    def _place_grains(self, fluid: np.ndarray) -> Any:
        grains = self.grains
        assert grains is not None
        # The device arrays may have lower precision than the layout. Read the rounded positions back, so that the
        # particles' offsets from their grain's centre agree with them.
        place = self.particles.position.numpy().astype(float)
        middle = np.stack([place[a:b].mean(0) for a, b in zip(grains.first[:-1], grains.first[1:])])
        offset = place[: grains.first[-1]] - middle[grains.group[: grains.first[-1]]]
        return allocate(
            self.structs.Grains,
            self.device,
            first=grains.first,
            offset=offset,
            middle=middle,
            middle_rounding=grains.count,
            step=grains.count,
            spin=grains.count,
            centre=grains.count,
            inverse_inertia=grains.count,
            mobility=grains.count,
            spin_mobility=grains.count,
            turn=np.tile(np.eye(self.scene.dimensions), (grains.count, 1, 1)),
        )

    @property
    def particle_spacing(self) -> float:
        """Distance between neighbouring particles at the start [m]."""
        return self.layout.spacing

    @property
    def mass(self) -> float:
        """Mass of all fluid particles [kg], or per metre of depth [kg/m] in two dimensions."""
        if self.grains is None:
            return self.scene.concrete.density * self.layout.volume * self.count
        return float(self.particles.density.numpy().sum(dtype=float)) * self.layout.volume

    def state_dict(self) -> dict[str, np.ndarray]:
        """Return the arrays that the next step depends on, without the neighbour lists."""
        arrays = {name: host_copy(getattr(self.particles, name)) for name in PARTICLE_ARRAYS}
        arrays["flags"] = host_copy(self.flags)
        if self.grain_arrays is not None:
            arrays |= {f"grain_{name}": host_copy(getattr(self.grain_arrays, name)) for name in GRAIN_ARRAYS}
        return arrays

    def load_state_dict(self, found: dict[str, np.ndarray]) -> None:
        """Restore the state from a `state_dict`."""
        for name in PARTICLE_ARRAYS:
            getattr(self.particles, name).assign(found[name])
        self.flags.assign(found["flags"])
        for name in GRAIN_ARRAYS if self.grain_arrays is not None else ():
            getattr(self.grain_arrays, name).assign(found[f"grain_{name}"])


PARTICLE_ARRAYS = ("position", "rounding", "velocity", "pressure")
GRAIN_ARRAYS = ("turn", "middle", "middle_rounding")
"""Names of the arrays on which the next step depends: PARTICLE_ARRAYS for particles, GRAIN_ARRAYS for grains."""


def flow_numbers(state: FluidState, *, skin: float, correction: float) -> Any:
    """Return the struct of constants of a flow for the kernels.

    `skin` is the distance by which the neighbour lists reach beyond the range of the differential operators, in
    particle spacings. `correction` is the fraction of the density error that one step removes.
    """
    scene = state.scene
    flow = flow_struct(state.scalar)()
    layout = state.layout
    l0 = layout.spacing
    fluid = scene.aggregates.mortar if scene.aggregates is not None else scene.concrete
    values = dict(
        count=state.count,
        spacing=l0,
        cutoff=OPERATOR_REACH * l0,
        wide=DENSITY_REACH * l0,
        lattice_number=_sum_at_start(layout, OPERATOR_REACH, _weight),
        lattice_density=_sum_at_start(layout, DENSITY_REACH, _density_weight) + 1.0,
        radius=scene.radius,
        loss_limit=1.5 * layout.height,
        piston_speed=scene.velocity,
        gravity=scene.gravity,
        dt=scene.time_step,
        density=scene.concrete.density,
        viscosity=fluid.viscosity,
        flow_index=fluid.flow_index,
        quadratic_viscosity=fluid.quadratic_viscosity,
        yield_stress=fluid.yield_stress,
        regularisation=scene.regularisation,
        slip_viscosity=scene.concrete.slip_viscosity,
        slip_yield=scene.concrete.slip_yield,
        slip_index=scene.concrete.slip_flow_index,
        slip_quadratic=scene.concrete.slip_quadratic_viscosity,
        correction=correction,
        skin=skin * l0,
    )
    for name, value in values.items():
        setattr(flow, name, value)
    return flow


def _weight(q: np.ndarray) -> np.ndarray:
    return 1 / q - 1


def _density_weight(q: np.ndarray) -> np.ndarray:
    return (1 - q) ** 4 * (4 * q + 1)


def _sum_at_start(layout: Layout, reach: float, weight: Callable[[np.ndarray], np.ndarray]) -> float:
    """Return the initial sum of the weights of a particle's neighbours within `reach` particle spacings.

    The sum is averaged over the fluid particles of a layer at mid-height. The function `weight` takes the distances of
    neighbours, divided by the reach.
    """
    everything = np.concatenate([layout.fluid, layout.wall])
    middle = layout.fluid[np.argmin(np.abs(layout.fluid[:, -1] - 0.5 * layout.height)), -1]
    layer = layout.fluid[np.abs(layout.fluid[:, -1] - middle) < 1e-6 * layout.spacing]
    layer = layer[:: -(-len(layer) // 1000)]
    near = everything[np.abs(everything[:, -1] - middle) < reach * layout.spacing]
    parts = np.array_split(layer, -(-len(layer) // 50))
    q = np.concatenate([np.linalg.norm(part[:, None] - near, axis=2).ravel() for part in parts])
    q = q[(q > 0) & (q < reach * layout.spacing)] / (reach * layout.spacing)
    return float(np.sum(weight(q))) / len(layer)
