"""Groups of parameters of pumping aggregates through a pipe unit (Zhan et al. 2019).

The first line of each class is the heading of its group in the command's help.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from ...core.device.device import PRECISIONS
from ...core.inputs.concretes import is_file, shipped
from ...core.inputs.parameters import Above, Declared, FileIf, Needs, OneOf, Suggests, Within
from ...core.records import SceneArguments
from ..laws import OWN_LAW, OWN_WALL_LAW
from ..laws.linear import DASHPOTS
from ..scene.clumps import TEMPLATE_SETS
from ..scene.scene import Blockage, Wear

FixedTimeStep = Annotated[float | None, "Fixed time step [s]; default: automatic", Above()]
Safety = Annotated[
    float, "Automatic time step, divided by the estimated longest stable step; a value above 1 overrules this estimate"
]
EnergyBalance = Annotated[bool, "Sum up the energy that friction, dashpots and breaking bonds dissipate"]
Precision = Annotated[str, "Precision of positions and forces: float32 or float64", OneOf(PRECISIONS)]
SampleInterval = Annotated[float, "Simulated time between two rows of the time series [s]", Above()]
Seed = Annotated[int, "Random seed", Within(0)]
UNITS = ("vertical", "horizontal", "bend-to-horizontal", "bend-to-vertical")


def unit_names() -> tuple[str, ...]:
    """Return the names of the pipe units, which are the available shapes of pipe, such as a straight pipe or a bend."""
    return UNITS


def names_meshes(shapes: str) -> bool:
    """Return whether the parameter `shapes` contains paths of mesh files instead of names of shapes."""
    return any(Path(one).suffix and not one.strip().startswith("shape-") for one in shapes.split(","))


BONDED = Needs("bonds", bool, "is on")
HYDRATED = Needs("hydration", lambda fraction: fraction > 0, "is above 0")
FROM_FILE = Needs("wall", lambda wall: wall not in ("analytic", "mesh"), "is a file")
FACETED = Needs("wall", lambda wall: wall == "mesh", "is mesh")
OF_MESHES = Needs("shapes", names_meshes, "names mesh files")
SEVERAL = Needs("shapes", lambda shapes: shapes == "reference" or "," in shapes, "names several shapes")
NORMAL = Needs("sizes", lambda sizes: sizes == "gaussian", "is gaussian")
RANGED = Needs("sizes", lambda sizes: sizes in ("gaussian", "uniform"), "is gaussian or uniform")
BY_ITSELF = Needs("bulk_density", lambda bulk: bulk is None, "is left out")
OF_BALLS = Needs("plug", lambda plug: plug == "balls", "is balls")
STROKES = Needs("strokes", lambda strokes: strokes > 1, "is 2 or more")
RESTED = Needs("rest", lambda rest: rest > 0, "is above 0")
PLUGGED = Needs("plug", lambda plug: plug != "none", "is balls or plate")
WORN = Needs("wear", bool, "is on")


@dataclass(frozen=True, kw_only=True)
class UnitParameters:
    """Pipe unit.

    Shape and dimensions of the pipe, and the length of concrete in it.
    """

    common: ClassVar[tuple[str, ...]] = ("unit", "diameter", "elbow_radius", "length", "wall")

    unit: Annotated[
        str,
        "Pipe unit: vertical, horizontal, bend-to-horizontal (flow enters upward), bend-to-vertical (flow enters "
        "horizontally), or the letters A, B, C, D of Zhan et al. 2019",
        Suggests(unit_names),
    ] = "vertical"
    diameter: Annotated[float, "Inner diameter of the pipe [m]", Above()] = 0.15
    elbow_radius: Annotated[float, "Radius of a bend's centreline [m]", Above()] = 0.5
    length: Annotated[float, "Length of the concrete in the pipe at the start [m]", Above()] = 1.0
    wall: Annotated[
        str,
        "Wall of the pipe: analytic, mesh, or the path of an STL file of a wall around the same axis",
        Suggests(lambda: ("analytic", "mesh"), files=True),
    ] = "analytic"
    wall_scale: Annotated[
        float, "Factor from the unit of the wall file to metres: 0.001 for mm", Above(), FROM_FILE
    ] = 1.0
    facets: Annotated[int, "Number of facets around the pipe, if wall is mesh", Within(3, 100_000), FACETED] = 64


@dataclass(frozen=True, kw_only=True)
class PistonParameters:
    """Piston.

    Motion of the piston that pushes the concrete.
    """

    common: ClassVar[tuple[str, ...]] = ("velocity", "travel")

    velocity: Annotated[float, "Final velocity of the piston [m/s]", Above(), Within(0, 1e3)] = 0.3
    ramp: Annotated[float, "Travel over which the velocity rises linearly from rest [m]", Within(0)] = 0.3
    travel: Annotated[
        float | None,
        "Total travel of the piston [m]; default: the travel of all strokes or, without strokes, twice the ramp; in "
        "bends pi/2 x elbow_radius",
        Above(),
    ] = None


@dataclass(frozen=True, kw_only=True)
class StrokeParameters:
    """Strokes and stops.

    Division of the piston's travel into strokes, with pauses or a rest of the concrete between them.
    """

    common: ClassVar[tuple[str, ...]] = ("strokes", "pause", "rest")

    strokes: Annotated[
        int, "Number of strokes of the piston; it stops between them and starts again over the ramp", Within(1, 1000)
    ] = 1
    stroke: Annotated[
        float | None,
        "Travel of each stroke [m]; default: the travel divided by the number of strokes; if no travel is given, "
        "three ramps, or in bends an equal part of the arc",
        Above(),
        STROKES,
    ] = None
    pause: Annotated[
        float, "Duration of each stop of the piston between strokes [s]; 0: no stop", Within(0), STROKES
    ] = 0.5
    rest: Annotated[
        float,
        "Time at rest before the last stroke [s]; a formula gives its effect on the strengths, without time steps",
        Within(0),
        STROKES,
    ] = 0.0
    thixotropy: Annotated[
        float,
        "Growth rate A_thix of yield stress and bond strengths at rest [Pa/s]; 0.1 to 1.7 (Roussel 2006)",
        Within(0),
        RESTED,
    ] = 0.5
    breakdown: Annotated[
        float,
        "Slip along the wall after which 1/e of the yield stress that the layer gained at rest is left [m]",
        Above(),
        RESTED,
    ] = 0.1


@dataclass(frozen=True, kw_only=True)
class ConcreteChoice:
    """Concrete.

    Choice of a named concrete, which supplies defaults of aggregate, contacts and bonds.
    """

    concrete: Annotated[
        str,
        "Concrete: zhan (Table 1 of Zhan et al. 2019, with a wall layer calibrated on units A and B), zhan-table1, "
        "no1, no2, no3, or the path of a .yaml file. It sets those parameters of aggregate, contacts and bonds "
        "that you do not give",
        FileIf(is_file),
        Suggests(shipped),
    ] = "zhan"


@dataclass(frozen=True, kw_only=True)
class AggregateParameters:
    """Aggregate.

    Shapes, sizes and density of the aggregates, and how densely they are packed.
    """

    common: ClassVar[tuple[str, ...]] = ("shapes", "size_min", "size_max")

    shapes: Annotated[
        str,
        "Shapes of the aggregates: spheres, reference (four clumps), shape-F with shape factor F, or paths of "
        "closed meshes",
        Suggests(lambda: TEMPLATE_SETS, files=True),
    ] = "spheres"
    shape_spheres: Annotated[int, "Number of spheres that represent each mesh in shapes", OF_MESHES] = 10
    fractions: Annotated[
        str | None, "Parts by volume of each shape, such as '2,1,1,1'; default: equal parts", SEVERAL
    ] = None
    sizes: Annotated[
        str,
        "Size distribution: gaussian, uniform, or a sieve curve 'mm:passing,...' by mass",
        Suggests(lambda: ("gaussian", "uniform")),
    ] = "gaussian"
    size_min: Annotated[float, "Smallest size [m]", Above(), RANGED] = 5e-3
    size_max: Annotated[float, "Largest size [m]", Above(), RANGED] = 20e-3
    size_mean: Annotated[
        float | None, "Mean of the gaussian size distribution [m]; default: middle of the range", Above(), NORMAL
    ] = None
    size_deviation: Annotated[
        float | None,
        "Standard deviation of the gaussian size distribution [m]; default: half the range",
        Above(),
        NORMAL,
    ] = None
    density: Annotated[
        float, "Density of the aggregates, if they carry only their own mass [kg/m3]", Above(), BY_ITSELF
    ] = 2500.0
    bulk_density: Annotated[
        float | None,
        "Density of the concrete [kg/m3]; if given, the aggregates carry the mass of the mortar, too",
        Above(),
    ] = None
    solid_fraction: Annotated[
        float | None,
        "Solid fraction of the packing; default: the fraction at which the packing has the pressure of the plug",
    ] = None


@dataclass(frozen=True, kw_only=True)
class ContactParameters:
    """Contacts.

    Linear contact law between aggregates, and friction and lubrication layer on the walls.
    """

    common: ClassVar[tuple[str, ...]] = ()

    modulus: Annotated[float, "Effective modulus of contacts [Pa]", Above(), OWN_LAW] = 1e5
    stiffness_ratio: Annotated[float, "Ratio of normal to shear contact stiffness", Above(), OWN_LAW] = 2.0
    friction: Annotated[float, "Friction coefficient between aggregates", Within(0), OWN_LAW] = 0.05
    wall_friction: Annotated[float | None, "Friction coefficient on the pipe and the piston; default: the value of "
                                           "friction", Within(0), OWN_LAW,
                             OWN_WALL_LAW] = None  # fmt: skip
    layer_yield: Annotated[
        float, "Yield stress of a lubrication layer on pipe and piston [Pa]", Within(0), OWN_LAW, OWN_WALL_LAW
    ] = 0.0
    layer_viscosity: Annotated[
        float, "Viscosity of the lubrication layer divided by its thickness [Pa s/m]", Within(0), OWN_LAW, OWN_WALL_LAW
    ] = 0.0
    normal_damping: Annotated[
        float, "Damping of the normal dashpot as a fraction of critical damping", Within(0), OWN_LAW
    ] = 0.5
    shear_damping: Annotated[
        float, "Damping of the shear dashpot as a fraction of critical damping", Within(0), OWN_LAW
    ] = 0.0
    dashpot: Annotated[
        str,
        "Mode of the dashpots: full, no-tension (the total normal force never pulls), slip-cut (no shear dashpot in "
        "slip), both",
        OneOf(DASHPOTS),
        OWN_LAW,
    ] = "full"


@dataclass(frozen=True, kw_only=True)
class BondParameters:
    """Bonds (mortar).

    Strength and stiffness of the bonds between aggregates, and the share of hydrated bonds.
    """

    common: ClassVar[tuple[str, ...]] = ("bonds", "hydration")

    bonds: Annotated[bool, "Bond the aggregates in contact before pumping starts"] = True
    bond_modulus: Annotated[float, "Effective modulus of bonds [Pa]", Above(), BONDED] = 2e4
    bond_stiffness_ratio: Annotated[float, "Ratio of normal to shear bond stiffness", Above(), BONDED] = 2.0
    tensile_strength: Annotated[float, "Tensile strength of bonds [Pa]", Within(0), BONDED] = 10.0
    cohesion: Annotated[float, "Cohesion of bonds [Pa]", Within(0), BONDED] = 5.0
    friction_angle: Annotated[float, "Friction angle of bonds [degrees]", Within(0, 89), BONDED] = 30.0
    bond_gap: Annotated[float, "Largest gap across which bonds are made [m]", Within(0), BONDED] = 0.0
    healing: Annotated[bool, "Bond bodies when they begin to touch each other during the run", BONDED] = False
    hydration: Annotated[float, "Fraction of the bonds that is hydrated", Within(0, 1), BONDED] = 0.0
    hydration_modulus: Annotated[float, "Effective modulus of hydrated bonds [Pa]", Above(), HYDRATED] = 1e9
    hydration_strength: Annotated[
        float, "Tensile strength of hydrated bonds [Pa]; their cohesion is half of it", Within(0), HYDRATED
    ] = 1e6


@dataclass(frozen=True, kw_only=True)
class PlugParameters:
    """Plug, the front of the concrete.

    Balls or a plate that close the front of the concrete and press on it against the flow.
    """

    common: ClassVar[tuple[str, ...]] = ()

    plug: Annotated[
        str,
        "Plug at the front of the concrete: balls (bonded), plate (straight pipes only) or none",
        OneOf(("balls", "plate", "none")),
    ] = "balls"
    plug_pressure: Annotated[float, "Pressure of the plug against the flow [Pa]", Within(0), PLUGGED] = 1e3
    plug_ball: Annotated[
        float, "Diameter of the plug's balls, or half the thickness of the plate [m]", Above(), PLUGGED
    ] = 10e-3
    plug_layers: Annotated[
        int | None,
        "Number of layers of balls in the plug; default: 2, in bends as many as fit into 0.4 diameters",
        Within(1, 1000),
        OF_BALLS,
    ] = None


@dataclass(frozen=True, kw_only=True)
class IndexParameters:
    """Wear, segregation and blockage.

    Additional measurements of a run.
    """

    common: ClassVar[tuple[str, ...]] = ("wear", "segregation", "stop_when_blocked")

    wear: Annotated[bool, "Measure the sliding and the impacts on each patch of the walls"] = False
    wear_coefficient: Annotated[
        float,
        "Archard's wear coefficient K/H, worn volume per load and sliding distance [m2/N]; 1e-13 to 1e-12 for "
        "steel worn by stones",
        Within(0),
        WORN,
    ] = Wear.coefficient
    wear_patch: Annotated[
        float | None, "Edge length of a patch of the pipe's wall [m]; default: 1/24 of its circumference", Above(), WORN
    ] = None
    segregation: Annotated[bool, "Measure the distribution of the aggregate and of its large stones in the pipe"] = (
        False
    )
    blocked_travel: Annotated[
        float | None,
        "Travel of the piston during which part of the concrete must stand still for the pipe to count as blocked "
        "[m]; default: 1/20 of the concrete's length; for soft aggregates one diameter, but at most 1/5 of that "
        "length",
        Above(),
    ] = None
    stop_when_blocked: Annotated[bool, "End the run when the pipe is blocked"] = False


@dataclass(frozen=True, kw_only=True)
class RunParameters(Declared):
    """Run.

    Settings of the computation: time step, limits, precision and output.
    """

    common: ClassVar[tuple[str, ...]] = ("seed",)

    gravity: Annotated[float, "Gravitational acceleration [m/s2]", Within(-1e4, 1e4)] = 9.81
    settle: Annotated[
        float,
        "Longest time for which the aggregates settle under gravity and the pressure of the plug before the start [s]",
        Within(0),
    ] = 2.0
    time_step: FixedTimeStep = None
    hydration_rounds: Annotated[
        int | None,
        "Number of sub-steps of hydrated bonds in one time step; default: as many as these bonds need if they are "
        "much stiffer than everything else; 1: no sub-steps, so that these bonds limit the time step",
        HYDRATED,
    ] = None
    safety: Safety = 0.8
    overlap_limit: Annotated[
        float,
        "Overlap at which the run stops, divided by the overlap at which one sphere lies inside another; 0: no limit",
        Within(0),
    ] = 1.5
    energy_balance: EnergyBalance = False
    precision: Precision = "float32"
    sample_interval: SampleInterval = 0.01
    seed: Seed = 0


def index_settings(given: IndexParameters) -> SceneArguments:
    """Return the fields of a :class:`Scene` that configure wear, blockage and segregation measurements."""
    wear = Wear(coefficient=given.wear_coefficient, patch=given.wear_patch) if given.wear else None
    return {
        "wear": wear,
        "blockage": Blockage(travel=given.blocked_travel, stop=given.stop_when_blocked),
        "segregation": given.segregation,
    }
