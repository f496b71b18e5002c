"""Flow laws of concrete and of its slip layer: stress as a function of shear rate, its inverse, and integrals.

Each law serves for the bulk, where g is the shear rate [1/s], and for the slip layer, where g is the slip velocity
instead. The stress is tau, the yield stress is tau_0, and mu, k, n and c are the other constants of the laws:

- Bingham: tau = tau_0 + mu g.
- Herschel-Bulkley: tau = tau_0 + k g^n. It thickens with the rate for n > 1 and thins for n < 1.
- Modified Bingham: tau = tau_0 + mu g + c g^2 (Yahia & Khayat 2001). It thickens, and its viscosity at low rates is mu.

The stress in a pipe or a channel grows linearly from the middle to the wall. Velocities and flows are therefore
integrals over the stress. They have closed forms if they are written as functions of the shear rate g at the wall. Let
h(g) = tau - tau_0 be the viscous stress. Velocities and flows are then sums of three integrals J_0, J_1 and J_2, where
J_j is the integral of g h^j h'(g) dg from 0 to g.
"""

from dataclasses import dataclass

import numpy as np

BINGHAM, HERSCHEL_BULKLEY, MODIFIED_BINGHAM = "bingham", "herschel-bulkley", "modified-bingham"
"""Names of the flow laws, which also select the kernels of a simulation."""


def law_name(index: float, quadratic: float) -> str:
    """Return the name of the flow law with a flow index n and a coefficient c of the squared shear rate."""
    if index != 1.0:
        return HERSCHEL_BULKLEY
    return MODIFIED_BINGHAM if quadratic > 0 else BINGHAM


@dataclass(frozen=True)
class FlowLaw:
    """Law of a yield stress fluid, tau = tau_0 + mu g^n + c g^2, with the shear stress tau and the shear rate g.

    Either n is 1 or c is 0. All methods take numbers or arrays and return arrays.
    """

    yield_stress: float
    """Yield stress tau_0 of the flow law [Pa]."""
    viscosity: float
    """Plastic viscosity mu [Pa s], or consistency k [Pa s^n] of the Herschel-Bulkley law.

    In the law of a slip layer, mu or k is divided by the n-th power of the layer's thickness.
    """
    index: float = 1.0
    """Flow index n of the flow law; 1 for a Bingham fluid."""
    quadratic: float = 0.0
    """Coefficient c of the squared rate in the modified Bingham law: [Pa s2] with shear rates, [Pa s2/m2] with slip
    velocities; 0 in the other laws."""

    @property
    def words(self) -> str:
        """Flow index or quadratic coefficient of the law as text after other constants; empty for Bingham's law."""
        if self.index != 1:
            return f", flow index {self.index:g}"
        return f", quadratic {self.quadratic:g}" if self.quadratic else ""

    @property
    def name(self) -> str:
        """Name of the law, such as :data:`HERSCHEL_BULKLEY`."""
        return law_name(self.index, self.quadratic)

    def stress(self, rate: object) -> np.ndarray:
        """Return the stress [Pa] at nonnegative shear rates [1/s], or slip velocities [m/s] for a slip layer's law."""
        g = np.asarray(rate, float)
        if self.name == HERSCHEL_BULKLEY:
            return self.yield_stress + self.viscosity * g**self.index
        return self.yield_stress + self.viscosity * g + self.quadratic * g * g

    def rate(self, stress: object) -> np.ndarray:
        """Return the shear rate [1/s], or slip velocity [m/s], at stresses [Pa]; up to the yield stress it is 0."""
        return self._rate_of_excess(np.maximum(np.asarray(stress, float) - self.yield_stress, 0.0))

    def _rate_of_excess(self, excess: np.ndarray) -> np.ndarray:
        """Return the rate g at which the viscous stress h(g), stress minus yield stress, equals `excess` [Pa]."""
        if self.name == HERSCHEL_BULKLEY:
            with np.errstate(over="ignore"):
                return (excess / self.viscosity) ** (1 / self.index)
        if self.name == MODIFIED_BINGHAM:
            # The usual formula for the root of mu g + c g^2 = excess subtracts nearly equal numbers if c is small. This
            # equivalent form loses no digits.
            root = np.sqrt(self.viscosity**2 + 4 * self.quadratic * excess)
            return 2 * excess / (self.viscosity + root)
        return excess / self.viscosity

    def integrals(self, stress: object) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the integrals J_0, J_1 and J_2 up to a `stress`.

        J_j is the integral of g h^j dh [Pa^(j + 1) / s]. Here h is the viscous stress, which is the stress minus the
        yield stress, and g is the shear rate at this stress. J_0 is therefore also the integral of the rate over the
        stress.
        """
        h = np.maximum(np.asarray(stress, float) - self.yield_stress, 0.0)
        g = self._rate_of_excess(h)
        if self.name != MODIFIED_BINGHAM:
            n = self.index
            with np.errstate(over="ignore"):
                return g * h * n / (n + 1), g * h**2 * n / (2 * n + 1), g * h**3 * n / (3 * n + 1)
        # With the shear rate g, let a be the viscosity times g, and b the quadratic coefficient times g^2. The
        # integrals are then sums of positive terms only, so no digits are lost by subtraction.
        a, b = self.viscosity * g, self.quadratic * g * g
        return (
            g * (a / 2 + 2 * b / 3),
            g * (a * a / 3 + 3 * a * b / 4 + 2 * b * b / 5),
            g * (a**3 / 4 + 4 * a * a * b / 5 + 5 * a * b * b / 6 + 2 * b**3 / 7),
        )

    def mean_velocity(self, stress: object, radius: float, form: str) -> np.ndarray:
        """Return the velocity [m/s] that shear adds to the slip velocity, averaged over the cross-section.

        `stress` is the shear stress tau at the wall [Pa], and g is the shear rate at a stress s. In a pipe of `radius`
        R, the mean is R / tau^3 times the integral of g s^2 ds over s from 0 to tau. In a channel of half-width R
        (`form` "plane"), it is R / tau^2 times the integral of g s ds. With the yield stress tau_0 and s = tau_0 + h,
        both are sums of the integrals that :meth:`integrals` returns.
        """
        tau = np.asarray(stress, float)
        zero, one, two = self.integrals(tau)
        yields = self.yield_stress
        with np.errstate(over="ignore", invalid="ignore"):
            safe = np.where(tau > 0, tau, 1.0)
            if form == "plane":
                return radius / safe**2 * (yields * zero + one)
            return radius / safe**3 * (yields**2 * zero + 2 * yields * one + two)

    def stream(self, outer: object, inner: object) -> np.ndarray:
        """Return the integral of g s^2 ds from s = `inner` to s = `outer` [Pa3/s].

        Here s is the shear stress [Pa] and g the shear rate at this stress [1/s]. The flow through an annulus of a pipe
        that is due to shear is pi times this integral, divided by the cube of the stress gradient.
        """
        high, low = self.integrals(outer), self.integrals(inner)
        zero, one, two = (a - b for a, b in zip(high, low, strict=True))
        return self.yield_stress**2 * zero + 2 * self.yield_stress * one + two
