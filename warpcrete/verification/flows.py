"""Flows of a Bingham fluid with a slip layer, by moving particles, against the closed form."""

from __future__ import annotations

from ..mps.column import FlowParameters, column_scene
from ..mps.simulation import FluidSimulation
from ..mps.theory import CONCRETES
from .case import Case, Row

# Measured errors at 5 mm in the channel: pressure 0.0 to 0.1 %, slip velocity 0.03 to 0.1 %, profile 0.1 %; at 10 mm in
# the tube 0.2, 0.3 and 0.3 %.
CHANNEL = {"pressure": 2.5e-3, "slip_velocity": 2e-3, "profile": 2e-3, "volume": 2e-4, "balance": 2e-3}
TUBE = {"pressure": 4e-3, "slip_velocity": 5e-3, "profile": 4e-3, "volume": 8e-4, "balance": 4e-3}


def _flow(dimensions: int, mix: str, device: str, precision: str) -> list[Row]:
    allowed = CHANNEL if dimensions == 2 else TUBE
    spacing = 5e-3 if dimensions == 2 else 10e-3
    scene = column_scene("flow", dimensions, FlowParameters(concrete=mix, spacing=spacing))
    result = FluidSimulation(scene, device=device, precision=precision).run().result
    theory, pressure, slip = scene.theory(), result["pressure"]["value"], result["slip_velocity"]["value"]
    return [
        Row(f"{mix} pressure", pressure, theory.pressure, allowed["pressure"], "Pa"),
        Row(f"{mix} slip velocity", slip, theory.slip_velocity, allowed["slip_velocity"], "m/s"),
        Row(f"{mix} profile, rms over mean", result["profile_error"], 0.0, allowed["profile"], scale=1.0),
        Row(f"{mix} volume", 1 + result["volume_error"], 1.0, allowed["volume"]),
        Row(f"{mix} balance of forces", result["force_balance_error"], 0.0, allowed["balance"], scale=1.0),
    ]  # fmt: skip


def channel(device: str, precision: str) -> list[Row]:
    """Three concretes between planes, in two dimensions."""
    return [row for mix in CONCRETES for row in _flow(2, mix, device, precision)]


def tube(device: str, precision: str) -> list[Row]:
    """Three concretes in a round pipe."""
    return [row for mix in CONCRETES for row in _flow(3, mix, device, precision)]


CASES = [
    Case("Bingham flow between planes", "closed form with slip", channel, "flows"),
    Case("Bingham flow in a tube", "Buckingham and Reiner with slip", tube, "flows"),
]
