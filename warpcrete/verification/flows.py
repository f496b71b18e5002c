"""Verification of pipe flows of a yield stress fluid with a slip layer against closed forms.

The method of moving particles and the flow on a grid are both verified.
"""

from ..mps.column import FlowParameters, column_scene
from ..mps.scene import FluidScene
from ..mps.simulation import FluidSimulation
from ..theory.pipe import CONCRETES
from .case import Case, Row

PROFILE = "relative rms profile error"
# Largest measured relative errors of three results, pressure, slip velocity and velocity profile:
# - channel with a particle spacing of 5 mm: 0.1, 0.1 and 0.1 %,
# - tube with a particle spacing of 10 mm: 0.2, 0.3 and 0.3 %.
CHANNEL = {"pressure": 2.5e-3, "slip_velocity": 2e-3, "profile": 2e-3, "volume": 2e-4, "balance": 2e-3}
TUBE = {"pressure": 4e-3, "slip_velocity": 5e-3, "profile": 4e-3, "volume": 8e-4, "balance": 4e-3}


def _flow(dimensions: int, mix: str, device: str, precision: str) -> list[Row]:
    allowed = CHANNEL if dimensions == 2 else TUBE
    spacing = 5e-3 if dimensions == 2 else 10e-3
    scene = column_scene("flow", dimensions, FlowParameters(concrete=mix, spacing=spacing, ends="piston"))
    result = FluidSimulation(scene, device=device, precision=precision).run().result
    theory, pressure, slip = scene.theory(), result["pressure"]["value"], result["slip_velocity"]["value"]
    return [
        Row(f"{mix} pressure", pressure, theory.pressure, allowed["pressure"], "Pa"),
        Row(f"{mix} slip velocity", slip, theory.slip_velocity, allowed["slip_velocity"], "m/s"),
        Row(f"{mix} {PROFILE}", result["profile_error"], 0.0, allowed["profile"], scale=1.0),
        Row(f"{mix} volume", 1 + result["volume_error"], 1.0, allowed["volume"]),
        Row(f"{mix} balance of forces", result["force_balance_error"], 0.0, allowed["balance"], scale=1.0),
    ]


def channel(device: str, precision: str) -> list[Row]:
    """Compare flows of three concretes between planes, computed by moving particles, with the closed form."""
    return [row for mix in CONCRETES for row in _flow(2, mix, device, precision)]


def tube(device: str, precision: str) -> list[Row]:
    """Compare flows of three concretes in a round pipe, computed by moving particles, with the closed form."""
    return [row for mix in CONCRETES for row in _flow(3, mix, device, precision)]


# Largest measured relative errors of the wall stress and the velocity profile, with cells of 5 mm:
# - channel: 0.01 % and 0.06 %,
# - tube: 0.07 % and 0.10 %.
SHEARED = {"wall": 1.5e-3, "profile": 2e-3, "balance": 2e-3}


def _sheared(dimensions: int, device: str, precision: str) -> list[Row]:
    rows = []
    for number, layer in ((0.0, 1e6), (0.0, 4e3), (1.0, 1e6), (10.0, 1e6), (100.0, 1e6)):
        speed, viscosity, radius = 0.19, 20.0, 0.05
        given = FlowParameters(
            concrete="own", density=2400.0, viscosity=viscosity, yield_stress=number * viscosity * speed / radius,
            slip_viscosity=layer, slip_yield=0.0, ends="periodic", length=0.06, spacing=5e-3, duration=0.3,
        )  # fmt: skip
        name = f"Bn {number:g}" + (", slips" if layer < 1e6 else "")
        rows += _rows(name, column_scene("flow", dimensions, given), device, precision)
    return rows


def _rows(name: str, scene: FluidScene, device: str, precision: str) -> list[Row]:
    """Run a sheared flow; compare its wall stress, velocity profile and balance of forces with theory."""
    result = FluidSimulation(scene, device=device, precision=precision).run().result
    return [
        Row(f"{name}: wall stress", result["wall_stress"]["value"], result["wall_stress_theory"]["value"],
            SHEARED["wall"], "Pa"),
        Row(f"{name}: {PROFILE}", result["profile_error"], 0.0, SHEARED["profile"], scale=1.0),
        Row(f"{name}: balance of forces", result["force_balance_error"], 0.0, SHEARED["balance"], scale=1.0),
    ]  # fmt: skip


def sheared_channel(device: str, precision: str) -> list[Row]:
    """Compare flows between planes, computed on a grid, with theory.

    The concrete has a Bingham number of 0 to 100, and it sticks to the planes or slips a little.
    """
    return _sheared(2, device, precision)


def sheared_tube(device: str, precision: str) -> list[Row]:
    """Compare flows in a round pipe, computed on a grid, with theory.

    The concrete has a Bingham number of 0 to 100, and it sticks to the wall or slips a little.
    """
    return _sheared(3, device, precision)


# Flow laws other than Bingham's. If a name contains "layer", the law replaces Bingham's law in the slip layer,
# otherwise in the concrete itself. Laws with a flow index get constants such that, at the mean velocity U and the mean
# shear rate U / R in a pipe of radius R, they give the same stress as Bingham's law. The measured relative errors with
# cells of 5 mm are at most 0.10 % (wall stress) and 0.07 % (velocity profile).
LAWS = {
    "n 0.5": {"flow_index": 0.5}, "n 0.8": {"flow_index": 0.8}, "n 1.3": {"flow_index": 1.3},
    "n 1.6": {"flow_index": 1.6}, "c 5 Pa s2": {"quadratic_viscosity": 5.0},
    "layer n 0.5": {"slip_flow_index": 0.5}, "layer n 1.6": {"slip_flow_index": 1.6},
    "layer c 3000 Pa s2/m2": {"slip_quadratic_viscosity": 3000.0},
}  # fmt: skip


def _other_laws(dimensions: int, device: str, precision: str) -> list[Row]:
    rows = []
    for name, law in LAWS.items():
        speed, radius = 0.19, 0.05
        slips = any(key.startswith("slip") for key in law)
        viscosity = 20.0 * (speed / radius) ** (1 - law.get("flow_index", 1.0))
        layer = 1000.0 * speed ** (1 - law.get("slip_flow_index", 1.0)) if slips else 1e6
        given = FlowParameters(
            concrete="own", density=2400.0, viscosity=viscosity, yield_stress=76.0, slip_viscosity=layer,
            slip_yield=20.0 if slips else 0.0, ends="periodic", length=0.06, spacing=5e-3, duration=0.3, **law,
        )  # fmt: skip
        rows += _rows(name, column_scene("flow", dimensions, given), device, precision)
    return rows


def other_channel(device: str, precision: str) -> list[Row]:
    """Compare flows of Herschel-Bulkley and modified Bingham concrete between planes with theory."""
    return _other_laws(2, device, precision)


def other_tube(device: str, precision: str) -> list[Row]:
    """Compare flows of Herschel-Bulkley and modified Bingham concrete in a round pipe with theory."""
    return _other_laws(3, device, precision)


CASES = [
    Case("Bingham flow between planes", "closed form with slip", channel, "flows"),
    Case("Bingham flow in a tube", "Buckingham and Reiner with slip", tube, "flows"),
    Case("sheared flow between planes", "closed form", sheared_channel, "flows"),
    Case("sheared flow in a tube", "Buckingham and Reiner", sheared_tube, "flows"),
    Case("other flow laws between planes", "closed forms of both laws", other_channel, "flows"),
    Case("other flow laws in a tube", "closed forms of both laws", other_tube, "flows"),
]
