"""Verification of flows in vessels whose walls pass through cells of the grid (cut cells), against closed forms."""

from dataclasses import dataclass, replace

import numpy as np

from ..core.device.device import find_device
from ..geometry.axis import Axis, Line
from ..geometry.walls import PipeWall
from ..kernels.mps.grid.cells import LAST_FORCE, LIQUID, GridKind
from ..mps.free.scene import FreeScene
from ..mps.free.simulation import FreeSimulation
from ..mps.grid.distances import Distance, wall_distance
from ..mps.grid.filling import fill_cells
from ..mps.grid.flow import GridFlow
from ..mps.grid.geometry import OPEN_SIDE, PLATE, ROUGH, WALL, Room, geometry_of, nearest_wall
from ..mps.grid.layout import GridLayout, Motion
from ..mps.grid.state import NO_SLIP_VISCOSITY, GridState
from ..theory.pipe import Concrete
from .case import Case, Row

PASTE = Concrete(density=2000.0, viscosity=20.0, yield_stress=0.0, slip_viscosity=NO_SLIP_VISCOSITY, slip_yield=0.0)
INNER, OUTER, TURNS = 0.05, 0.1, 1.0
"""Radii of the inner and outer cylinder [m], and angular velocity of the inner cylinder [rad/s]."""
RADIUS, SPEED = 0.05, 0.19
"""Radius of the round pipe [m], and mean velocity of the flow in it [m/s]."""
COUETTE_ERROR = "rms error of the velocity, divided by the speed of the wall"
"""Name of the quantity that the cases of flows between two cylinders compare."""


@dataclass(frozen=True)
class _Paste:
    """Replacement for a scene, with the constants of the paste and the settings that a flow on a grid reads."""

    concrete: Concrete
    time_step: float
    gravity: float = 0.0
    regularisation: float = 1e4
    tolerance: float = 1e-3
    maximum_iterations: int = 5000
    step_error: float = 0.0


def _filled(room: Room, walls: list[tuple[Distance, int]], abreast: int) -> dict:
    """Return keyword arguments of a grid layout in which concrete fills the part of a `room` that no wall occupies.

    `abreast` is the initial number of particles along each axis in a cell that is full of concrete.
    """
    geometry, nearest = geometry_of(room, walls), nearest_wall(room, walls)
    places, mass = fill_cells(room, abreast, lambda points: nearest(points)[0] > 0)
    return {
        "room": room, "geometry": geometry, "solid": geometry.solid, "fluid": places, "mass": mass,
        "particle_spacing": room.width[0] / abreast, "slip": (NO_SLIP_VISCOSITY, 0.0),
    }  # fmt: skip


def between_cylinders(
    device: str, precision: str, cells: int, layers: tuple[float, float] = (NO_SLIP_VISCOSITY, NO_SLIP_VISCOSITY)
) -> GridFlow:
    """Return the flow of paste between a rotating inner cylinder and an outer cylinder at rest, on a Cartesian grid.

    The grid has `cells` cells along each axis. `layers` are the viscous constants of the slip layers on the inner and
    the outer cylinder [Pa s/m].
    """
    h = 0.22 / cells
    room = Room((cells, cells), (h, h), (-0.1069, -0.1083), ((WALL, WALL), (WALL, WALL)))
    walls: list[tuple[Distance, int]] = [
        (lambda x: OUTER - np.linalg.norm(x, axis=1), PLATE),
        (lambda x: np.linalg.norm(x, axis=1) - INNER, ROUGH + 1),
    ]
    layout = GridLayout(
        kind=GridKind(2, cut=True), speed=TURNS * INNER, length=INNER, full=True,
        motions=(Motion((0.0, 0.0), (0.0, TURNS, 0.0)),), **_filled(room, walls, 3),
    )  # fmt: skip
    state = GridState(_Paste(PASTE, 5e-3), layout, find_device(device), precision)
    slips = state.walls.slip_viscosity.numpy()
    slips[ROUGH + 1], slips[PLATE] = layers
    state.walls.slip_viscosity.assign(slips)
    return GridFlow(state)


