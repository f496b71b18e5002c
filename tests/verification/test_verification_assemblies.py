"""Many bodies: conservation, Janssen, angle of repose."""

import pytest
from conftest import verification

from warpcrete.verification import assemblies

test_assemblies = pytest.mark.thorough(verification(assemblies))
