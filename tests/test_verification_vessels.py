"""Flows in vessels of any shape against closed forms."""

from conftest import verification

from warpcrete.verification import spreading, starting, vessels

test_vessels = verification(vessels)
test_spreading = verification(spreading)
test_starting = verification(starting)
