"""Bonds against beam theory and predicted loads."""

from conftest import verification

from warpcrete.verification import bonds

test_bonds = verification(bonds)
