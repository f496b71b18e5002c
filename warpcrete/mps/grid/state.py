"""State of a flow on a grid: its particles, what lies on the grid, and where both start."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp

from ...core.device import MEMORY_FRACTION, memory_free, scalar_of
from ...core.errors import CapacityError
from ...kernels.common.control import FLAGS
from ...kernels.mps.grid.cells import BIN, DRIVE, FORCE, INSIDE, cells_struct, grid_structs
from ..scene import FluidScene
from ..theory import steady, velocity

ABREAST = 2
"""Particles of a cell across it, and as many along it."""
FINE = 40
"""Places in a cell over which theory's velocity is averaged."""
PIPE, AXIS = 1, 2
"""Numbers of walls."""
PARTICLE_ARRAYS = ("position", "velocity", "gradient", "pressure", "mass")
MESH_ARRAYS = ("velocity", "pressure", "in_cell", "in_corner", "stress", "drive")
"""What the next step depends on."""
SLOT_BYTES = 4 * (int(BIN) + 90)
"""Of a cell with its faces, its rows of both systems and its particles, in single precision, at most."""


@dataclass(frozen=True)
class GridLayout:
    """Places at the start."""

    cells: tuple[int, int]
    """Across and along."""
    spacing: float
    """Width of a cell [m]."""
    step: float
    """Height of a cell [m]."""
    left: float
    """Place of the left side: half a channel's width from the middle, or the axis [m]."""
    height: float
    """Of the stretch [m]."""
    fluid: np.ndarray
    """Particles, shape (n, 2), across from the middle or axis, and along [m]."""
    mass: np.ndarray
    """Of each over the mean, shape (n,)."""
    axial: bool


def cells_of(scene: FluidScene) -> tuple[int, int]:
    """Cells across and along, of the width nearest to the wanted spacing that divides a channel, or a tube's radius."""
    across = scene.radius if scene.dimensions == 3 else 2 * scene.radius
    nx = max(2, round(across / scene.spacing))
    return nx, max(2, round(scene.length * nx / across))


def grid_layout(scene: FluidScene) -> GridLayout:
    """Cells from wall to wall, or from the axis to the wall, and particles evenly in them."""
    axial = scene.dimensions == 3
    nx, nz = cells_of(scene)
    dx, dz = (scene.radius if axial else 2 * scene.radius) / nx, scene.length / nz
    left = 0.0 if axial else -scene.radius
    i, k = np.meshgrid((np.arange(nx * ABREAST) + 0.5) / ABREAST, (np.arange(nz * ABREAST) + 0.5) / ABREAST)
    fluid = np.stack([left + i.ravel() * dx, k.ravel() * dz], 1)
    mass = fluid[:, 0] / fluid[:, 0].mean() if axial else np.ones(len(fluid))
    return GridLayout((nx, nz), dx, dz, left, scene.length, fluid, mass, axial)


