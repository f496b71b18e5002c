"""Concrete as a Bingham fluid with a slip layer, up a channel between two planes (Xu, Li & Jiang 2021; 2D)."""

from __future__ import annotations

from typing import Annotated

from warpcrete.fluid import FluidScene, check_flow, scene_of
from warpcrete.parameters import checked

PAPER = {"no1": {"pressure": 9.40e3, "slip_velocity": 0.186}}
"""Printed for 1500 cm3/s [Pa, m/s]."""


@checked
def scene(
    mix: Annotated[str, "concrete: no1, no2, no3 (Xu et al. 2021), or own with the five constants below"] = "no1",
    flow: Annotated[float | None, "volume flow through a round pipe of the radius [m3/s]; default 1500e-6"] = None,
    pressure: Annotated[float | None, "pressure on the piston instead of the flow [Pa]; theory gives its speed"] = None,
    radius: Annotated[float, "half the distance of the planes [m]"] = 0.05,
    length: Annotated[float, "of the column [m]"] = 0.3,
    spacing: Annotated[float, "of the particles [m]; the nearest that divides the width is taken"] = 5e-3,
    aggregates: Annotated[bool, "two phases: coarse aggregate as rigid groups of particles in mortar"] = False,
    aggregate_share: Annotated[float | None, "of the volume; default: the mix's gravel"] = None,
    aggregate_viscosity: Annotated[float, "of aggregate in the viscous forces, a numerical rigidity [Pa s]"] = 1e4,
    aggregate_density: Annotated[float, "[kg/m3]"] = 2630.0,
    inclusions: Annotated[
        str, "how the mortar's default constants take them: discs, spheres; auto: by dimension"
    ] = "auto",
    mortar_viscosity: Annotated[float | None, "plastic viscosity [Pa s]; default: by homogenisation"] = None,
    mortar_yield: Annotated[float | None, "yield stress [Pa]; default: by homogenisation"] = None,
    density: Annotated[float | None, "of the concrete [kg/m3]; this and the next four replace the mix's"] = None,
    viscosity: Annotated[float | None, "plastic viscosity [Pa s]"] = None,
    yield_stress: Annotated[float | None, "[Pa]"] = None,
    slip_viscosity: Annotated[float | None, "of the slip layer, over its thickness [Pa s/m]"] = None,
    slip_yield: Annotated[float | None, "yield stress of the slip layer [Pa]"] = None,
    slip_thickness: Annotated[float, "of the slip layer, by which the concrete is thinner [m]"] = 0.0,
    duration: Annotated[float | None, "simulated time [s]; default: until steady"] = None,
    time_step: Annotated[float, "[s]"] = 5e-4,
    gravity: Annotated[float, "against the flow [m/s2]; 0 for a level pipe"] = 9.81,
    regularisation: Annotated[float, "beta of the regularised Bingham law [s]"] = 100.0,
    literal: Annotated[bool, "the scheme as the paper prints it, to show what it does"] = False,
    tolerance: Annotated[float, "of the pressure solve: residual over that at its start"] = 1e-2,
    most_iterations: Annotated[int, "of a solve, before the run ends with an error"] = 2000,
    steadiness: Annotated[float, "steady: pressure and slip change by less than this share"] = 1e-3,
    precision: Annotated[str, "of places, velocities and pressures: float32 or float64"] = "float32",
    sample_interval: Annotated[float, "simulated time between two rows of the series [s]"] = 5e-3,
    seed: Annotated[int, "random seed, of the aggregate"] = 0,
) -> FluidScene:
    """Concrete that a piston drives up a channel, by implicit moving particles in two dimensions.

    The paper's case: R = 5 cm, a column of 30 cm. The piston moves at flow / (pi R^2), as there.

    Raises :class:`warpcrete.SceneError` for anything that cannot be simulated, and where nothing would flow.
    """
    return scene_of("channel", 2, dict(locals()), PAPER)


check = check_flow
