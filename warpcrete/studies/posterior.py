"""Which parameters the measured values allow: emulators of a few runs, and a posterior over the free parameters.

Each fitted quantity has a Gaussian process over the free parameters, in the unit cube of their ranges, that takes the
runs' scatter (their seeds) as noise. The posterior is that of normal errors of the targets, of which the emulator's own
uncertainty is a part, with a flat prior over the ranges (Kennedy & O'Hagan 2001, without a term for a wrong model). It
is sampled by an ensemble of walkers (Goodman & Weare 2010).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .targets import Target, Task

SEARCHED = 2048
"""Points of the unit cube from which the walkers begin at the best."""
WALKERS, STEPS, DISCARDED = 64, 300, 100
WIDTH = 0.15
"""Of the neighbourhood in the unit cube in which a failed run makes others doubtful."""
FLAT = 1 / np.sqrt(12)
"""Standard deviation of a parameter in its range of which nothing is known."""


class Emulator:
    """A Gaussian process of one quantity: linear trend, smooth rest, scatter."""

    def __init__(self, points: np.ndarray, values: np.ndarray, least: float) -> None:
        """`points` of the unit cube, shape (n, free), have `values`, shape (n,); `least` is a difference in values that
        means nothing."""
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import RBF, ConstantKernel, DotProduct, WhiteKernel

        free = points.shape[1]
        self.middle, self.scale = float(values.mean()), max(float(values.std()), least)
        smooth = ConstantKernel(0.3, (1e-4, 1e2)) * RBF([0.7] * free, (0.15, 10.0))
        kernel = DotProduct(1.0, (1e-2, 1e2)) + smooth + WhiteKernel(1e-3, (1e-8, 1.0))
        self.process = GaussianProcessRegressor(kernel, n_restarts_optimizer=1, random_state=0, alpha=1e-9)
        with warnings.catch_warnings():  # hyperparameters at a bound are no concern
            warnings.simplefilter("ignore")
            self.process.fit(points - 0.5, (values - self.middle) / self.scale)
        fitted: Any = self.process.kernel_
        self.scatter = self.scale * float(np.sqrt(fitted.k2.noise_level))
        """Standard deviation of single runs about the mean."""

    def __call__(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean over seeds and its standard deviation at points of the unit cube, shapes (n,)."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            mean, deviation = map(np.asarray, self.process.predict(points - 0.5, return_std=True))
        variance = np.maximum((self.scale * deviation) ** 2 - self.scatter**2, 0.0)
        return self.middle + self.scale * mean, np.sqrt(variance)


@dataclass
class Posterior:
    """What the runs so far say of the free parameters."""

    task: Task
    emulators: dict[Target, Emulator]
    """Of fitted targets, and of those held out that have values."""
    samples: np.ndarray
    """Points of the unit cube, shape (n, free), as likely as the targets make them."""
    best: np.ndarray
    """The likeliest point, shape (free,)."""

    def predicted(self, target: Target, points: np.ndarray | None = None) -> tuple[float, float]:
        """Mean and standard deviation of a target's quantity over the posterior, or at points; NaN without values."""
        if target not in self.emulators:
            return math.nan, math.nan
        mean, deviation = self.emulators[target](self.samples if points is None else points)
        return float(mean.mean()), float(np.sqrt(mean.var() + (deviation**2).mean()))

    def doubt(self, target: Target) -> float:
        """Standard deviation of the emulator where the posterior is, over the target's uncertainty."""
        return float(np.sqrt((self.emulators[target](self.samples)[1] ** 2).mean()) / target.uncertainty)

    def span(self, target: Target) -> tuple[float, float]:
        """Lowest and highest mean of a quantity within the ranges."""
        mean, _ = self.emulators[target](_spread(len(self.task.free), 512, 1))
        return float(mean.min()), float(mean.max())

    def interval(self, place: int, part: float = 0.95) -> tuple[float, float]:
        """Values of a free parameter between which the middle `part` of the posterior lies."""
        edge = 50 * (1 - part)
        low, high = np.percentile(self.samples[:, place], [edge, 100 - edge])
        return self.task.free[place].value(low), self.task.free[place].value(high)

    def narrowing(self, place: int) -> float:
        """Standard deviation of a parameter over that of its range without any data."""
        return float(self.samples[:, place].std() / FLAT)

    def correlations(self) -> np.ndarray:
        """Of the free parameters in the posterior, as they are searched, shape (free, free)."""
        return np.atleast_2d(np.corrcoef(self.samples.T))


