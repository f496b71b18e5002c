"""Tests of amounts with units in messages: messages quote them as the user wrote them and suggest no other unit."""

import copy
import json
import pickle
import warnings

import numpy as np
import pytest
from pumping import command

from warpcrete import SceneError, scenes
from warpcrete.core.errors import PlausibilityWarning
from warpcrete.core.inputs.amounts import amount
from warpcrete.core.inputs.limits import check_limit, check_velocity
from warpcrete.core.inputs.yaml_files import yaml_text
from warpcrete.geometry.lines import line_of
from warpcrete.geometry.pumps import pump_of
from warpcrete.mix.mix import mix_of
from warpcrete.studies.lines.answers import time_text

LINE = {"diameter": "125 mm", "concrete": "no1", "flow": "30 m3/h", "parts": [{"straight": "10 m"}]}


def warned(make):
    """Return the texts of all warnings that `make` gives."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        make()
    return [str(each.message) for each in caught if issubclass(each.category, PlausibilityWarning)]


def refused(make):
    """Return the message of the error with which `make` refuses its input."""
    with pytest.raises(SceneError) as caught:
        make()
    return str(caught.value)


def test_an_amount_keeps_its_text_and_computes_as_a_number():
    flow = amount("flow", " 30 m3/h ", "m3/s")
    assert flow == 30 / 3600 and flow.text == "30 m3/h"
    assert pickle.loads(pickle.dumps(flow)).text == copy.deepcopy(flow).text == "30 m3/h"
    assert json.dumps(flow) == str(flow) == repr(30 / 3600)
    assert type(2 * flow) is type(flow + 0.0) is float and np.asarray([flow]).dtype == np.float64
    assert type(amount("flow", "30", "m3/s")) is float and type(amount("flow", 30, "m3/s")) is float


@pytest.mark.parametrize(
    ("text", "unit", "name"),
    [("2000 m3/h", "m3/s", "flow"), ("5 m", "m", "diameter"), ("2 mm", "m", "diameter"), ("12 m/s", "m/s", "velocity"),
     ("800 kg/m3", "kg/m3", "density"), ("19 in", "m", "size_max"), ("2 MPa", "Pa", "yield_stress")],
)  # fmt: skip
def test_unusual_amounts_with_a_unit_are_quoted_without_a_suggestion(text, unit, name):
    (said,) = warned(lambda: check_limit(name, amount(name, text, unit), unit))
    assert said.startswith(f"{name} = {text}: is unusual: ") and "did you mean" not in said


def test_unusual_numbers_without_a_unit_still_cause_a_suggestion():
    (said,) = warned(lambda: check_limit("velocity", 12.0, "m/s"))
    assert said.startswith("velocity = 12 m/s: is unusual: ") and said.endswith("did you mean 12 cm/s?")


def test_impossible_amounts_with_a_unit_are_quoted_without_a_suggestion():
    said = refused(lambda: check_limit("diameter", amount("diameter", "125 m", "m"), "m"))
    assert said.startswith("diameter = '125 m': is impossible: ") and "did you mean" not in said
    assert "did you mean 125 mm" in refused(lambda: check_limit("diameter", 125.0, "m"))


def test_a_velocity_that_follows_from_a_flow_quotes_the_flow():
    flow = amount("flow", "2000 m3/h", "m3/s")
    (said,) = warned(lambda: check_velocity("flow", flow, 45.3))
    assert said.startswith("flow = 2000 m3/h: makes the concrete flow at 45.3 m/s")


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda: line_of({**LINE, "diameter": "-125 mm"}), "diameter = '-125 mm': must be a finite number above 0 m"),
        (lambda: line_of({**LINE, "parts": [{"straight": "-5 cm"}]}), "part 1, straight: length = '-5 cm': must be a"),
        (lambda: line_of({**LINE, "largest_stone": "200 mm"}), "largest_stone = '200 mm': does not pass through"),
        (lambda: pump_of("0.5 bar"), "pump pressure = '0.5 bar': must be at least"),
        (lambda: mix_of({"density": "2350 kg/m3", "slump": "400 mm"}), "mix slump = '400 mm': must be in [0.01, 0.29]"),
        (lambda: scenes.pipe(velocity="-3 cm/s"), "velocity = '-3 cm/s': must be a finite number above 0 m/s"),
        (lambda: scenes.tube(slip_thickness="90 mm"), "slip_thickness = '90 mm': must be at least 0 and below 0.05 m"),
        (lambda: scenes.tube(spacing="90 mm"), "spacing = '90 mm': leaves 1.1 particles across the pipe"),
    ],
)
def test_refused_amounts_are_quoted_as_written(make, expected):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PlausibilityWarning)
        assert refused(make).startswith(expected)


def test_a_scene_of_amounts_with_units_equals_a_scene_of_numbers():
    written, plain = scenes.pipe(diameter="100 mm", velocity="30 cm/s"), scenes.pipe(diameter=0.1, velocity=0.3)
    assert dict(written.parameters) == dict(plain.parameters)
    assert json.dumps(dict(written.parameters)) == json.dumps(dict(plain.parameters))


def test_a_file_of_a_concrete_contains_plain_numbers():
    assert yaml_text({"density": amount("density", "2.35 t/m3", "kg/m3")}) == "density: 2350.0\n"


def test_the_command_quotes_an_option_as_written():
    shape = ("--diameter", "125 mm", "--length", "10 m", "--concrete", "no1")
    done = command("line", *shape, "--flow", "-3 m3/h")
    assert done.returncode == 2 and "flow = '-3 m3/h': must be a finite number above 0" in done.stderr
    done = command("line", *shape, "--flow", "2000 m3/h")
    assert done.returncode == 0 and "passes it in 0.22 s" in done.stdout


def test_short_times_have_two_digits():
    assert [time_text(each) for each in (0.2206, 5.0, 9.4, 44.0, 180.0)] == ["0.22 s", "5 s", "9.4 s", "44 s", "3 min"]
