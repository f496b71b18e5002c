"""Aggregates in a mortar against closed forms and published solutions."""

import pytest
from conftest import verification

from warpcrete.verification import suspensions

test_suspensions = pytest.mark.thorough(verification(suspensions))