def posterior(task: Task, points: np.ndarray, values: dict[Target, np.ndarray], seed: int) -> Posterior:
    """The posterior of runs at `points` of the unit cube, shape (n, free).

    `values` holds what they gave for each target, shape (n,), NaN where a run failed: three or more of every
    fitted one.
    """
    import emcee
    from scipy.optimize import minimize

    emulators = {}
    for target, found in values.items():
        there = np.isfinite(found)
        if target.held_out and there.sum() < 3:
            continue
        emulators[target] = Emulator(points[there], found[there], 1e-3 * target.uncertainty)
    sound = np.all([np.isfinite(values[target]) for target in task.fitted], axis=0)

    def likelihood(at: np.ndarray) -> np.ndarray:
        inside = np.all((at >= 0) & (at <= 1), axis=1)
        held = np.clip(at, 0.0, 1.0)
        total = _trusted(held, points, sound)
        for target in task.fitted:
            mean, deviation = emulators[target](held)
            variance = target.uncertainty**2 + deviation**2
            total -= 0.5 * ((target.value - mean) ** 2 / variance + np.log(variance / target.uncertainty**2))
        return np.where(inside, total, -np.inf)

    free = len(task.free)
    spread = _spread(free, SEARCHED, seed)
    order = np.argsort(-likelihood(spread))
    walkers = max(WALKERS, 4 * free)
    random = np.random.default_rng(seed)
    begin = np.clip(spread[order[:walkers]] + random.normal(0, 1e-3, (walkers, free)), 1e-6, 1 - 1e-6)
    sampler = emcee.EnsembleSampler(walkers, free, likelihood, vectorize=True)
    state = emcee.State(begin, random_state=np.random.RandomState(seed).get_state())
    sampler.run_mcmc(state, STEPS, skip_initial_state_check=True)
    samples = np.asarray(sampler.get_chain(discard=DISCARDED, flat=True, thin=4))
    chances = np.asarray(sampler.get_log_prob(discard=DISCARDED, flat=True, thin=4))
    start = samples[np.argmax(chances)]
    refined = minimize(lambda u: -float(likelihood(u[None])[0]), start, method="Nelder-Mead",
                       bounds=[(0.0, 1.0)] * free)  # fmt: skip
    best = refined.x if refined.fun <= -chances.max() else start
    return Posterior(task, emulators, samples, np.clip(best, 0.0, 1.0))


def _spread(free: int, count: int, seed: int) -> np.ndarray:
    """Points that fill the unit cube evenly, shape (count, free)."""
    from scipy.stats import qmc

    return qmc.Sobol(free, seed=seed).random_base2(int(np.ceil(np.log2(count))))[:count]


def _trusted(at: np.ndarray, points: np.ndarray, sound: np.ndarray) -> np.ndarray:
    """Logarithm of the chance that a run succeeds: by the sound ones among those nearby."""
    if sound.all():
        return np.zeros(len(at))
    near = np.exp(-0.5 * ((at[:, None] - points[None]) ** 2).sum(-1) / WIDTH**2)
    return np.log((near @ sound + 0.05) / (near.sum(1) + 0.05))


def told_apart(found: Posterior, close: float = 0.9) -> list[tuple[str, str, float]]:
    """Pairs of parameters of which the data fix hardly more than a combination, with their correlation."""
    names = [free.name for free in found.task.free]
    matrix = found.correlations()
    return [
        (names[i], names[j], float(matrix[i, j]))
        for i in range(len(names))
        for j in range(i + 1, len(names))
        if abs(matrix[i, j]) >= close
    ]


def unmoved(found: Posterior, targets: Sequence[Target]) -> dict[Target, tuple[float, float]]:
    """Targets that no free parameter moves by as much as a fifth of their uncertainty, or as the runs' scatter."""
    spans: dict[Any, tuple[float, float]] = {target: found.span(target) for target in targets}
    return {
        target: (low, high)
        for target, (low, high) in spans.items()
        if high - low < 0.2 * target.uncertainty or high - low < found.emulators[target].scatter
    }
