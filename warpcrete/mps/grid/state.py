"""State of a flow on a grid: its particles, and arrays on cells, faces and edges."""

import math
from typing import Any

import numpy as np
import warp as wp

from ...core.device.arrays import host_copy
from ...core.device.device import MEMORY_FRACTION, memory_free, parallel, scalar_of
from ...core.errors import CapacityError
from ...kernels.common.control import FLAGS
from ...kernels.mps.grid.cells import CLOCK, DRIVE, DT, FORCE, INSIDE, WANTED, grid_parameters_struct, grid_structs
from ...kernels.mps.grid.columns import LANES, column_count
from ..common.allocation import allocate
from .geometry import NO_SLIP_VISCOSITY, NONE, ROUGH, Geometry
from .layout import GridLayout

PARTICLE_ARRAYS = ("position", "velocity", "gradient", "pressure", "mass")
MESH_ARRAYS = ("solid", "velocity", "pressure", "in_cell", "in_corner", "stress", "drive", "clock")
"""Names of the arrays on which the next step depends. PARTICLE_ARRAYS belong to the particles, and MESH_ARRAYS to
cells, faces and edges."""
SURFACE_ARRAYS = ("pressure_change",)
"""Names of further arrays of the struct `Fields` on which the next step depends if the concrete has a free surface."""
STRUCTURE_ARRAYS = ("gained", "layer")
"""Names of further arrays of the struct `Fields` on which the next step depends if the concrete is thixotropic."""
FACE_ARRAYS = ("kind", "velocity", "start", "volume", "wall_area", "traction", "traction_slope", "slip", "shift")
"""Names of the arrays of the struct `Fields` with one entry per face. The names in EDGE_ARRAYS belong to arrays with
one entry per edge, and the names in PARTICLE_LISTS to arrays with one entry per particle. Most other arrays of the
struct have one entry per cell."""
EDGE_ARRAYS = ("in_corner", "strain_without_pair")
PARTICLE_LISTS = ("cell_of_particle", "place", "sorted_particles", "sorted_place")
GPU_LISTS = ("sorted_place", "sorted_motion")
"""Names of the arrays that hold sorted copies of the particles on a GPU. On a CPU these arrays are empty, because a
CPU uses the array `columns` of the struct `Fields` instead."""
SLOT_BYTES = {2: 4 * 359, 3: 4 * 654}
"""Memory per cell, including its faces, its particles and its rows of the linear systems [bytes], in single precision,
by number of axes. The number holds for full cells, with nine particles each in two dimensions and eight in three. In
two dimensions, a CPU needs 8 % less."""

FIRST_STEP_RATIO = 0.01
"""Length of the first step, divided by the longest allowed one, if the length of time steps adapts to the flow."""


