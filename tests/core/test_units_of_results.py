"""Units and meanings of all declared quantities and parameters, for readers of tables and for pint."""

import re

import pytest

from warpcrete import scenes
from warpcrete.core.inputs.amounts import UNITS
from warpcrete.core.run.tables import dataset, with_powers
from warpcrete.methods import METHODS

FACTOR = r"(?:1|Pa|J|N|W|kg|m|s|h|deg|degrees)(?:\^[23])?"
POWERS = re.compile(rf"{FACTOR}(?: {FACTOR})*(?:/{FACTOR}(?: {FACTOR})*)?")
"""Pattern of a unit that pint reads: symbols that pint knows, with exponents behind ^, separated by spaces or /."""


def declared_units():
    """Return the units of all results, parameters and amounts."""
    results = {each.unit for method in METHODS for each in method.quantities}
    fields = {f.unit.strip() for module in scenes.modules().values() for f in module.scene.fields({}).values()}
    return sorted((results | fields | set(UNITS)) - {""})


@pytest.mark.parametrize("unit", declared_units())
def test_units_in_datasets_have_exponents_that_pint_reads(unit):
    assert POWERS.fullmatch(with_powers(unit)) and with_powers(unit).replace("^", "") == unit


def test_a_dataset_has_powers_and_no_empty_units():
    pytest.importorskip("xarray", reason="needs xarray, which the extra [test] installs")
    found = dataset({"time": [0.0], "flow": [1.0], "outcome": ["finished"]}, {"time": "s", "flow": "m3/s"}, "time", {})
    assert found["flow"].attrs["units"] == "m^3/s" and found["time"].attrs["units"] == "s"
    assert "units" not in found["outcome"].attrs


def test_every_result_has_a_meaning_for_the_reference_pages():
    missing = [each.name for method in METHODS for each in method.quantities if not each.meaning]
    assert not missing
    for method in METHODS:
        for each in method.quantities:
            first = each.meaning[0]
            assert not each.meaning.endswith(".") and (first in "`1" or first.isupper()), each.name
