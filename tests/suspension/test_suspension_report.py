"""Lines of the report of a mortar with aggregates."""

from types import SimpleNamespace

import numpy as np

from warpcrete.suspension import quantities


def test_the_parts_of_aggregates_and_mortar_that_remain_are_told(monkeypatch):
    """With 20 % of aggregates, half of which remain, 65 % of the concrete are 68.75 % of the mortar."""
    monkeypatch.setattr(quantities, "report", lambda run: iter([("first", "line")]))
    run = SimpleNamespace(
        series={"aggregates_inside": np.array([1.0, 0.9, 0.5]), "inside": np.array([1.0, 0.95, 0.65])},
        result={"aggregates": {"fraction": 0.2}},
    )
    words = "50.0 % of their volume remains, and 68.8 % of the mortar"
    assert list(quantities.report_aggregates(run)) == [("first", "line"), ("aggregates", words)]
    run.series.pop("aggregates_inside")
    assert list(quantities.report_aggregates(run)) == [("first", "line")]
