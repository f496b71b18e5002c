"""Flows in vessels of any shape against closed forms."""

import pytest
from conftest import verification

from warpcrete.verification import spreading, starting, vessels

test_vessels = pytest.mark.thorough(verification(vessels))
test_spreading = pytest.mark.thorough(verification(spreading))
test_starting = pytest.mark.thorough(verification(starting))
