"""Bayesian calibration: emulators trained on few runs, and the posterior of the free parameters.

For each target quantity, a Gaussian process over the unit cube of parameter ranges replaces the simulation; it takes
the scatter between seeds as noise. With a flat prior over the ranges, the logarithm of the posterior is

    -1/2 sum [(z - m)^2 / v + ln v],  v = s^2 + e^2,

where z and s are the measured value and its uncertainty, and m and e are the emulator's mean and uncertainty (Kennedy &
O'Hagan 2001, without their term for model error). An ensemble of walkers samples the posterior (Goodman & Weare 2010).
"""

import math
import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...core.device.interrupts import defer_interrupts
from .targets import Target, Task

START_CANDIDATES = 2048
"""Number of parameter sets at which the posterior density is evaluated. Those with the highest density become the
starting points of the walkers that sample the posterior."""
WALKERS, STEPS, DISCARDED_STEPS = 64, 300, 100
FAILURE_RADIUS = 0.15
"""Distance from a failed run within which other runs are considered less likely to succeed. Each parameter is scaled to
0 to 1 over its range."""
UNIFORM_DEVIATION = 1 / np.sqrt(12)
"""Standard deviation of a uniform distribution on the interval from 0 to 1."""


class Emulator:
    """Gaussian process that predicts one quantity as a linear trend, a smooth deviation from it, and noise."""

    def __init__(self, points: np.ndarray, values: np.ndarray, least: float, extra: np.ndarray | float = 0.0) -> None:
        """Fit a Gaussian process to `values`, shape (n,), at `points` with coordinates from 0 to 1, shape (n, free).

        The values are divided by their standard deviation, or by `least` if `least` is larger. Differences between the
        values that are small compared with `least` are therefore negligible. `extra` is the standard deviation of an
        error that the values have in addition to the scatter between seeds, shape (n,) or a number.
        """
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import RBF, ConstantKernel, DotProduct, WhiteKernel

        free = points.shape[1]
        self.middle, self.scale = float(values.mean()), max(float(values.std()), least)
        smooth = ConstantKernel(0.3, (1e-4, 1e2)) * RBF([0.7] * free, (0.15, 10.0))
        kernel = DotProduct(1.0, (1e-2, 1e2)) + smooth + WhiteKernel(1e-3, (1e-8, 1.0))
        self.process = GaussianProcessRegressor(
            kernel, n_restarts_optimizer=1, random_state=0, alpha=1e-9 + (extra / self.scale) ** 2
        )
        # The fit warns if a parameter of the covariance function reaches the bound of its allowed range. Suppress this
        # warning, because the fitted function is valid at the bound, too.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self.process.fit(points - 0.5, (values - self.middle) / self.scale)
        fitted: Any = self.process.kernel_
        self.scatter = self.scale * float(np.sqrt(fitted.k2.noise_level))
        """Standard deviation of the results of single runs about the mean over many seeds, in the unit of the
        quantity."""

    def __call__(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the predicted mean over many seeds, and the standard deviation of this prediction, both of shape (n,).

        `points` holds the free parameters, each scaled to 0 to 1 over its range, shape (n, free).
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            mean, deviation = map(np.asarray, self.process.predict(points - 0.5, return_std=True))
        variance = np.maximum((self.scale * deviation) ** 2 - self.scatter**2, 0.0)
        return self.middle + self.scale * mean, np.sqrt(variance)


class TwoLevelEmulator:
    """Emulator that is trained on coarse and on full runs.

    The prediction is the sum of an emulator of the coarse runs and an emulator of the difference between full and
    coarse runs. The difference is small and smooth, so few full runs determine it. This is the method of Kennedy &
    O'Hagan (Biometrika 87 (2000) 1) with a factor of 1 between the two levels.
    """

    def __init__(
        self, coarse: Emulator, points: np.ndarray, values: np.ndarray, least: float, extra: np.ndarray
    ) -> None:
        """Fit an emulator to the difference between the results of full runs and the predictions of `coarse`.

        `points`, `values`, `least` and `extra` describe the full runs, as in :class:`Emulator`.
        """
        self.coarse = coarse
        self.difference = Emulator(points, values - coarse(points)[0], least, extra)
        self.scatter = self.difference.scatter
        """Standard deviation of the results of single runs about the mean over many seeds, in the unit of the
        quantity."""

    def __call__(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the predicted mean over many seeds, and the standard deviation of this prediction, both of shape (n,).

        `points` holds the free parameters, each scaled to 0 to 1 over its range, shape (n, free).
        """
        (low, one), (change, other) = self.coarse(points), self.difference(points)
        return low + change, np.hypot(one, other)


@dataclass
class Posterior:
    """Posterior of the free parameters, given the runs so far."""

    task: Task
    emulators: dict[Target, Emulator | TwoLevelEmulator]
    """Gaussian processes that predict the quantities of the targets, by target. Every fitted target has one. A target
    that is held out from the fit has one if at least three runs yielded its value."""
    samples: np.ndarray
    """Samples of the posterior of the free parameters, each scaled to 0 to 1 over its range, shape (samples, free)."""
    best: np.ndarray
    """Likeliest values of the free parameters, each scaled to 0 to 1 over its range, shape (free,)."""

    def predicted(self, target: Target, points: np.ndarray | None = None) -> tuple[float, float]:
        """Return the mean and standard deviation of the predictions for a target's quantity; NaN without an emulator.

        The predictions are made at `points`, shape (n, free), by default at the posterior samples. The coordinates of a
        point are the free parameters, each scaled to 0 to 1 over its range.
        """
        if target not in self.emulators:
            return math.nan, math.nan
        mean, deviation = self.emulators[target](self.samples if points is None else points)
        return float(mean.mean()), float(np.sqrt(mean.var() + (deviation**2).mean()))

    def emulator_error_ratio(self, target: Target) -> float:
        """Return the emulator's standard error, divided by the uncertainty of the target.

        The standard error is the root mean square of the emulator's standard deviations at the posterior samples.
        """
        return float(np.sqrt((self.emulators[target](self.samples)[1] ** 2).mean()) / target.uncertainty)

    def span(self, target: Target) -> tuple[float, float]:
        """Return the lowest and highest predicted mean of a target's quantity within the parameter ranges."""
        mean, _ = self.emulators[target](_sobol_points(len(self.task.free), 512, 1))
        return float(mean.min()), float(mean.max())

    def interval(self, place: int, part: float = 0.95) -> tuple[float, float]:
        """Return the central interval that holds the fraction `part` of a parameter's posterior samples.

        `place` is the index of the free parameter. The interval is extended to the likeliest value if this value lies
        outside.
        """
        edge = 50 * (1 - part)
        low, high = np.percentile(self.samples[:, place], [edge, 100 - edge])
        # The likeliest value may lie outside the central interval, for example at an end of the range.
        low, high = min(low, self.best[place]), max(high, self.best[place])
        return self.task.free[place].value(low), self.task.free[place].value(high)

    def relative_width(self, place: int) -> float:
        """Return a parameter's standard deviation in the posterior, divided by the standard deviation of its prior.

        The prior is uniform over the parameter's range, and `place` is the index of the parameter.
        """
        return float(self.samples[:, place].std() / UNIFORM_DEVIATION)

    def correlations(self) -> np.ndarray:
        """Return the correlations between the free parameters in the posterior samples, shape (free, free)."""
        return np.atleast_2d(np.corrcoef(self.samples.T))


@dataclass(frozen=True)
class CoarseRuns:
    """Results of the coarse runs of a calibration."""

    points: np.ndarray
    """Free parameters of the runs, each scaled to 0 to 1 over its range, shape (n, free)."""
    values: Mapping[Target, np.ndarray]
    """Results for each target, shape (n,), with NaN for failed runs."""
    doubtful: Mapping[Target, np.ndarray]
    """True for values from runs that failed checks, by target, shape (n,)."""
    coarsened: Collection[Target]
    """Targets whose scene had wider cells in the coarse runs. For all other targets, coarse runs are as accurate as
    full runs."""


def posterior(
    task: Task, points: np.ndarray, values: Mapping[Target, np.ndarray], seed: int,
    doubtful: Mapping[Target, np.ndarray] | None = None, coarse: CoarseRuns | None = None, model_error: float = 0.0,
) -> Posterior:  # fmt: skip
    """Compute the posterior from runs at `points`, shape (n, free).

    The coordinates of a point are the free parameters, each scaled to 0 to 1 over its range. `values` holds the results
    of these runs for each target, shape (n,), with NaN for failed runs. Every fitted target needs at least three finite
    values. `seed` makes the sampling reproducible. `doubtful` holds for each target an array of shape (n,), which is
    True for values from runs that failed checks. Such values get a further error, whose standard deviation is the
    uncertainty of the target. The results of `coarse` runs, if there are any, also train the emulators. `model_error`
    is the standard deviation of an error of the simulation model itself, as a fraction of the measured value.
    """
    import emcee
    from scipy.optimize import minimize
    from threadpoolctl import threadpool_limits

    emulators: dict[Target, Emulator | TwoLevelEmulator] = {}
    for target, found in values.items():
        there = np.isfinite(found)
        if target.held_out and there.sum() < 3:
            continue
        extra = target.uncertainty * doubtful[target][there] if doubtful else np.zeros(int(there.sum()))
        emulators[target] = _emulator(target, points[there], found[there], extra, coarse)
    sound = np.all([np.isfinite(values[target]) for target in task.fitted], axis=0)

    def likelihood(at: np.ndarray) -> np.ndarray:
        inside = np.all((at >= 0) & (at <= 1), axis=1)
        held = np.clip(at, 0.0, 1.0)
        total = _log_success(held, points, sound)
        for target in task.fitted:
            mean, deviation = emulators[target](held)
            variance = target.uncertainty**2 + deviation**2 + (model_error * target.value) ** 2
            total -= 0.5 * ((target.value - mean) ** 2 / variance + np.log(variance / target.uncertainty**2))
        return np.where(inside, total, -np.inf)

    free = len(task.free)
    spread = _sobol_points(free, START_CANDIDATES, seed)
    order = np.argsort(-likelihood(spread))
    walkers = max(WALKERS, 4 * free)
    random = np.random.default_rng(seed)
    begin = np.clip(spread[order[:walkers]] + random.normal(0, 1e-3, (walkers, free)), 1e-6, 1 - 1e-6)
    sampler = emcee.EnsembleSampler(walkers, free, likelihood, vectorize=True)
    state = emcee.State(begin, random_state=np.random.RandomState(seed).get_state())
    # Delay an interruption by Ctrl-C until the sampling ends. If it arrived inside the likelihood function, emcee would
    # print a traceback before it passed the exception on. Linear algebra uses one thread, because the matrices are
    # small, with one row for each run. On a busy machine with two cores, two threads took seven times as long.
    with defer_interrupts(), threadpool_limits(1, "blas"):
        sampler.run_mcmc(state, STEPS, skip_initial_state_check=True)
    samples = np.asarray(sampler.get_chain(discard=DISCARDED_STEPS, flat=True, thin=4))
    chances = np.asarray(sampler.get_log_prob(discard=DISCARDED_STEPS, flat=True, thin=4))
    start = samples[np.argmax(chances)]
    refined = minimize(
        lambda u: -float(likelihood(u[None])[0]), start, method="Nelder-Mead", bounds=[(0.0, 1.0)] * free
    )
    best = refined.x if refined.fun <= -chances.max() else start
    return Posterior(task, emulators, samples, np.clip(best, 0.0, 1.0))


def _emulator(
    target: Target, points: np.ndarray, values: np.ndarray, extra: np.ndarray, coarse: CoarseRuns | None
) -> Emulator | TwoLevelEmulator:
    """Return the emulator of a target's quantity, trained on full runs and, if there are any, on coarse runs.

    `points`, `values` and `extra` describe the full runs, as in :class:`Emulator`.
    """
    least = 1e-3 * target.uncertainty
    if coarse is None:
        return Emulator(points, values, least, extra)
    there = np.isfinite(coarse.values[target])
    others, found = coarse.points[there], coarse.values[target][there]
    if target not in coarse.coarsened:
        together = np.concatenate([extra, target.uncertainty * coarse.doubtful[target][there]])
        return Emulator(np.concatenate([points, others]), np.concatenate([values, found]), least, together)
    if len(found) < 3 or len(values) >= len(found):
        # Ignore the coarse runs if they are too few, or if there are as many full runs, which are more accurate.
        return Emulator(points, values, least, extra)
    return TwoLevelEmulator(Emulator(others, found, least), points, values, least, extra)


def _sobol_points(free: int, count: int, seed: int) -> np.ndarray:
    """Return points that fill the unit cube evenly (a Sobol sequence), shape (count, free)."""
    from scipy.stats import qmc

    return qmc.Sobol(free, seed=seed).random_base2(int(np.ceil(np.log2(count))))[:count]


def _log_success(at: np.ndarray, points: np.ndarray, sound: np.ndarray) -> np.ndarray:
    """Return the logarithm of the probability that runs at the points `at` succeed, estimated from previous runs.

    `at` has the shape (m, free), and `points` holds the points of previous runs, shape (n, free). The coordinates of a
    point are the free parameters, each scaled to 0 to 1 over its range. `sound` is True for the previous runs that
    succeeded, shape (n,).
    """
    if sound.all():
        return np.zeros(len(at))
    near = np.exp(-0.5 * ((at[:, None] - points[None]) ** 2).sum(-1) / FAILURE_RADIUS**2)
    return np.log((near @ sound + 0.05) / (near.sum(1) + 0.05))


def confounded_pairs(found: Posterior, close: float = 0.9) -> list[tuple[str, str, float]]:
    """Return the pairs of parameters with a strong correlation, which the data cannot determine separately.

    Each entry holds both names and the correlation, whose magnitude is at least `close`.
    """
    names = [free.name for free in found.task.free]
    matrix = found.correlations()
    return [
        (names[i], names[j], float(matrix[i, j]))
        for i in range(len(names))
        for j in range(i + 1, len(names))
        if abs(matrix[i, j]) >= close
    ]


def insensitive_targets(found: Posterior, targets: Sequence[Target]) -> dict[Target, tuple[float, float]]:
    """Return the targets on which the free parameters have hardly any effect, each with its predicted range.

    The range reaches from the lowest to the highest prediction within the parameter ranges. A target is included if
    this range is narrower than a fifth of the target's uncertainty, or narrower than the scatter between seeds.
    """
    spans: dict[Any, tuple[float, float]] = {target: found.span(target) for target in targets}
    return {
        target: (low, high)
        for target, (low, high) in spans.items()
        if high - low < 0.2 * target.uncertainty or high - low < found.emulators[target].scatter
    }
