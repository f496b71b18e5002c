"""State of a flow on a grid: its particles, and what lies on the grid."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from ...core.device import MEMORY_FRACTION, memory_free, scalar_of
from ...core.errors import CapacityError
from ...kernels.common.control import FLAGS
from ...kernels.mps.grid.cells import BIN, DRIVE, FORCE, INSIDE, cells_struct, grid_structs
from .layout import NONE, GridLayout

PARTICLE_ARRAYS = ("position", "velocity", "gradient", "pressure", "mass")
MESH_ARRAYS = ("solid", "velocity", "pressure", "in_cell", "in_corner", "stress", "drive")
"""What the next step depends on."""
ROWS = {"bin": int(BIN), "traction": 4, "growth": 4, "slip": 4, "velocity": 2, "start": 2, "volume": 2, "shift": 2}
"""Entries for each slot of the grid, of arrays of the mesh that have more than one."""
SLOT_BYTES = 4 * (int(BIN) + 210)
"""Of a cell with its faces, its rows of the systems and nine particles, in single precision."""


class GridState:
    """Everything that changes in a flow on a grid.

    `scene` has the concrete, gravity, time step and regularisation. Arrays, with meaning, unit and shape, are those of
    the structs in `kernels/mps/grid/cells.py`.
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

    def __init__(self, scene: Any, layout: GridLayout, device: Any, precision: str) -> None:
        self.scene, self.layout, self.device, self.scalar = scene, layout, device, scalar_of(precision)
        self.shape, self.count = layout.shape, len(layout.fluid)
        self.slots = self.shape[0] * self.shape[1]
        self.structs = grid_structs(self.scalar)
        self.flags = wp.zeros(FLAGS, dtype=wp.int32, device=device)
        start = np.zeros_like(layout.fluid)
        start[:, 1] = layout.frame
        self.particles = self._filled(
            self.structs.Particles, position=layout.fluid, velocity=start, mass=layout.mass, gradient=self.count,
            pressure=self.count,
        )  # fmt: skip
        drive = np.zeros(DRIVE)
        drive[int(FORCE)] = layout.drive
        full = np.zeros(self.shape, np.int32)  # as a periodic pipe stays
        if layout.periodic:
            full[1:-1, 1:-1] = layout.solid[1:-1, 1:-1] == NONE
        full = full.ravel()
        own = {
            "solid": layout.solid.ravel(), "kind": np.full(2 * self.slots, int(INSIDE)), "drive": drive,
            "opens": layout.opens.ravel(), "fill": full, "liquid": full,
        }  # fmt: skip
        counts = {name: ROWS.get(name, 1) * self.slots for name in self.structs.Mesh.vars}
        self.mesh = self._filled(self.structs.Mesh, **counts | own)
        viscosity, yield_stress = layout.slip
        self.walls = self._filled(
            self.structs.Walls,
            velocity=np.zeros((4, 2)),
            slip_viscosity=np.array([-1.0, viscosity, -1.0, -1.0]),
            slip_yield=np.array([0.0, yield_stress, 0.0, 0.0]),
        )

    def _filled(self, struct: Any, **arrays: Any) -> Any:
        """A struct of arrays: of host data, or of zeros."""
        made = struct()
        for name, value in arrays.items():
            dtype = struct.vars[name].type.dtype
            make = wp.zeros if isinstance(value, int) else wp.array
            setattr(made, name, make(value, dtype=dtype, device=self.device))
        return made

    @property
    def mark_spacing(self) -> float:
        """Distance of particles at the start [m]."""
        return self.layout.mark_spacing

    def faces(self, name: str) -> np.ndarray:
        """An array of the mesh that has rows for u and w, shape (2, nz + 2, nx + 2), in double precision."""
        return getattr(self.mesh, name).numpy().astype(float).reshape(2, *self.shape)

    def cells(self, name: str) -> np.ndarray:
        """An array of the mesh that has a row for each cell, shape (nz, nx), in double precision."""
        return getattr(self.mesh, name).numpy().astype(float).reshape(self.shape)[1:-1, 1:-1]

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


def check_memory(cells: tuple[int, int], device: Any, precision: str) -> None:
    """Raise :class:`CapacityError` if a grid of so many cells will not fit."""
    slots = (cells[0] + 2) * (cells[1] + 2)
    needed = slots * SLOT_BYTES * wp.types.type_size_in_bytes(scalar_of(precision)) / 4
    free = memory_free(device)
    if needed > MEMORY_FRACTION * free:
        raise CapacityError(
            f"cells = {slots}: need about {needed / 2**30:.3g} GiB on {device}, which has {free / 2**30:.3g} GiB "
            "free; take a coarser spacing, or a device with more memory"
        )


def grid_numbers(state: GridState) -> Any:
    """Struct of a grid's numbers for the kernels."""
    scene, layout, concrete = state.scene, state.layout, state.scene.concrete
    g = cells_struct(state.scalar)()
    values = dict(
        nx=layout.cells[0],
        nz=layout.cells[1],
        slots=state.slots,
        dx=layout.spacing,
        dz=layout.step,
        left=layout.left,
        frame=layout.frame,
        gravity=scene.gravity,
        dt=scene.time_step,
        density=concrete.density,
        viscosity=concrete.viscosity,
        yield_stress=concrete.yield_stress,
        regularisation=scene.regularisation,
        volume=layout.volume,
        resistance=layout.resistance,
    )
    for name, value in values.items():
        setattr(g, name, value)
    return g
