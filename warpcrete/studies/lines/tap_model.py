"""Pressures at the taps (places of gauges) of a line as functions of the constants that a fit determines.

The function :func:`least_squares` finds these constants.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...geometry.pipe_line import Part, PipeLine
from ...theory.pipe import Concrete
from .fittings import library_factor
from .losses import GRAVITY, course_of, straight_friction
from .taps import Tap, is_free

ITERATIONS = 50
"""Maximum number of iterations of the least-squares fit of measured pressures."""


class TapModel:
    """Pressures at the taps (places of gauges) as functions of slip viscosity, slip yield stress and bend factor."""

    def __init__(self, line: PipeLine, concrete: Concrete, taps: Sequence[Tap], bends: bool = True) -> None:
        self.parts, self.concrete, self.taps, self.bends = line.parts, concrete, taps, bends
        self.kinds: dict[tuple[float, float, float], Part] = {}
        """For each kind of part, the first part of the pump line that is of this kind. A kind is a combination of bore,
        outlet and slip layer. The friction per metre of the first part is calculated once and holds for all parts of
        the kind."""
        for part in line.parts:
            self.kinds.setdefault(_kind(part), part)
        starts = np.concatenate([[0.0], np.cumsum([part.length for part in line.parts])])
        self.places: list[tuple[int, float]] = []
        """Place of each tap: the index of the part in which the tap sits, and the fraction of this part that lies
        between the tap and the end of the part."""
        self.rises: list[float] = []
        """Height of the end of the line above each tap [m]."""
        for tap in taps:
            own = min(int(np.searchsorted(starts, tap.place, side="right")) - 1, len(line.parts) - 1)
            share = float(np.clip((starts[own + 1] - tap.place) / line.parts[own].length, 0.0, 1.0))
            self.places.append((own, share))
            self.rises.append(share * line.parts[own].rise + sum(part.rise for part in line.parts[own + 1 :]))

    def pressures(self, constants: np.ndarray) -> np.ndarray:
        """Return the pressures at the taps (places of gauges) [Pa] for given constants, shape (taps,).

        The constants are the slip viscosity [Pa s/m], the slip yield stress [Pa] and the factor of bends.
        """
        courses = {flow: self._course(flow, constants) for flow in {tap.flow for tap in self.taps}}
        pressures = []
        for tap, (own, share) in zip(self.taps, self.places, strict=True):
            losses, course = courses[tap.flow]
            pressures.append(max(course[own + 1] + share * losses[own], 0.0))
        return np.array(pressures)

    def _course(self, flow: float, constants: np.ndarray) -> tuple[list[float], list[float]]:
        """Return the pressure loss of each part at a `flow` [m3/s], and the pressures along the line [Pa].

        The pressures are those at the start of the line and at the end of each part, shape (parts + 1,). The friction
        of a bend whose factor is fitted is the friction of straight pipe, multiplied by `constants[2]`. The friction of
        all other parts is calculated as for a line without a fit.
        """
        eta, tau, factor = (float(each) for each in constants)
        concrete = replace(self.concrete, slip_viscosity=eta, slip_yield=tau)
        metre = {kind: straight_friction(part, concrete, flow) / part.length for kind, part in self.kinds.items()}
        losses = []
        for part in self.parts:
            weight = factor if self.bends and is_free(part) else library_factor(part)
            friction = metre[_kind(part)] * part.length * part.relative * weight
            losses.append(friction + concrete.density * GRAVITY * part.rise)
        return losses, course_of(losses)

    def sensitivities(self, constants: np.ndarray, free: Sequence[int]) -> np.ndarray:
        """Return the derivatives of the pressures at the taps (places of gauges) with respect to some constants.

        `free` holds the indices of these constants in `constants`. The result has the shape (taps, free).
        """
        here, steps = self.pressures(constants), (1e-4 * constants[0], max(1e-4 * constants[1], 1e-3), 1e-3)
        columns = []
        for place in free:
            moved = constants.copy()
            moved[place] += steps[place]
            columns.append((self.pressures(moved) - here) / steps[place])
        return np.array(columns).T


def _kind(part: Part) -> tuple[float, float, float]:
    """Return the properties that determine a part's friction per metre; parts with equal results are of one kind."""
    return part.diameter, part.outlet, part.layer


def metre_model(line: PipeLine, concrete: Concrete, taps: Sequence[Tap]) -> TapModel:
    """Return a model of one metre of level pipe with a single tap, at the mean flow of the measured pressures.

    The pipe has the diameter of the line in which the concrete loses most of its pressure by friction, because the
    gauges mainly measure the friction in this diameter.
    """
    flow = float(np.mean([tap.flow for tap in taps]))
    losses: dict[float, float] = {}
    for part in line.parts:
        losses[part.diameter] = losses.get(part.diameter, 0.0) + straight_friction(part, concrete, flow)
    main = max(losses, key=lambda diameter: losses[diameter])
    metre = replace(line, parts=(Part(1, "straight", main, 1.0, 0.0, main),))
    return TapModel(metre, concrete, [Tap(0.0, 1.0, flow, 0)])


def least_squares(model: TapModel, measured: np.ndarray, start: np.ndarray, free: Sequence[int]) -> np.ndarray:
    """Return the constants that minimise the sum of the squared pressure deviations, by damped Gauss-Newton steps.

    `measured` holds the measured pressures [Pa], `start` the initial values of all constants, and `free` the indices of
    the constants that may change.
    """
    own, places = start.copy(), list(free)
    off = model.pressures(own) - measured
    for _ in range(ITERATIONS):
        slopes = model.sensitivities(own, places)
        step = np.linalg.lstsq(slopes, -off, rcond=None)[0]
        size = 1.0
        while size > 1e-6:
            trial = own.copy()
            trial[places] += size * step
            if trial[0] > 0 and (trial[1] >= 0 or 1 not in places):
                moved = model.pressures(trial) - measured
                if moved @ moved <= off @ off:
                    break
            size /= 2
        else:
            break
        change = np.abs(trial - own) / np.maximum(np.abs(own), 1.0)
        own, off = trial, moved
        if change.max() < 1e-9:
            break
    return own
