"""Pressures at the taps (places of gauges) of a line as functions of the constants that a fit determines."""

from __future__ import annotations

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
        self.concrete, self.taps = concrete, taps
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
                # A bend whose factor is fitted counts as straight pipe here, because the fit later multiplies its
                # friction by the factor. All other parts have the same friction as in the calculation of a line without
                # a fit.
                weight = 1.0 if bends and is_free(part) else library_factor(part)
                metres[bends and is_free(part)] += share * part.length * part.relative * weight
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
            total = concrete.density * GRAVITY * rise
            for kind, (plain, bends) in metres.items():
                part = self.kinds[kind]
                total += straight_friction(part, concrete, tap.flow) / part.length * (plain + constants[2] * bends)
            found.append(total)
        return np.array(found)

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


def metre_model(line: PipeLine, concrete: Concrete, taps: Sequence[Tap], ratio: float = 1.0) -> TapModel:
    """Return a model of one metre of level pipe with the line's first diameter.

    Its flow is `ratio` times the mean flow of the taps.
    """
    first = line.parts[0].diameter
    metre = replace(line, parts=(Part(1, "straight", first, 1.0, 0.0, first),))
    return TapModel(metre, concrete, [Tap(0.0, 1.0, ratio * float(np.mean([tap.flow for tap in taps])), 0)])
