"""Pressure along a pump line, summed over its parts, with its uncertainty band."""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from ...geometry.pipe_line import Part, PipeLine
from ...mix.mix import CAUSES
from ...theory.bands import Band, combined
from ...theory.pipe import Concrete, after_rest
from .fittings import MODEL_ERRORS, range_of, uncertain_kinds
from .line_fit import LineFit
from .losses import course_of, friction, straight_friction, with_layer_factor

P = TypeVar("P", bound="LinePressures")


@dataclass(frozen=True)
class Loss:
    """Pressure losses of one part of a line [Pa], by friction and by weight."""

    part: Part
    friction: float
    """Pressure loss of the part by friction [Pa]."""
    theory: float
    """Friction of the part by the closed form [Pa] (:func:`.losses.friction`): the friction of straight pipe of the
    same bore and length, multiplied by the factor from the line's file or, for a hose, from the model of hoses."""
    weight: float
    """Pressure due to the weight of the concrete over the part's rise [Pa]."""

    @property
    def straight(self) -> float:
        """Friction of a straight pipe of the part's bore and length by the closed form [Pa]."""
        return self.theory / self.part.relative

    @property
    def range(self) -> tuple[float, float] | None:
        """Lowest and highest possible friction of the part, divided by the friction of straight pipe.

        The range expresses the error of the model of a fitting; the value is None for parts without such an error, such
        as straight pipe.
        """
        return range_of(self.part, self.straight)

    def at(self, end: int) -> float:
        """Return the lower (`end` = 0) or upper (`end` = 1) limit of the friction in this part of the pump line [Pa].

        The limits are the ends of :attr:`range`, multiplied by the friction of straight pipe. They are widened if
        necessary, so that the computed friction always lies between them. If the range is None, both limits equal the
        computed friction.
        """
        if self.range is None:
            return self.friction
        return (min, max)[end](self.range[end] * self.straight, self.friction)


@dataclass(frozen=True)
class Stop:
    """Stop of the pump with a full line: its duration, and the growth of the concrete's yield stresses in this time."""

    rest: float
    """Duration of the pump's stop [s]."""
    growth: float
    """Growth rate of the concrete's yield stresses at rest [Pa/s]."""
    band: tuple[float, float] | None = None
    """Lower and upper end of the uncertainty band of `growth` [Pa/s]; None if `growth` has no uncertainty."""
    highest: float | None = None
    """Highest published growth rate of the yield stresses at rest [Pa/s], for which the restart is computed in
    addition; None if the user stated `growth`."""


