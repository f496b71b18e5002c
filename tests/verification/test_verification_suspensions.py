"""Aggregates in a mortar against closed forms and published solutions."""

import pytest
from conftest import verification

from warpcrete.verification import (
    suspensions,
    suspensions_clumps,
    suspensions_friction,
    suspensions_gaps,
    suspensions_many,
)

test_suspensions = pytest.mark.thorough(verification(suspensions))
test_gaps = pytest.mark.thorough(verification(suspensions_gaps))
test_clumps = pytest.mark.thorough(verification(suspensions_clumps))
test_friction = pytest.mark.thorough(verification(suspensions_friction))
test_suspensions_many = pytest.mark.thorough(verification(suspensions_many))