def couette_error(flow: GridFlow, layers: tuple[float, float] = (NO_SLIP_VISCOSITY, NO_SLIP_VISCOSITY)) -> float:
    """Return the rms error of the velocity between the cylinders, divided by the speed of the inner wall.

    The exact velocity at the distance r from the axis is u = a r + b / r. The constants a and b follow from the
    conditions at both walls. The shear stress of a fluid with the viscosity mu is 2 mu b / r^2. At a wall, this stress
    divided by the viscous constant of the slip layer is the slip velocity.
    """
    slips = [2 * PASTE.viscosity / (radius**2 * layer) for radius, layer in zip((INNER, OUTER), layers)]
    a, b = np.linalg.solve([[INNER, 1 / INNER + slips[0]], [OUTER, 1 / OUTER - slips[1]]], [TURNS * INNER, 0.0])
    velocity, kinds, errors = flow.state.faces("velocity"), flow.state.faces("kind"), []
    for axis in range(2):
        shift = [0.5, 0.5]
        shift[axis] = 0.0
        place = flow.state.layout.room.places(shift).transpose(1, 0, 2)
        radius = np.linalg.norm(place, axis=-1)
        turn = place[..., 1] if axis == 0 else -place[..., 0]
        exact = (a * radius + b / radius) * turn / radius
        errors.append((velocity[axis] - exact)[kinds[axis] == int(LIQUID)])
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) / (TURNS * INNER)


def cylinders(device: str, precision: str) -> list[Row]:
    """Compare the flow between a rotating and a fixed cylinder with the closed form, on three grids."""
    rows = []
    # The measured rms errors of the velocity, divided by the speed of the inner wall, are 0.93, 0.31 and 0.12 % on the
    # three grids.
    for cells, allowed in ((22, 0.011), (44, 0.004), (88, 0.0015)):
        flow = between_cylinders(device, precision, cells)
        flow.take(200)
        name = f"{INNER / flow.state.layout.spacing:.0f} cells across the gap: {COUETTE_ERROR}"
        rows.append(Row(name, couette_error(flow), 0.0, allowed, scale=1.0))
    return rows


def cylinders_with_layers(device: str, precision: str) -> list[Row]:
    """Compare the flow between two cylinders with theory, for walls with slip layers.

    The slip velocity at a wall reaches more than half of the inner cylinder's speed.
    """
    rows = []
    # Measured rms errors of the velocity, divided by the speed of the inner wall, on the coarse and the fine grid:
    # - first pair of layers: 0.40 and 0.20 %,
    # - second pair: 0.37 and 0.36 %,
    # - third pair: 0.77 and 1.02 %.
    for layers, allowed in (
        ((400.0, NO_SLIP_VISCOSITY), 0.005),
        ((200.0, 200.0), 0.005),
        ((NO_SLIP_VISCOSITY, 200.0), 0.012),
    ):
        for cells in (22, 44):
            flow = between_cylinders(device, precision, cells, layers)
            flow.take(300)
            words = [f"{layer:g} Pa s/m" if layer < NO_SLIP_VISCOSITY else "sticks" for layer in layers]
            across = INNER / flow.state.layout.spacing
            name = f"inner {words[0]}, outer {words[1]}, {across:.0f} cells: {COUETTE_ERROR}"
            rows.append(Row(name, couette_error(flow, layers), 0.0, allowed, scale=1.0))
    return rows


def round_pipe(device: str, precision: str, cells: int, yield_stress: float) -> GridFlow:
    """Return the flow in a periodic round pipe, on a three-dimensional grid that is `cells` cells wide.

    The paste has the yield stress `yield_stress` [Pa]. The grid is a tenth wider than the pipe, and the pipe's axis
    does not lie in the middle of the grid.
    """
    h = 2.2 * RADIUS / cells
    room = Room((cells, cells, 2), (h,) * 3, (-1.1 * RADIUS + 0.13 * h, -1.1 * RADIUS - 0.21 * h, 0.0),
                ((WALL, WALL), (WALL, WALL), (OPEN_SIDE, OPEN_SIDE)))  # fmt: skip
    pipe = PipeWall(name="pipe", axis=Axis((0.0, 0.0, -1.0), (0.0, 0.0, 1.0), (Line(2.0),)), radius=RADIUS)
    resistance = 8 * PASTE.viscosity / RADIUS**2
    layout = GridLayout(
        kind=GridKind(3, periodic=True, cut=True), speed=SPEED, length=RADIUS, frame=SPEED, drive=resistance * SPEED,
        resistance=resistance, **_filled(room, [(wall_distance(pipe, np.zeros(3)), ROUGH)], 2),
    )  # fmt: skip
    paste = _Paste(replace(PASTE, yield_stress=yield_stress), 1e-3)
    return GridFlow(GridState(paste, layout, find_device(device), precision))


