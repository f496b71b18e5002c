"""The limit of stability for every contact law."""

from conftest import verification

from warpcrete.verification import stability

test_stability = verification(stability)
