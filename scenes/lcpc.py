"""LCPC box: how far six litres of concrete spread along a box (Roussel 2007), as a 3D flow on a grid.

The file holds the test and its scenes for both methods: a flow (`scene`) and discrete elements (`scene_dem`).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

from warpcrete.core.errors import at_most, refuse
from warpcrete.core.inputs.knobs import Knob, Trading
from warpcrete.core.inputs.parameters import Above, OneOf, Within
from warpcrete.core.inputs.scene_functions import scene_function
from warpcrete.core.run.method import Quantity
from warpcrete.dem.pumping.vessel_checks import check_vessel, vessel_knobs, vessel_remarks
from warpcrete.dem.pumping.vessels import VesselParameters
from warpcrete.dem.scene.scene import Scene
from warpcrete.geometry.prisms import prism, rectangle
from warpcrete.geometry.walls import MeshWall, PlaneWall, Prescribed, Wall
from warpcrete.mps.common.settings import STEP_ERROR
from warpcrete.mps.free.checks import check_flow
from warpcrete.mps.free.knobs import free_knobs, free_variants
from warpcrete.mps.free.scene import FreeConcrete, FreeScene
from warpcrete.standards import ClosedForm, Outcome, Specimen, StandardTest
from warpcrete.standards.standard_test import Sizes
from warpcrete.theory.vessels import box_at_rest, box_yield_stress

NEAR_END = 0.05
"""Length of the stretch at the near end of the LCPC box, where the concrete starts, over which its depth is averaged
[m]."""
AT_THE_END = 0.02
"""Distance from the far end of the LCPC box [m] within which concrete counts as having reached this end, so that the
end wall holds it back."""
THICK = 2.5
"""Thickness of the LCPC box's gate, in cells of the flow's grid."""
ABOVE = 3
"""Height of the simulated space above the LCPC box, in cells of the flow's grid."""
VOLUME = 0.06
"""Largest accepted numerical error of the volume below the free surface, as a fraction of the concrete's volume. With
cells of 20 mm, measured errors reach 0.040."""
POURED = "concrete is not poured: it stands behind a gate at one end, which is lifted slowly"


def _measure(concrete: Specimen, size: Sizes) -> dict[str, float]:
    near = concrete.depth(0.0, NEAR_END, size["width"])
    return {"near_depth": near, "front": max(concrete.front(), size["column_length"])}


def _at_rest(k: Outcome, place: int) -> float | None:
    """Return a theoretical dimension of the concrete at rest in the LCPC box [m]: a depth or the covered length.

    A `place` of 0 selects the depth at the near end, 1 the depth at the far end, and 2 the length that concrete covers.
    The result is None for concrete so stiff that it would rest deeper than the column in which it starts.
    """
    found = box_at_rest(k.whole, k.size["length"], k.size["width"], k.concrete.yield_stress, k.density, k.gravity)
    return found[place] if found[0] < k.whole / (k.size["column_length"] * k.size["width"]) else None


def _yield_stress(k: Outcome) -> float | None:
    """Return the yield stress [Pa] that follows from the length over which the concrete has spread.

    The result is None if the concrete is still within the length of its column, if it has reached the far end, if its
    weight is not known, or if it would rest deeper than its column.
    """
    reach = k.last("front")
    if not k.size["column_length"] < reach <= k.size["length"] - AT_THE_END or not k.density * k.whole:
        return None
    found = box_yield_stress(reach, k.whole, k.size["width"], k.density, k.gravity)
    near = box_at_rest(k.whole, k.size["length"], k.size["width"], found, k.density, k.gravity)[0]
    return found if near < k.whole / (k.size["column_length"] * k.size["width"]) else None


