"""Flows in vessels of any shape against closed forms."""

from conftest import verification

from warpcrete.verification import vessels

test_vessels = verification(vessels)
