"""Size distributions of aggregates; a size is the diameter of the sphere of equal volume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.errors import positive, refuse


@dataclass(frozen=True)
class Gaussian:
    """Truncated normal distribution of sizes [m], by number of aggregates (Zhan et al. 2019, section 3.3)."""

    mean: float = 12.5e-3
    deviation: float = 7.5e-3
    smallest: float = 5e-3
    largest: float = 20e-3

    def __post_init__(self) -> None:
        _check_range(self.smallest, self.largest)
        positive("mean size", self.mean, "m")
        positive("size deviation", self.deviation, "m")
        if not self.smallest - 3 * self.deviation <= self.mean <= self.largest + 3 * self.deviation:
            refuse(
                "mean size", self.mean, f"lies far outside the range of sizes, [{self.smallest:g}, {self.largest:g}] m"
            )

    def sample(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Return `count` random sizes [m]."""
        if self.smallest == self.largest:
            return np.full(count, self.smallest)
        sizes = np.empty(0)
        while len(sizes) < count:
            draw = random.normal(self.mean, self.deviation, 2 * count + 16)
            sizes = np.concatenate([sizes, draw[(draw >= self.smallest) & (draw <= self.largest)]])
        return sizes[:count]


@dataclass(frozen=True)
class Uniform:
    """Uniform distribution of sizes [m] over a range, by number of aggregates."""

    smallest: float
    largest: float

    def __post_init__(self) -> None:
        _check_range(self.smallest, self.largest)

    def sample(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Return `count` random sizes [m]."""
        return random.uniform(self.smallest, self.largest, count)


@dataclass(frozen=True)
class SieveCurve:
    """Grading curve of a mix design: the fraction of the mass that passes each sieve opening.

    Between two openings, the mass fraction rises linearly with the logarithm of the size.
    """

    openings: tuple[float, ...]
    """Sieve openings, in rising order [m]."""
    passing: tuple[float, ...]
    """Mass fractions that pass the sieve openings, rising from 0 at the first opening to 1 at the last."""

    def __post_init__(self) -> None:
        try:
            openings, passing = np.asarray(self.openings, float), np.asarray(self.passing, float)
        except (TypeError, ValueError):
            refuse("openings", self.openings, "must be a list of numbers, and so must 'passing'")
        if not np.all(np.isfinite(openings)) or not np.all(np.isfinite(passing)):
            refuse("openings", self.openings, "must contain only finite numbers, and so must 'passing'")
        if openings.ndim != 1 or len(openings) < 2 or len(openings) != len(passing):
            refuse("openings", self.openings, "must be two or more, with one fraction in 'passing' for each opening")
        if np.any(openings <= 0) or np.any(np.diff(openings) <= 0):
            refuse("openings", self.openings, "must be above 0 m, and each must exceed the opening before it")
        if passing[0] != 0 or passing[-1] != 1 or np.any(np.diff(passing) < 0):
            refuse("passing", self.passing, "must rise from 0 to 1 and never fall from one opening to the next")
        object.__setattr__(self, "openings", tuple(openings.tolist()))
        object.__setattr__(self, "passing", tuple(passing.tolist()))

    @classmethod
    def from_text(cls, text: str, field: str, allowed: str) -> SieveCurve:
        """Return the curve of a text 'mm:passing,...', with the fraction of the mass that passes each sieve opening.

        Raises :class:`SceneError` if the text has another form; `field` and `allowed` are the name of the parameter and
        its allowed values in the message.
        """
        try:
            openings, passing = zip(*(map(float, part.split(":")) for part in text.split(",")), strict=True)
        except ValueError:
            hint = "for example '5:0,10:0.4,20:1', pairs of opening [mm] and passing share of the mass"
            refuse(field, text, allowed, hint)
        return cls(tuple(1e-3 * opening for opening in openings), tuple(passing))

    def retained(self, size: float) -> float:
        """Return the mass fraction that is coarser than a size [m]."""
        return 1 - float(np.interp(np.log(size), np.log(self.openings), self.passing))

    def above(self, size: float) -> SieveCurve:
        """Return the grading curve of the grains coarser than `size` [m], which must be below the largest size."""
        if size <= self.smallest:
            return self
        finer, part = 1 - self.retained(size), self.retained(size)
        coarser = [(o, (p - finer) / part) for o, p in zip(self.openings, self.passing, strict=True) if o > size]
        openings, passing = zip((size, 0.0), *coarser, strict=True)
        return SieveCurve(openings, (*passing[:-1], 1.0))

    @property
    def smallest(self) -> float:
        """Smallest size of the grading curve [m]."""
        return self.openings[0]

    @property
    def largest(self) -> float:
        """Largest size of the grading curve [m]."""
        return self.openings[-1]

    def sample(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Return `count` random sizes [m].

        Between two openings, the mass fraction rises linearly with the logarithm of the size d, so the number of grains
        per size is proportional to d^-4. Inverting the cumulative distribution of d turns uniform random numbers into
        sizes.
        """
        openings, part = np.array(self.openings), np.diff(self.passing)
        inverse_cubes = openings**-3
        # Number of grains between each pair of neighbouring sieve openings, up to a common factor.
        number = part * (inverse_cubes[:-1] - inverse_cubes[1:]) / np.log(openings[1:] / openings[:-1])
        fraction = random.choice(len(part), size=count, p=number / number.sum())
        u = random.uniform(size=count)
        low, high = inverse_cubes[fraction + 1], inverse_cubes[fraction]
        return (low + u * (high - low)) ** (-1 / 3)


Sizes = Gaussian | Uniform | SieveCurve


def _check_range(smallest: float, largest: float) -> None:
    positive("smallest size", smallest, "m")
    positive("largest size", largest, "m")
    if largest < smallest:
        refuse("largest size", largest, f"must not be below the smallest ({smallest:g} m)")
