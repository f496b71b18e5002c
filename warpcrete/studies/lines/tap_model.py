"""Pressures at the taps (places of gauges) of a line as functions of the constants that a fit determines."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...geometry.pipe_line import Part, PipeLine
from ...theory.pipe import Concrete
from .fittings import library_factor
from .losses import GRAVITY, straight_friction
from .taps import Tap, is_free


class TapModel:
    """Pressures at the taps (places of gauges) as functions of slip viscosity, slip yield stress and bend factor."""

    def __init__(self, line: PipeLine, concrete: Concrete, taps: Sequence[Tap], bends: bool = True) -> None:
        self.concrete, self.taps, self.bends = concrete, taps, bends
        self.falling = line.parts if any(part.rise < 0 for part in line.parts) else ()
        """Parts of a pump line in which concrete falls somewhere, and may separate; empty if it falls nowhere."""
        starts = np.concatenate([[0.0], np.cumsum([part.length for part in line.parts])])
        self.kinds: dict[tuple[Any, ...], Part] = {}
        """For each kind of part, the first part of the pump line that is of this kind. A kind is a combination of bore,
        outlet and slip layer. The friction per metre of the first part is calculated once and holds for all parts of
        the kind."""
        self.metres: list[dict[tuple[Any, ...], list[float]]] = []
        """Two lengths of pipe between each tap and the end of the line [m], by the keys of `kinds`. A tap is the place
        of a gauge.

        The first length is that of straight pipe with the same friction as all parts whose factor is known. The second
        length is that of the bends whose factor is fitted.
        """
        self.rises: list[float] = []
        for tap in taps:
            own: dict[tuple[Any, ...], list[float]] = {}
            rise = 0.0
            for part, start in zip(line.parts, starts, strict=False):
                share = float(np.clip((start + part.length - tap.place) / part.length, 0.0, 1.0))
                kind = (part.diameter, part.outlet, part.layer)
                self.kinds.setdefault(kind, part)
                metres = own.setdefault(kind, [0.0, 0.0])
                metres[bends and is_free(part)] += share * self._equivalent(part)
                rise += share * part.rise
            self.metres.append(own)
            self.rises.append(rise)

    def pressures(self, constants: np.ndarray) -> np.ndarray:
        """Return the pressures at the taps (places of gauges) [Pa] for given constants, shape (taps,).

        The constants are the slip viscosity [Pa s/m], the slip yield stress [Pa] and the factor of bends.
        """
        concrete = replace(self.concrete, slip_viscosity=float(constants[0]), slip_yield=float(constants[1]))
        found = []
        for tap, metres, rise in zip(self.taps, self.metres, self.rises, strict=True):
            if self.falling:
                found.append(self._falling_pressure(tap, concrete, float(constants[2])))
                continue
            total = concrete.density * GRAVITY * rise
            for kind, (plain, bends) in metres.items():
                part = self.kinds[kind]
                total += straight_friction(part, concrete, tap.flow) / part.length * (plain + constants[2] * bends)
            found.append(total)
        return np.array(found)

    def _equivalent(self, part: Part) -> float:
        """Return the length of straight pipe with the friction of a part [m].

        A bend whose factor is fitted counts as straight pipe, because the fit multiplies its friction by the factor.
        All other parts have the same friction as in the calculation of a line without a fit.
        """
        weight = 1.0 if self.bends and is_free(part) else library_factor(part)
        return part.length * part.relative * weight

    def _falling_pressure(self, tap: Tap, concrete: Concrete, factor: float) -> float:
        """Return the pressure at a tap of a line in which concrete may separate [Pa].

        The losses are added from the end of the line to the tap, and the pressure never falls below zero, as in
        :meth:`.LinePressures.course`. `factor` is the fitted factor of bends.
        """
        found, end = 0.0, sum(part.length for part in self.falling)
        for part in reversed(self.falling):
            share = min((end - tap.place) / part.length, 1.0)
            if share <= 0:
                break
            metre = straight_friction(part, concrete, tap.flow) / part.length
            friction = metre * self._equivalent(part) * (factor if self.bends and is_free(part) else 1.0)
            found = max(found + share * (friction + concrete.density * GRAVITY * part.rise), 0.0)
            end -= part.length
        return found

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


def metre_model(line: PipeLine, concrete: Concrete, taps: Sequence[Tap]) -> TapModel:
    """Return a model of one metre of level pipe at the mean flow of the taps.

    The pipe has the diameter in which the concrete loses most of its pressure by friction. The gauges determine the
    friction there, and not the one in a short wide pipe at the pump.
    """
    flow = float(np.mean([tap.flow for tap in taps]))
    losses: dict[float, float] = {}
    for part in line.parts:
        losses[part.diameter] = losses.get(part.diameter, 0.0) + straight_friction(part, concrete, flow)
    main = max(losses, key=lambda diameter: losses[diameter])
    metre = replace(line, parts=(Part(1, "straight", main, 1.0, 0.0, main),))
    return TapModel(metre, concrete, [Tap(0.0, 1.0, flow, 0)])