@dataclass(repr=False)
class LinePressures:
    """Pressure losses of all parts of a line, and the pressure along the line that follows from them."""

    line: PipeLine
    concrete: Concrete
    flow: float
    """Flow rate for which the pressure of the line is calculated [m3/s]."""
    losses: list[Loss]
    """Pressure losses of each part, in the order from the start of the line to its end."""
    layer_factor: float
    """Uncertainty of the slip layer: its true resistance may be larger or smaller by up to this factor."""
    simulated: bool
    """True if friction comes from simulations and not from the closed form."""
    variants: Mapping[str, tuple[Concrete, Concrete]] | None = None
    """Pairs of concretes; the keys are the causes of uncertainty. In each pair, the properties of one cause are at the
    lower and at the upper end of their band. None means that only the resistance of the slip layer is uncertain, by the
    factor `layer_factor`."""
    stop: Stop | None = None
    """Stop of the pump, after which the line must start again; None for no stop."""
    fit: LineFit | None = None
    """Constants of the slip layer and friction of the bends, fitted to pressures measured on a trial line. The value is
    None if no trial line was given."""

    @property
    def pressure(self) -> float:
        """Pressure at the start of the line [Pa]."""
        return float(self.course(lambda loss: loss.friction + loss.weight)[1][0])

    @property
    def theory(self) -> float:
        """Pressure at the start by the closed form, which treats bends and reducers as straight pipe [Pa]."""
        return float(self.course(lambda loss: loss.theory + loss.weight)[1][0])

    def band(self) -> Band:
        """Return the pressure at the line's start [Pa], with its uncertainty band and each cause's contribution."""
        return self.bands()[1][0]

    def bands(self) -> tuple[np.ndarray, list[Band]]:
        """Return positions along the pump line [m], and the pressure there with its uncertainty band [Pa].

        The positions are the start of the line and the end of each part, and both results have parts + 1 entries. The
        uncertain inputs are the constants of the concrete and, for each kind of fitting, the error of the model of its
        friction. One input after the other is set to the lower and to the upper end of its band, and the pressure is
        calculated again. The deviations are combined as the square root of the sum of their squares. All fittings of a
        kind, such as all bends, are changed together. A part was simulated with one concrete only; for changed
        constants, its friction is scaled in the same ratio as the closed form.
        """
        return self._bands

    @functools.cached_property
    def _bands(self) -> tuple[np.ndarray, list[Band]]:
        """Result of :meth:`bands`, calculated at the first use and then stored."""
        places, ours = self.course(lambda loss: loss.friction + loss.weight)
        ends = {cause: [self._course_of(each) for each in pair] for cause, pair in self._variants().items()}
        for kind in uncertain_kinds(self.line.parts):
            changed = [self._friction_with(kind, end) for end in (0, 1)]
            ends[MODEL_ERRORS[kind].cause] = [
                self.course(lambda x, own=own: own(x) + x.weight)[1].tolist() for own in changed
            ]
        bands = [
            combined(value, {cause: (low[k], high[k]) for cause, (low, high) in ends.items()})
            for k, value in enumerate(ours.tolist())
        ]
        return places, bands

    def measured(self: P, cause: str, factors: tuple[float, float]) -> P:
        """Return a copy with the uncertainty that would remain if properties of the concrete were measured.

        `cause` is the cause of uncertainty whose properties are measured, a key of :data:`warpcrete.mix.mix.CAUSES`
        such as 'slip layer'. The measurement is assumed to confirm the present values of these properties. `factors`
        are the ends of the remaining uncertainty band, divided by the measured value.
        """
        low, high = (
            with_layer_factor(self.concrete, x)
            if cause == "slip layer"
            else replace(self.concrete, **{key: x * getattr(self.concrete, key) for key in CAUSES[cause]})
            for x in factors
        )
        return replace(self, variants={**self._variants(), cause: (low, high)})

    def restart(self, flow: float = 0.0) -> Band:
        """Return the pressure at the pump that restarts the line after a stop [Pa], with its uncertainty band.

        With a `flow` of 0 [m3/s], the result is the pressure at which the concrete begins to move. With a larger
        `flow`, it is the pressure that restarts the line immediately at that flow. The friction of straight pipe
        follows from the closed form with the yield stresses after the stop. The ratio of the friction of a fitting to
        the friction of straight pipe is assumed to be the same as before the stop.
        """
        stop = self.stop
        assert stop is not None, "the line does not stop"

        def pressure(concrete: Concrete, growth: float, of: Callable[[Loss], float]) -> float:
            grown = after_rest(concrete, stop.rest, growth)
            ratio = concrete.density / self.concrete.density
            course = self.course(
                lambda x: straight_friction(x.part, grown, flow) * of(x) / x.straight + x.weight * ratio
            )[1]
            return float(course[0])

        def own(x: Loss) -> float:
            return x.friction

        value = pressure(self.concrete, stop.growth, own)
        ends = {
            cause: (pressure(low, stop.growth, own), pressure(high, stop.growth, own))
            for cause, (low, high) in self._variants().items()
        }
        for kind in uncertain_kinds(self.line.parts):
            low, high = (pressure(self.concrete, stop.growth, self._friction_with(kind, end)) for end in (0, 1))
            ends[MODEL_ERRORS[kind].cause] = (low, high)
        if stop.band is not None:
            low, high = (pressure(self.concrete, each, own) for each in stop.band)
            ends["thixotropy"] = (low, high)
        return combined(value, ends)

    def _friction_with(self, kind: str, end: int) -> Callable[[Loss], float]:
        """Return a function that gives the friction [Pa] of a part, for changed friction of all fittings of one `kind`.

        The argument of the function is the :class:`Loss` of the part. The fittings of this kind, such as bends, have
        the friction at the lower (`end` = 0) or upper (`end` = 1) end of their band. If the slip layer was fitted to a
        trial line, the changed fittings would have given another fitted layer. The friction of all parts is therefore
        multiplied by one factor, so that the mean pressure due to friction at the gauges stays the same.
        """

        def changed(x: Loss) -> float:
            return x.at(end) if x.part.kind == kind else x.friction

        if self.fit is None:
            return changed
        places = [tap.place for tap in self.fit.taps]
        before, after = (float(np.interp(places, *self.course(of)).sum()) for of in (lambda x: x.friction, changed))
        factor = before / after if after > 0 else 1.0
        return lambda x: factor * changed(x)

    def course(self, of: Callable[[Loss], float]) -> tuple[np.ndarray, np.ndarray]:
        """Return the positions of the line's start and of the ends of its parts [m], and the pressures there [Pa].

        Both results have the shape (parts + 1,). The function `of` gives the pressure loss of a part from its
        :class:`Loss`. The pressure never falls below zero (:func:`.course_of`).
        """
        places = np.concatenate([[0.0], np.cumsum([loss.part.length for loss in self.losses])])
        return places, np.array(course_of([of(loss) for loss in self.losses]))

    def _variants(self) -> Mapping[str, tuple[Concrete, Concrete]]:
        if self.variants is not None:
            return self.variants
        low, high = (with_layer_factor(self.concrete, x) for x in (1 / self.layer_factor, self.layer_factor))
        return {"slip layer": (low, high)} if self.layer_factor > 1 else {}

    def _course_of(self, concrete: Concrete) -> list[float]:
        """Return the pressures [Pa] at the start of the line and the ends of its parts if `concrete` fills the line."""

        def loss(x: Loss) -> float:
            own = x.friction * friction(x.part, concrete, self.flow) / x.theory
            return own + x.weight * concrete.density / self.concrete.density

        return self.course(loss)[1].tolist()
