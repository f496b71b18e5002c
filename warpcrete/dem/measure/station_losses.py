"""Friction losses along a pipe, from the stresses that were measured in slices (stations) along the pipe."""

import math
from dataclasses import dataclass

import numpy as np

from ..laws import Contact, LubricationLayer
from ..scene.concretes import COVERAGE
from ..scene.scene import Scene
from ..scene.slices import FEWEST, Stations


def losses(stations: Stations, table: dict[str, np.ndarray], gravity: tuple[float, float, float]) -> dict[str, float]:
    """Return the friction losses along a pipe, from a table of the stresses in slices (stations) along the pipe.

    The weight of the concrete under `gravity` [m/s2] is subtracted. For a straight pipe, the losses are the pressure
    gradient [Pa/m] and the wall stress [Pa]. For a pipe with a bend or taper in its middle, the function returns both
    losses for the straight section upstream of the middle and for the section downstream of it. Each loss follows from
    a straight line that is fitted to the stresses in its section. The fit leaves out a length of one pipe radius at
    each end of the section. A pipe with a middle has four more results:

    - `middle_loss` [Pa] is the loss of axial stress in the middle, from the end of the upstream line to the beginning
      of the downstream line.
    - `middle_ratio` is `middle_loss` divided by the loss in a straight pipe of the same length. Friction rises with
      pressure. The gradient of this straight pipe is therefore the logarithmic mean of 4 tau / d at both ends of the
      middle, with the wall stress tau and the diameter d. This mean is exact if friction rises linearly with pressure.
    - `middle_excess` [Pa] is the difference of these two losses.
    - `flux_ratio` is the downstream solid volume flux divided by the upstream flux.

    A result is left out if concrete fills too few of the slices that it needs. The results `middle_ratio` and
    `middle_excess` are also left out if the wall stress at an end of the middle is not positive, and `flux_ratio` if
    the upstream flux is not positive.
    """
    s = stations.places
    slope = table["bulk_density"] * (stations.axis.at(s)[1] @ np.array(gravity))
    steps = 0.5 * (slope[1:] + slope[:-1]) * np.diff(s)
    weight = np.concatenate([[0.0], np.cumsum(np.where(np.isfinite(steps), steps, 0.0))])
    stress, shear = table["axial_stress"] - weight, table["wall_stress"]
    flux = table["velocity"] * table["solid_fraction"] * table["radius"] ** 2

    def lines(low: float, high: float) -> _Straight | None:
        here = stations.clear(low, high) & np.isfinite(stress)
        if np.count_nonzero(here) < FEWEST:
            return None
        return _Straight(*(np.polyfit(s[here], each[here], 1) for each in (stress, shear)),
                         float(shear[here].mean()), float(flux[here].mean()))  # fmt: skip

    stretches = [lines(*ends) for ends in stations.straights]
    if stations.middle is None:
        found = stretches[0]
        return {} if found is None else {"gradient": -found.stress[0], "wall_stress": found.mean}
    begin, end = stations.middle
    before, behind = stretches
    result: dict[str, float] = {}
    for name, found in (("upstream", before), ("downstream", behind)):
        if found is not None:
            result |= {f"{name}_gradient": -found.stress[0], f"{name}_wall_stress": found.mean}
    if before is not None and behind is not None:
        loss = float(np.polyval(before.stress, begin) - np.polyval(behind.stress, end))
        there = [
            2 * np.polyval(line.shear, place) / stations.bores.at(place)
            for line, place in ((before, begin), (behind, end))
        ]
        result["middle_loss"] = loss
        if before.flux > 0:
            result["flux_ratio"] = behind.flux / before.flux
        if min(there) > 0:
            straight = _logarithmic_mean(*map(float, there)) * (end - begin)
            result |= {"middle_ratio": loss / straight, "middle_excess": loss - straight}
    return result


@dataclass
class _Straight:
    """Stresses and flux in a straight section of a pipe.

    `stress` and `shear` are the coefficients of straight lines, fitted to the axial stress and to the wall stress [Pa]
    over the arc length [m]. `flux` is the mean product of velocity, solid fraction and squared radius [m3/s].
    """

    stress: np.ndarray
    shear: np.ndarray
    mean: float
    """Mean wall stress in the straight section [Pa]."""
    flux: float


def layer_gradient(scene: Scene, place: float) -> float | None:
    """Return the friction per length of straight pipe in plug flow [Pa/m], with the bore at an arc length `place` [m].

    In plug flow, all stones slide along the lubrication layer at the mean velocity v of the concrete. The gradient is
    4 tau / d with the wall stress tau = c (tau_L0 + eta_L v), where c is the fraction COVERAGE of the wall on which the
    layer acts. The result is None without a lubrication layer, and in two cases in which the equation does not hold:
    with friction of stones on the wall, because such friction rises with the pressure, and for single spheres without
    friction between them, because these roll along the layer. Single spheres with little friction may roll as well; the
    equation is then an upper limit.
    """
    law, pipe = scene.contacts.get(("aggregate", "wall")), scene.pipe
    if pipe is None or scene.stations is None or type(law) is not LubricationLayer:
        return None
    if type(law.contact) is not Contact or law.contact.friction > 0:
        return None
    single_spheres = scene.fill is not None and all(len(each.radii) == 1 for each in scene.fill.templates)
    if single_spheres and type(scene.contact) is Contact and scene.contact.friction == 0:
        return None
    radius = float(scene.stations.bores.at(place))
    velocity = pipe.velocity * (pipe.radius / radius) ** 2
    return 2 * COVERAGE * (law.yield_stress + law.viscosity * velocity) / radius


def _logarithmic_mean(a: float, b: float) -> float:
    return a if abs(a - b) < 1e-6 * a else (a - b) / math.log(a / b)