class GridState:
    """State of a flow on a grid: all arrays that change in a run.

    `scene` supplies concrete, gravity, time step and regularisation. The structs in `kernels/mps/grid/cells.py` give
    meaning, unit and shape of the arrays.
    """

    flags: wp.array
    """Control flags, such as the number of completed steps. The constants in `kernels/common/control.py` are the
    indices of this array, shape (FLAGS,)."""
    particles: Any
    """Position, velocity, velocity gradient, pressure and mass of each particle: arrays in a struct `Particles`."""
    mesh: Any
    """Arrays on the cells, faces and edges of the grid, a struct `Fields`."""
    geometry: Any
    """Geometry of the walls as the next step uses it, a struct `Geometry`; the attribute `opened` holds the geometry
    that applies after the gate has opened."""
    walls: Any
    """Motions and slip layers of the walls, a struct `Walls`."""
    grains = None
    """Coarse aggregate; always None, because flows on a grid have no separate aggregate."""

    aggregates: Any = None
    """Arrays of rigid aggregates in a flow of :mod:`warpcrete.suspension`; None in other flows."""

    def __init__(self, scene: Any, layout: GridLayout, device: Any, precision: str) -> None:
        self.scene, self.layout, self.device, self.scalar = scene, layout, device, scalar_of(precision)
        self.has_surface = not (layout.periodic or layout.full)
        self.mesh_arrays = MESH_ARRAYS + (SURFACE_ARRAYS if self.has_surface else ())
        self.shape, self.count = layout.shape, len(layout.fluid)
        self.slots = int(np.prod(self.shape))
        self.structs = grid_structs(self.scalar, layout.axes)
        self.flags = wp.zeros(FLAGS, dtype=wp.int32, device=device)
        start = np.zeros_like(layout.fluid)
        start[:, -1] = layout.frame
        self.particles = allocate(
            self.structs.Particles, self.device, position=layout.fluid, velocity=start, mass=layout.mass,
            gradient=self.count, pressure=self.count,
        )  # fmt: skip
        drive = np.zeros(DRIVE)
        drive[int(FORCE)] = layout.drive
        clock = np.zeros(CLOCK)
        clock[[int(DT), int(WANTED)]] = scene.time_step * (FIRST_STEP_RATIO if scene.step_error else 1.0)
        # Mark the cells that are full at all times with 1: the open cells of a full pipe. All other cells get 0.
        full = np.zeros(self.shape, np.int32)
        if not self.has_surface:
            inner = (slice(1, -1),) * layout.axes
            full[inner] = layout.solid[inner] == NONE
        full = full.ravel()
        own = {
            "solid": layout.solid.ravel(),
            "drive": drive,
            "clock": clock,
            "fill": full,
            "liquid": full,
            "kind": np.full(layout.axes * self.slots, int(INSIDE)),
        }
        if layout.kind.thixotropic:
            own |= {
                "gained": np.full(self.slots, layout.gained),
                "layer": np.full(layout.axes * self.slots, layout.gained),
            }
            self.mesh_arrays += STRUCTURE_ARRAYS
        rows = {name: self._rows(name) for name in self.structs.Fields.vars}
        self.mesh = allocate(self.structs.Fields, self.device, **rows | own)
        self.geometry = self._geometry(layout.geometry)
        self.opened = self._geometry(layout.opened)
        self.solid_after = wp.array(
            (layout.opened.solid if layout.opened else np.zeros(0)).ravel(), dtype=wp.int32, device=device
        )
        viscosity, yield_stress = layout.slip
        index, quadratic = (
            [plain, own if layout.slips else plain, plain, plain, own if layout.rough_slips else plain]
            + [plain] * len(layout.motions)
            for plain, own in ((1.0, scene.concrete.slip_flow_index), (0.0, scene.concrete.slip_quadratic_viscosity))
        )
        none, moving = np.zeros(layout.axes), layout.motions
        self.walls = allocate(
            self.structs.Walls,
            self.device,
            velocity=np.array([none] * (ROUGH + 1) + [m.velocity for m in moving]),
            spin=np.array([np.zeros(3)] * (ROUGH + 1) + [m.spin for m in moving]),
            pivot=np.array([none] * (ROUGH + 1) + [none if m.pivot is None else m.pivot for m in moving]),
            slip_viscosity=np.array(
                [-1.0, viscosity, -1.0, -1.0, layout.rough[0]]
                + [-1.0 if m.smooth else NO_SLIP_VISCOSITY for m in moving]
            ),
            slip_yield=np.array([0.0, yield_stress, 0.0, 0.0, layout.rough[1]] + [0.0] * len(moving)),
            slip_index=np.array(index),
            slip_quadratic=np.array(quadratic),
        )

    def _rows(self, name: str) -> int:
        """Return the number of entries of the array `name` of the struct `Fields`."""
        if name == "columns":
            return 0 if parallel(self.device) else column_count(self.layout.axes) * (self.count + LANES)
        if name in GPU_LISTS and not parallel(self.device):
            return 0
        if name in PARTICLE_LISTS:
            return self.count
        if name == "sorted_motion":
            return self.layout.axes * self.count
        if name == "reserved_places":
            return 1
        if name in STRUCTURE_ARRAYS or (name in SURFACE_ARRAYS and not self.has_surface):
            return 0
        pushed = self.layout.axes**2 if self.layout.kind.cut else 0
        many = (
            {"wall_stiffness": pushed, "wall_force": pushed, "wall_weight": pushed}
            | dict.fromkeys(FACE_ARRAYS, self.layout.axes)
            | dict.fromkeys(EDGE_ARRAYS, self.layout.kind.pairs)
        )
        return many.get(name, 1) * self.slots

    def _geometry(self, found: Geometry | None) -> Any:
        """Return the struct `Geometry` of the walls for the kernels, with its arrays on the device.

        If `found` is None, no wall cuts a cell: all walls are sides of cells, and the arrays of cells, faces and edges
        are empty.
        """
        own = {"opens": self.layout.opens.ravel(), "inlet": self.layout.inlet.reshape(-1, self.layout.axes)}
        names = [name for name in self.structs.Geometry.vars if name not in own]
        given = {name: 0 if found is None else getattr(found, name).ravel() for name in names}
        return allocate(self.structs.Geometry, self.device, **given, **own)

    @property
    def particle_spacing(self) -> float:
        """Distance between neighbouring particles at the start [m]."""
        return self.layout.particle_spacing

    def faces(self, name: str) -> np.ndarray:
        """Return an array of the grid with one value per face, in double precision, shape (axes, *shape)."""
        return getattr(self.mesh, name).numpy().astype(float).reshape(-1, *self.shape)

    def cells(self, name: str) -> np.ndarray:
        """Return an array of the struct `Fields` or `Geometry` that has one entry per cell, in double precision.

        The layer of cells around the grid is left out, and the last axis comes first.
        """
        of = self.mesh if name in self.structs.Fields.vars else self.geometry
        whole = getattr(of, name).numpy().astype(float).reshape(self.shape)
        return whole[(slice(1, -1),) * self.layout.axes]

    def state_dict(self) -> dict[str, np.ndarray]:
        """Return the arrays that the next step depends on, by name, for a checkpoint."""
        arrays = {name: host_copy(getattr(self.particles, name)) for name in PARTICLE_ARRAYS}
        arrays |= {f"mesh_{name}": host_copy(getattr(self.mesh, name)) for name in self.mesh_arrays}
        return arrays | {"flags": host_copy(self.flags)}

    def load_state_dict(self, found: dict[str, np.ndarray]) -> None:
        """Restore the state from a `state_dict`."""
        for name in PARTICLE_ARRAYS:
            getattr(self.particles, name).assign(found[name])
        for name in self.mesh_arrays:
            getattr(self.mesh, name).assign(found[f"mesh_{name}"])
        self.flags.assign(found["flags"])


