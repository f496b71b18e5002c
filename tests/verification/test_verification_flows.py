"""Flows against the closed form of a Bingham fluid with slip."""

from conftest import verification

from warpcrete.verification import flows

test_flows = verification(flows, thorough=["float32"])
