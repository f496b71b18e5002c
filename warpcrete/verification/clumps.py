"""Verification of clumps: mass properties compared with exact integrals, and free tumbling of a triaxial body."""

import math

import numpy as np

from ..dem.scene.clumps import clump, reference
from ..dem.scene.scene import Bodies, Scene, TimeStep
from .case import Case, Row, start


def union_properties(device, precision) -> list[Row]:
    """Compare volume and moments of inertia of overlapping spheres in a row with numerical quadrature."""
    del device, precision  # The mass properties are computed on the host in double precision.
    rows = []
    for label, centres, radii in (
        ("two equal spheres", [0.0, 1.0], [1.0, 1.0]),
        ("unequal spheres", [0.0, 1.3], [1.0, 0.7]),
        ("three in a row", [0.0, 1.2, 2.3], [1.0, 0.8, 0.9]),
    ):
        x = np.linspace(-1.2, 3.4, 2_000_001)
        inside = [np.maximum(r**2 - (x - c) ** 2, 0.0) for c, r in zip(centres, radii, strict=True)]
        square = np.max(inside, axis=0)  # Square of the radius of the union of spheres at each x.
        volume = np.trapezoid(math.pi * square, x)
        centre = np.trapezoid(math.pi * square * x, x) / volume
        along = np.trapezoid(math.pi / 2 * square**2, x)
        across = np.trapezoid(math.pi / 4 * square**2 + math.pi * square * (x - centre) ** 2, x)
        template = clump(label, np.array([[c, 0.0, 0.0] for c in centres]), np.array(radii))
        # Clump templates are scaled so that the sphere of equal volume has a diameter of 1. Multiply by the diameter of
        # this sphere to undo the scaling.
        size = (6 * volume / math.pi) ** (1 / 3)
        ours = np.sort(template.inertia) * volume * size**2
        rows += [
            Row(f"{label}: size of the unit clump's first sphere", float(template.radii[0] * size), radii[0], 3e-5),
            Row(f"{label}: moment about the row", float(ours[0]), along, 6e-5),
            Row(f"{label}: moment across it", float(ours[2]), across, 6e-5),
        ]
    return rows


def tumbling(device, precision) -> list[Row]:
    """Check energy, angular momentum and period of a freely tumbling body over 1e5 steps.

    The body has three different principal moments of inertia. The exact period contains Jacobi's elliptic functions.
    """
    shape = max(reference(), key=lambda t: float(np.diff(np.sort(t.inertia)).min()))
    density, size, rate = 2500.0, 0.02, 50.0
    mass = density * math.pi / 6 * size**3
    inertia = shape.inertia * mass * size**2
    order = np.argsort(inertia)
    local = np.zeros(3)
    # Let the body rotate near its unstable (intermediate) principal axis, because this motion is the most difficult to
    # compute accurately.
    local[order] = rate * np.array([0.15, 1.0, 0.2])
    dt = 2e-4
    scene = Scene(
        name="tumble", duration=1.0, gravity=(0, 0, 0), time_step=TimeStep(fixed=dt, safety=4.0),
        bodies=(Bodies(positions=[[0.0, 0, 0]], sizes=size, template=shape, density=density, spins=local[None]),),
    )  # fmt: skip
    stepper = start(scene, device, precision)
    # The period of the free rotation is 4 K(m) times `scale` (Landau & Lifshitz, Mechanics, section 37).
    small, middle, large = inertia[order]
    momentum = inertia * local
    energy = 0.5 * float(momentum @ local)
    square = float(momentum @ momentum)
    if square > 2 * energy * middle:
        modulus = (middle - small) * (2 * energy * large - square) / ((large - middle) * (square - 2 * energy * small))
        scale = math.sqrt(small * middle * large / ((large - middle) * (square - 2 * energy * small)))
    else:
        modulus = (large - middle) * (square - 2 * energy * small) / ((middle - small) * (2 * energy * large - square))
        scale = math.sqrt(small * middle * large / ((middle - small) * (2 * energy * large - square)))
    period = 4 * _elliptic_k(modulus) * scale

    steps, chunk = 100_000, 20
    axis = int(order[1])
    times, worst = [], 0.0
    before = 1.0
    for number in range(steps // chunk):
        stepper.take(chunk)
        spin = stepper.state.bodies.spin.numpy()[0].astype(float)
        turned = _inverse_rotated(stepper.state.bodies.orientation.numpy()[0].astype(float), spin)
        worst = max(worst, abs(0.5 * float(inertia @ turned**2) / energy - 1))
        now = turned[axis]
        if now > 0 >= before:
            times.append((number + now / (now - before) * -1.0) * chunk * dt)
        before = now
    ours = float(np.diff(times).mean())
    kept = stepper.state.bodies.angular_momentum.numpy()[0].astype(float)
    drift = float(np.linalg.norm(kept - momentum) / np.linalg.norm(momentum))
    label = f"energy over {steps} steps, {len(times)} somersaults: largest error"
    return [
        Row(label, worst, 0.0, 2e-5 if precision == "float32" else 2e-6, scale=1.0),
        Row("angular momentum at the end", drift, 0.0, 1e-7 if precision == "float32" else 1e-14, scale=1.0),
        Row("period of the somersaults (Jacobi)", ours, period, 1.5e-4 if precision == "float32" else 1e-5, "s"),
    ]


def _inverse_rotated(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    twice = 2 * np.cross(-q[:3], v)
    return v + q[3] * twice + np.cross(-q[:3], twice)


def _elliptic_k(parameter: float) -> float:
    """Return the complete elliptic integral of the first kind, K(m) with m = `parameter`.

    It is computed by the arithmetic-geometric mean.
    """
    a, b = 1.0, math.sqrt(1 - parameter)
    while abs(a - b) > 1e-15 * a:
        a, b = 0.5 * (a + b), math.sqrt(a * b)
    return math.pi / (2 * a)


CASES = [
    Case("clump mass properties", "exact union of spheres in a row", union_properties, "clumps"),
    Case("free tumbling", "Euler's equations, Jacobi's elliptic functions", tumbling, "clumps"),
]
