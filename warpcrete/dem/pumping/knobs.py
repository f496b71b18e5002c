"""Settings that trade accuracy for computing time in a pumping scene."""

from __future__ import annotations

from collections.abc import Iterator

from ...core.inputs.knobs import Knob, Level, precisions, scaled
from ..scene.scene import MUCH_STIFFER
from .parameter_groups import AggregateParameters, names_meshes
from .parameters import WIDEST_STONE, PipeParameters, stiffness_of

COARSENINGS = (3.0, 2.0, 1.5, 1.0)
FACETS = (16, 32, 64, 128, 256)
SPHERES = (1, 2, 4, 8, 16)
LENGTHS = (0.25, 0.5, 1.0)


def pumping_knobs(given: PipeParameters) -> Iterator[Knob]:
    """Yield the settings that trade accuracy for computing time in a pumping scene.

    One of the settings is coarse-graining, which multiplies all sizes of the aggregate by a factor. The contact laws
    need no rescaling. A contact's stiffness is modulus times area over length, so the stress depends only on the
    overlap relative to the size. The strengths of bonds and lubrication layer are stresses, and dashpots are given by
    their critical ratio. Coarse-graining therefore changes only the number of aggregates across the pipe and the
    momentum that each impact carries.
    """
    if given.time_step is None:
        yield scaled("time step", "safety", given.safety, (2.0, 1.5, 1.0, 0.5, 0.25), -1.0)
    yield precisions()
    if given.sizes in ("gaussian", "uniform"):
        widest = max(WIDEST_STONE * given.diameter / given.size_max, 1.0)
        yield Knob("coarse-graining", tuple(coarser(given, c) for c in COARSENINGS if c <= widest), True)
    if given.shapes == "reference":
        yield Knob(
            "shape", (Level("spheres", {"shapes": "spheres"}, 0.3), Level("reference", {"shapes": "reference"})), True
        )
    elif names_meshes(given.shapes):
        yield Knob(
            "shape",
            tuple(Level(f"{n} spheres", {"shape_spheres": n}, n**0.7) for n in sorted({*SPHERES, given.shape_spheres})),
        )
    if given.wall in ("analytic", "mesh"):
        faceted = [Level(f"{n} facets", {"wall": "mesh", "facets": n}, 1.3) for n in sorted({*FACETS, given.facets})]
        yield Knob("wall", (*faceted, Level("analytic", {"wall": "analytic"})))
    if given.contact is None:
        yield scaled("stiffness", "modulus", given.modulus, (0.25, 0.5, 1.0), 0.5, "Pa", True)
    if given.bonds and given.hydration > 0:
        yield scaled("hydrated stiffness", "hydration_modulus", given.hydration_modulus, (0.01, 0.1, 1.0), 0.5, "Pa",
                     True)  # fmt: skip
        much_stiffer = given.hydration_modulus >= MUCH_STIFFER * max(stiffness_of(given), given.bond_modulus)
        if given.hydration_rounds is None and given.time_step is None and much_stiffer:
            single = Level("single steps", {"hydration_rounds": 1}, 3.0)
            yield Knob("hydrated bonds", (Level("rounds", {"hydration_rounds": None}), single))
    if not given.is_bend:
        # The pressure without the plug's share is proportional to the length of the pipe if the wall stress is uniform
        # along it. The levels use this to convert the pressures of a shorter pipe.
        pushed = given.plug_pressure if given.plug != "none" else 0.0
        yield Knob("length", tuple(
            Level(f"{f * given.length:.4g} m", {"length": f * given.length}, f, f"x {f:g}",
                  {name: (pushed, 1 / f) for name in ("plateau_pressure", "peak_pressure", "end_pressure")})
            for f in LENGTHS
        ), chosen=False)  # fmt: skip
    if given.settle > 0:
        yield scaled("settling", "settle", given.settle, (0.05, 0.2, 1.0), 0.3, "s")


def coarser(given: AggregateParameters, factor: float) -> Level:
    """Return the coarse-graining level at which aggregates are `factor` times as large, with its relative cost."""
    names = ("size_min", "size_max", "size_mean", "size_deviation")
    sizes = {name: factor * getattr(given, name) for name in names if getattr(given, name) is not None}
    # The computing time scales as factor^-4: the number of aggregates as factor^-3, that of steps as factor^-1.
    return Level(f"x {factor:g}", sizes, factor**-4)