LCPC_BOX = StandardTest(
    name="lcpc",
    dimensions=("column_length", "length", "width"),
    columns={"near_depth": "m", "front": "m"},
    measure=_measure,
    quantities=(
        Quantity("spread_length", "m", lambda k: k.last("front"), "spread length", None, True,
                 meaning="Length to which the concrete has spread along the box"),
        Quantity("h0", "m", lambda k: k.last("near_depth"), "depth where poured", None, True,
                 meaning="Depth of the concrete at the end where it is poured"),
        Quantity("apparent_yield_stress", "Pa", _yield_stress, "yield stress from L", None, True,
                 meaning="Yield stress that the closed form of the test gives for the measured spread length"),
    ),
    forms=(
        ClosedForm("spread_length", "theory", "slow flow", lambda k: _at_rest(k, 2)),
        ClosedForm("h0", "theory", "slow flow", lambda k: _at_rest(k, 0)),
        ClosedForm("apparent_yield_stress", "given", "given", lambda k: k.concrete.yield_stress),
    ),
    in_space=True,
    curves={"front": "position of the front", "near_depth": "depth where poured"},
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class LongBox:
    """Dimensions of the LCPC box; defaults follow Roussel (2007), with 6 litres of concrete."""

    column_length: Annotated[
        float,
        "Length of the concrete at the start, when it fills the box behind the gate to its full height [m]",
        Above(),
    ] = 0.2
    length: Annotated[float, "Inner length of the box [m]", Above()] = 1.2
    width: Annotated[float, "Inner width of the box [m]", Above()] = 0.2
    height: Annotated[float, "Inner height of the box [m]", Above()] = 0.15
    lift_time: Annotated[float, "Duration of lifting the gate by the height of the box [s]", Above()] = 5.0

    def check_length(self) -> None:
        """Raise :class:`SceneError` if the LCPC box is too short for the concrete to spread."""
        if self.length < self.column_length + 0.1:
            refuse("length", self.length, "must exceed the length of the concrete at the start, "
                                          f"{self.column_length:g} m, by at least 0.1 m",
                   f"use {self.column_length + 0.3:g} m or more")  # fmt: skip


# The following definitions belong to the scene that simulates the LCPC box as a flow.


@dataclass(frozen=True, kw_only=True)
class LongBoxFlow(LongBox, FreeConcrete):
    """Condition on the walls of the LCPC box, and edge length of the cells."""

    surfaces: Annotated[str, "Condition on all walls: concrete sticks, or slips on its slip layer",
                        OneOf(("sticks", "slips"))] = "sticks"  # fmt: skip
    spacing: Annotated[float, "Edge length of the cells [m]", Above()] = 0.0125
    # The default error of a step is larger than in other scenes. Concrete that trickles out below a slow gate changes
    # its speed all the time, so that with an allowed error of 1e-3 the steps would be only microseconds long.
    step_error: Annotated[float, STEP_ERROR, Within(0, 0.5)] = 1e-2


@scene_function(LongBoxFlow)
def scene(parameters: LongBoxFlow) -> FreeScene:
    """Model concrete that spreads slowly along the LCPC box, a test from whose result the yield stress follows.

    The results are the spread length, the depth and the yield stress. Half of the box is simulated. The concrete is not
    poured; it stands behind a gate at one end, and the gate is lifted slowly and without friction.

    Raises :class:`warpcrete.SceneError` for parameters that cannot be simulated.
    """
    given = parameters
    given.check_length()
    smallest = min(given.column_length, given.height, given.width / 2)
    if given.spacing > smallest / 4:
        problem = "is too coarse: at least four cells must fit across the concrete and across half the box"
        refuse("spacing", given.spacing, problem, f"use {at_most(smallest / 4)} m or less")
    # Choose the cell size such that the height of the concrete is a whole number of cells, so that the cells hold its
    # full volume.
    gate, top, rows = given.column_length, given.height, round(given.height / given.spacing)
    cell = top / rows
    thick, high = THICK * cell, cell * (rows + ABOVE)
    shut = ((gate, -thick), (gate + thick, -thick), (gate + thick, 2 * high), (gate, 2 * high))
    return FreeScene(
        name="lcpc",
        test=LCPC_BOX,
        concrete=given.make_concrete(given.surfaces == "slips"),
        axial=False,
        width=given.length,
        depth=given.width / 2,
        height=high,
        spacing=cell,
        outline=((-thick, 0.0), (gate, 0.0), (gate, top), (-thick, top)),
        sides={"front": "mirror"},
        gate=shut,
        lift_speed=top / given.lift_time,
        plate_slips=given.surfaces == "slips",
        dimensions=LCPC_BOX.sizes(given),
        remarks=(POURED, "half of the box is simulated, between its middle plane and a side"),
        **given.settings(),
    )


check = check_flow(VOLUME)


def _knobs(given: LongBoxFlow) -> Iterator[Knob]:
    coarsest = min(given.column_length, given.height, given.width / 2) / 4
    return free_knobs(given, given.spacing, given.height, coarsest, (1.6, 1.25, 1.0, 0.7, 0.5), -4.0)


trading = Trading(_knobs, quantities=("spread_length", "h0"), variants=free_variants)


# The following definitions belong to the scene that simulates the LCPC box by discrete elements.


@dataclass(frozen=True, kw_only=True)
class LongBoxElements(LongBox, VesselParameters):
    """Parameters of the LCPC box by discrete elements: dimensions, grains, contact law and run."""


@scene_function(LongBoxElements)
def scene_dem(parameters: LongBoxElements) -> Scene:
    """Model the LCPC box by discrete elements, and compute spread length, depth and yield stress (Roussel 2007).

    The concrete is not poured; it stands behind a gate at one end, and the gate is lifted slowly. `plate_grip` scales
    the resistance of the floor and the sides to sliding, and `mould_grip` scales the resistance of the gate. With the
    contact laws mortar and plastic, the result also contains values from closed forms for comparison.

    Raises :class:`warpcrete.SceneError` for parameters that cannot be simulated.
    """
    given = parameters
    given.check_length()
    gate, width, top = given.column_length, given.width, given.height
    narrowest = min(gate, width, top)
    if given.size_max > narrowest / 4:
        problem = "is too large: at least four grains must fit side by side in the concrete at the start"
        refuse("size_max", given.size_max, problem, f"use {at_most(narrowest / 4)} m or less")
    inside = prism(((0.0, 0.0), (gate, 0.0), (gate, top), (0.0, top)), width, (gate / 2, top / 2))
    shut = rectangle((gate, -width, -given.size_min), (0.0, 2 * width, 0.0), (0.0, 0.0, 2 * top))
    lift = Prescribed(velocity=(0.0, 0.0, top / given.lift_time))
    planes: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
        "floor": ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
        "back": ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
        "end": ((given.length, 0.0, 0.0), (-1.0, 0.0, 0.0)),
        "left": ((0.0, -width / 2, 0.0), (0.0, 1.0, 0.0)),
        "right": ((0.0, width / 2, 0.0), (0.0, -1.0, 0.0)),
    }
    walls: list[Wall] = [PlaneWall(name=name, point=at, normal=n, material="plate") for name, (at, n) in planes.items()]
    walls.append(MeshWall(name="gate", vertices=shut[0], faces=shut[1], material="mould", motion=lift))
    return Scene(
        name="lcpc-dem",
        fill=given.fill(inside),
        walls=tuple(walls),
        vessel=given.vessel(LCPC_BOX, given.lift_time),
        remarks=(POURED, *vessel_remarks(given, "the gate")),
        **given.settings(),
    )


check_dem = check_vessel


def _knobs_dem(given: LongBoxElements) -> Iterator[Knob]:
    return vessel_knobs(given, min(given.column_length, given.width, given.height))


trading_dem = Trading(_knobs_dem, quantities=("spread_length", "h0"))