def pipe_gradient(yield_stress: float) -> float:
    """Return the pressure gradient of the round pipe according to Buckingham and Reiner [Pa/m].

    The paste has the yield stress `yield_stress` [Pa].
    """
    # Find the stress at the wall by bisection. The mean velocity that the formula of Buckingham and Reiner gives for
    # this stress must equal `SPEED`.
    low, high = yield_stress, 1e5
    for _ in range(100):
        stress = 0.5 * (low + high)
        x = yield_stress / stress
        slow = RADIUS * stress / (4 * PASTE.viscosity) * (1 - 4 / 3 * x + x**4 / 3) < SPEED
        low, high = (stress, high) if slow else (low, stress)
    return 2 * high / RADIUS


def pipe_in_space(device: str, precision: str) -> list[Row]:
    """Compare the pressure gradient in a round pipe without slip with theory, for Bingham numbers of 0, 1 and 10.

    The pipe is 20 cells wide.
    """
    rows = []
    # The measured errors of the pressure gradient are -0.66, -0.49 and -0.71 % for the Bingham numbers 0, 1 and 10.
    for number in (0.0, 1.0, 10.0):
        yield_stress = number * PASTE.viscosity * SPEED / RADIUS
        flow = round_pipe(device, precision, 22, yield_stress)
        flow.take(250)
        ours = float(flow.mesh.drive.numpy()[int(LAST_FORCE)])
        rows.append(Row(f"Bn {number:g}: pressure per length", ours, pipe_gradient(yield_stress), 8e-3, "Pa/m"))
    return rows


def tilted_vessel(**given) -> FreeScene:
    """Return the scene of a vessel with two slanted sides that cross the grid's cells, filled up to 0.2 m.

    The keywords `given` replace arguments of the scene.
    """
    left = ((-0.5, -0.5), (0.6, -0.5), (0.17, 0.013), (0.03, 0.5), (-0.5, 0.5))
    right = ((0.17, 0.013), (0.6, -0.5), (0.6, 0.5), (0.37, 0.5))
    return FreeScene(**{
        "name": "tilted vessel", "concrete": replace(PASTE, viscosity=10.0), "axial": False,
        "width": 0.4, "height": 0.3, "spacing": 0.01, "blocks": (left, right), "duration": 0.5,
        "outline": ((-1.0, -1.0), (1.0, -1.0), (1.0, 0.2), (-1.0, 0.2)), "sample_interval": 0.05, "tolerance": 1e-5,
    } | given)  # fmt: skip


def rest(device: str, precision: str) -> list[Row]:
    """Compare a Newtonian fluid at rest in a vessel with slanted sides with hydrostatics, in 2D and 3D."""
    rows = []
    for depth, name in ((0.0, "plane"), (0.05, "space")):
        simulation = FreeSimulation(tilted_vessel(depth=depth), device=device, precision=precision)
        run = simulation.run()
        state = simulation.state
        pressure = state.cells("pressure")
        place = (np.arange(state.layout.cells[-1]) + 0.5) * state.layout.step
        exact = np.broadcast_to((2000 * 9.81 * (0.2 - place)).reshape(-1, *[1] * (pressure.ndim - 1)), pressure.shape)
        # Leave out cells of which only a small part is open: their pressure does not belong to the cell's centre, for
        # which the exact pressure is computed.
        full = (state.cells("fill") == 1) & (exact > 2000 * 9.81 * 0.02) & (state.cells("room") > 0.25)
        off = float(np.abs(pressure - exact)[full].max())
        rows += [
            # Measured errors in a plane: 5e-4 of the pressure at the bottom, 0.06 mm/s of mean speed, and 0.09 % of the
            # volume. In space: 1.5e-3 of the pressure at the bottom, 0.17 mm/s of mean speed, and 0.14 % of the volume.
            Row(
                f"{name}: largest error of the pressure, divided by the pressure at the bottom",
                off / exact.max(),
                0.0,
                2e-3,
                scale=1.0,
            ),
            Row(f"{name}: speed, mean", float(run.series["mean_speed"][-1]), 0.0, 2e-4, "m/s", scale=1.0),
            Row(f"{name}: volume", 1 + run.result["volume_error"], 1.0, 2e-3),
        ]
    return rows


CASES = [
    Case("flow between cylinders, walls through cells", "Couette", cylinders, "flows"),
    Case("slip layers on walls through cells", "Couette", cylinders_with_layers, "flows"),
    Case("round pipe in three dimensions, walls through cells", "Buckingham and Reiner", pipe_in_space, "flows"),
    Case("rest in a tilted vessel", "hydrostatics", rest, "flows"),
]
