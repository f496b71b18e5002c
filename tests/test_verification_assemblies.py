"""Many bodies: conservation, Janssen, angle of repose."""

from conftest import verification

from warpcrete.verification import assemblies

test_assemblies = verification(assemblies)