def check_memory(cells: tuple[int, ...], device: wp.Device, precision: str, more: int = 0) -> None:
    """Raise :class:`CapacityError` if a grid does not fit in the free memory of a device.

    `cells` is the number of cells along each axis. `more` is memory per cell that the flow needs in addition, for
    example for aggregates [bytes], in single precision.
    """
    slots = math.prod(n + 2 for n in cells)
    needed = slots * (SLOT_BYTES[len(cells)] + more) * wp.types.type_size_in_bytes(scalar_of(precision)) / 4
    free = memory_free(device)
    if needed > MEMORY_FRACTION * free:
        raise CapacityError(
            f"cells = {slots}: need about {needed / 2**30:.3g} GiB on {device}, which has {free / 2**30:.3g} GiB "
            "free; use a coarser spacing, or a device with more memory"
        )


def grid_numbers(state: GridState) -> Any:
    """Return the struct with the constants of a flow on a grid that kernels receive."""
    scene, layout, concrete = state.scene, state.layout, state.scene.concrete
    g = grid_parameters_struct(state.scalar, layout.axes)()
    down = [0.0] * (layout.axes - 1) + [0.0 if layout.weightless else -scene.gravity]
    values = dict(
        n=layout.cells,
        slots=state.slots,
        width=layout.room.width,
        origin=layout.room.origin,
        frame=layout.frame,
        gravity=down,
        density=concrete.density,
        viscosity=concrete.viscosity,
        flow_index=concrete.flow_index,
        quadratic_viscosity=concrete.quadratic_viscosity,
        yield_stress=concrete.yield_stress,
        regularisation=scene.regularisation,
        volume=layout.volume,
        inflow=layout.inflow or (0.0,) * layout.axes,
        resistance=layout.resistance,
    )
    for name, value in values.items():
        setattr(g, name, value)
    return g