class GridState:
    """Everything that changes in a flow on a grid.

    Its arrays, with meaning, unit and shape, are those of the structs in `kernels/mps/grid/cells.py`.
    """

    flags: wp.array
    """Slots of `kernels/common/control.py`, shape (FLAGS,)."""
    particles: Any
    """A struct `Particles`."""
    mesh: Any
    """A struct `Mesh`."""
    walls: Any
    """A struct `Walls`."""
    grains = None
    """Coarse aggregate: there is none on a grid."""

    def __init__(self, scene: FluidScene, device: Any, precision: str) -> None:
        self.scene, self.device, self.scalar = scene, device, scalar_of(precision)
        nx, nz = cells_of(scene)
        self.shape = nz + 2, nx + 2
        self.slots = self.shape[0] * self.shape[1]
        self._check_memory()
        self.layout = grid_layout(scene)
        self.count = len(self.layout.fluid)
        self.structs = grid_structs(self.scalar)
        self.flags = wp.zeros(FLAGS, dtype=wp.int32, device=device)
        start = np.zeros_like(self.layout.fluid)
        start[:, 1] = scene.velocity
        self.particles = self._filled(
            self.structs.Particles, position=self.layout.fluid, velocity=start, mass=self.layout.mass,
            gradient=self.count, pressure=self.count,
        )  # fmt: skip
        sizes = {"bin": int(BIN), "traction": 4, "growth": 4, "slip": 4, "velocity": 2, "start": 2, "volume": 2}
        counts = {name: sizes.get(name, 1) * self.slots for name in self.structs.Mesh.vars}
        drive = np.zeros(DRIVE)
        drive[int(FORCE)] = scene.concrete.density * scene.gravity
        self.mesh = self._filled(
            self.structs.Mesh,
            **counts | {"solid": self._solid(), "kind": np.full(2 * self.slots, int(INSIDE)), "drive": drive},
        )
        concrete = scene.concrete
        self.walls = self._filled(
            self.structs.Walls,
            velocity=np.zeros((3, 2)),
            slip_viscosity=np.array([-1.0, concrete.slip_viscosity, -1.0]),
            slip_yield=np.array([0.0, concrete.slip_yield, 0.0]),
        )

    def _check_memory(self) -> None:
        needed = self.slots * SLOT_BYTES * wp.types.type_size_in_bytes(self.scalar) / 4
        free = memory_free(self.device)
        if needed > MEMORY_FRACTION * free:
            raise CapacityError(
                f"cells = {self.slots}: need about {needed / 2**30:.3g} GiB on {self.device}, which has "
                f"{free / 2**30:.3g} GiB free; take a coarser spacing, or a device with more memory"
            )

    def _filled(self, struct: Any, **arrays: Any) -> Any:
        """A struct of arrays: of host data, or of zeros."""
        made = struct()
        for name, value in arrays.items():
            dtype = struct.vars[name].type.dtype
            make = wp.zeros if isinstance(value, int) else wp.array
            setattr(made, name, make(value, dtype=dtype, device=self.device))
        return made

    def _solid(self) -> np.ndarray:
        """Walls on both sides of a channel, or around a tube, whose axis is a smooth one."""
        solid = np.zeros(self.shape, np.int32)
        solid[:, 0] = AXIS if self.layout.axial else PIPE
        solid[:, -1] = PIPE
        return solid.ravel()

    @property
    def mark_spacing(self) -> float:
        """Distance of particles at the start [m]."""
        return self.layout.spacing / ABREAST

    @property
    def mass(self) -> float:
        """Of all concrete [kg], or [kg/m] in two dimensions."""
        radius, length = self.scene.radius, self.layout.height
        section = math.pi * radius**2 if self.layout.axial else 2 * radius
        return self.scene.concrete.density * section * length

    @cached_property
    def theory_profile(self) -> np.ndarray:
        """Theory's velocity by distance from the middle or axis, over each cell's section as the grid's are [m/s]."""
        scene, layout = self.scene, self.layout
        nx = layout.cells[0]
        across = np.abs(layout.left + (np.arange(nx * FINE) + 0.5) * layout.spacing / FINE).reshape(nx, FINE)
        weight = across if layout.axial else np.ones_like(across)
        exact = velocity(scene.concrete, scene.line, scene.theory(), across.ravel()).reshape(nx, FINE)
        mean = (exact * weight).sum(1) / weight.sum(1)
        return mean[np.argsort(across.mean(1), kind="stable")]

    def faces(self, name: str) -> np.ndarray:
        """An array of the mesh that has rows for u and w, shape (2, nz + 2, nx + 2), in double precision."""
        return getattr(self.mesh, name).numpy().astype(float).reshape(2, *self.shape)

    def state_dict(self) -> dict[str, np.ndarray]:
        """Arrays that the next step depends on."""
        found = {name: getattr(self.particles, name).numpy() for name in PARTICLE_ARRAYS}
        found |= {f"mesh_{name}": getattr(self.mesh, name).numpy() for name in MESH_ARRAYS}
        return found | {"flags": self.flags.numpy()}

    def load_state_dict(self, found: dict[str, np.ndarray]) -> None:
        """Go on from a `state_dict`."""
        for name in PARTICLE_ARRAYS:
            getattr(self.particles, name).assign(found[name])
        for name in MESH_ARRAYS:
            getattr(self.mesh, name).assign(found[f"mesh_{name}"])
        self.flags.assign(found["flags"])


def grid_numbers(state: GridState) -> Any:
    """Struct of a grid's numbers for the kernels."""
    scene, layout = state.scene, state.layout
    concrete = scene.concrete
    g = cells_struct(state.scalar)()
    values = dict(
        nx=layout.cells[0],
        nz=layout.cells[1],
        slots=state.slots,
        dx=layout.spacing,
        dz=layout.step,
        left=layout.left,
        frame=scene.velocity,
        gravity=scene.gravity,
        dt=scene.time_step,
        density=concrete.density,
        viscosity=concrete.viscosity,
        yield_stress=concrete.yield_stress,
        regularisation=scene.regularisation,
        resistance=_resistance(scene),
    )
    for name, value in values.items():
        setattr(g, name, value)
    return g


def _resistance(scene: FluidScene) -> float:
    """By how much the wall's force per volume grows with the mean velocity in the steady state [kg/m3/s]."""
    little, flow = 1e-3, math.pi * scene.radius**2 * scene.velocity
    now, more = (steady(scene.concrete, scene.line, flow * (1 + part), scene.form) for part in (0.0, little))
    return (more.pressure - now.pressure) / (scene.length * little * scene.velocity)
