"""Measured cases, their predictions, and the comparison of both."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import kept
import numpy as np
import pytest
from click.testing import CliRunner

from warpcrete.cli.main import cli
from warpcrete.core.errors import SceneError
from warpcrete.core.units import quantity
from warpcrete.mix.rheology import FLATTEST, HEAP_CENTRE_MEDIAN, RHEOMETER_OVER_HEAP
from warpcrete.studies.validation import predictions, simulated
from warpcrete.studies.validation.cases import ADDED, FITTED, held_out_groups, read_cases, shipped_cases
from warpcrete.studies.validation.comparison import compare
from warpcrete.studies.validation.figure import draw
from warpcrete.studies.validation.kinds import UNITS
from warpcrete.studies.validation.predictions import PREDICTORS, mix_of_case
from warpcrete.studies.validation.simulated import representatives, simulate
from warpcrete.studies.validation.validate import validate
from warpcrete.theory.bands import combined
from warpcrete.theory.inverse import BASE, HEIGHT, TOP, VOLUME
from warpcrete.theory.pipe import Concrete, Line, steady
from warpcrete.theory.vessels import heap_at_rest, tall_cone_slump

PIPE = """\
sources: {{own: "our yard, 2026"}}
cases:
  - id: yard
    kind: pipe
    source: own
    where: log 7
    mix: {{density: 2350, concrete: {{yield_stress: 60 Pa, viscosity: 40 Pa s, uncertainty: 0}},
          layer: {{viscosity: 500 Pa s/m, yield_stress: 20 Pa, uncertainty: 10 %}}}}
    test: {{diameter: 125 mm}}
    flow: [20 m3/h, 40 m3/h]
    measured: [{one} kPa/m, {two} kPa/m]
"""
OWN = Concrete(name="yard", density=2350, viscosity=40, yield_stress=60, slip_viscosity=500, slip_yield=20)


def gradient(flow: float, concrete: Concrete = OWN) -> float:
    return steady(concrete, Line(radius=0.0625, length=1.0, rise=0.0), flow / 3600).pressure


def written(tmp_path, text):
    path = tmp_path / "cases.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_case_is_predicted_as_a_user_would(tmp_path):
    """Twice the predicted friction is measured: the ratio is one half, outside a band of the layer's 10 %."""
    exact = [gradient(20), gradient(40)]
    path = written(tmp_path, PIPE.format(one=2 * exact[0] / 1e3, two=2 * exact[1] / 1e3))
    (case,) = read_cases(path)
    found = compare(case)
    assert found.ratio == pytest.approx(0.5) and not found.inside
    thin, thick = (Concrete(**{**vars(OWN), "slip_viscosity": x * 500, "slip_yield": x * 20}) for x in (0.9, 1.1))
    ends = [combined(gradient(q), {"layer": (gradient(q, thin), gradient(q, thick)),
                                   "density": (gradient(q), gradient(q))}) for q in (20, 40)]  # fmt: skip
    assert found.band.low == pytest.approx(math.sqrt(ends[0].low * ends[1].low))
    assert found.band.high == pytest.approx(math.sqrt(ends[0].high * ends[1].high))
    assert case.source == "our yard, 2026, log 7" and UNITS[case.kind] == "Pa/m"


def test_a_pressure_below_the_weight_of_the_concrete_is_refused(tmp_path):
    """A line that rises by 10 m needs 2350 kg/m3 * 9.81 m/s2 * 10 m = 2.305 bar without any friction."""
    text = PIPE.replace("kind: pipe", "kind: line").replace("diameter: 125 mm", "line: site")
    lines = "lines: {{site: {{diameter: 125 mm, begin: up, parts: [straight: 10]}}}}\n"
    (case,) = read_cases(written(tmp_path, (lines + text).format(one=1, two=1).replace("kPa/m", "bar")))
    with pytest.raises(SceneError, match=r"^case measured = '1 bar': must exceed .* line, 2\.305e\+05 Pa; check"):
        compare(case)


def test_a_mean_of_several_concretes_counts_each_of_them(tmp_path):
    """Five concretes between 0.8 and 1.25 times the prediction, in a band of 10 %: the middle part is inside."""
    exact = gradient(20) / 1e3
    scatter = f"\n    scatter: {{concretes: 5, from: {0.8 * exact} kPa/m, to: {1.25 * exact} kPa/m}}"
    text = PIPE.format(one=exact, two=1).replace("[20 m3/h, 40 m3/h]", "20 m3/h").replace(", 1 kPa/m]", f"]{scatter}")
    plain = text.replace("id: yard", "id: other").replace(scatter, "").partition("cases:\n")[2]
    cases = read_cases(written(tmp_path, text + plain))
    found = compare(cases[0])
    expected = np.log(found.band.high / found.band.low) / np.log(1.25 / 0.8)
    assert cases[0].concretes == 5 and found.inside == pytest.approx(expected) and 0.3 < expected < 0.5
    (whole,) = [x for x in validate(cases, quick=True).summaries() if x.chosen == "all"]
    assert whole.inside == pytest.approx((5 * expected + 1) / 6)
    # If the mean is the value of a model, it has a row of its own, and the summary counts one measurement.
    found = validate(read_cases(written(tmp_path, text.replace("where: log 7", "basis: model") + plain)), quick=True)
    rows = {x.basis: (x.count, x.inside) for x in found.summaries()}
    assert rows == {"measurement": (1, 1.0), "model": (1, pytest.approx(expected))}
    assert found.counts().startswith("1 of these values were measured. Those of a model (1) or a guideline (0)")
    assert found.record()["cases"][0]["basis"] == "model" and "| yard | pipe | model |" in found.table()
    moved = text.replace(f"from: {0.8 * exact}", f"from: {1.2 * exact}").replace(
        f"measured: [{exact}", f"measured: [{1.22 * exact}"
    )
    far = written(tmp_path, moved)
    assert compare(read_cases(far)[0]).inside == 0.0


def test_bands_add_up_by_cause():
    """Two causes of a factor of two each make a factor of 2^sqrt(2); a third that changes nothing has no share."""
    found = combined(10.0, {"one": (5.0, 20.0), "two": (20.0, 5.0), "none": (10.0, 10.0)})
    assert (found.low, found.high) == pytest.approx((10 / 2 ** math.sqrt(2), 10 * 2 ** math.sqrt(2)))
    assert found.shares == pytest.approx({"one": 0.5, "two": 0.5, "none": 0.0})
    assert found.factor == pytest.approx(2 ** math.sqrt(2)) and found.contains(25) and not found.contains(27)
    lone = combined(0.0, {"one": (-3.0, 4.0), "two": (0.0, 3.0)})
    assert (lone.low, lone.high) == pytest.approx((-3.0, 5.0))


def test_a_third_of_the_groups_is_held_out_and_no_fitted_one():
    cases = shipped_cases()
    held = held_out_groups(cases)
    for kind in UNITS:
        added = set(ADDED.get(kind, ()))
        groups = {case.group for case in cases if case.kind == kind}
        own = {group for of, group in held if of == kind}
        assert added <= own <= groups - set(FITTED.get(kind, ()))
        free = groups - set(FITTED.get(kind, ())) - added
        assert len(own - added) == min(round(len(groups - added) / 3), len(free))
    assert held == held_out_groups(cases[::-1])


def test_shipped_predictions_of_pipes_hold():
    """Figures of notebooks/validation/measurements.md: held-out pipes and self-compacting over ordinary concrete."""
    found = validate(kinds=["pipe", "ratio", "line", "layer"], quick=True)
    assert not found.refused
    rows = [each for each in found.summaries() if each.kind == "pipe"]
    (measured,) = [each for each in rows if each.basis == "measurement"]
    assert measured.chosen == "all, held out" and measured.count == 1 and measured.inside == 1
    pipes = {each.chosen: each for each in rows if each.basis == "model"}
    assert pipes["all"].count == 12 and pipes["held out"].count == 3
    assert pipes["held out"].error < 0.3 and pipes["held out"].inside == pytest.approx(1.0)
    assert pipes["all"].inside == pytest.approx(0.935, abs=0.01)  # of 64 concretes
    assert 0.85 < pipes["all"].ratio < 1.15 and pipes["all"].factor < 1.8
    ratios = {each.case.name: each for each in found.comparisons if each.case.kind == "ratio"}
    assert 1.6 < ratios["takeda-1994-powder"].band.value < 5 and ratios["takeda-1994-powder"].inside
    assert 2 < ratios["takeda-1994-thickener"].band.value < 5


@pytest.mark.thorough
def test_slumps_of_real_concrete_lie_in_their_bands():
    """Yeh's cones: every pair of slump and spread is accepted, and the median error is below 10 %."""
    found = validate(kinds=["slump"], quick=True)
    assert not found.refused
    (summary,) = [each for each in found.summaries() if each.chosen == "others"]
    assert summary.error < 0.10 and 0.85 < summary.inside < 0.95 and summary.count == 80
    assert [each.count for each in found.summaries() if each.basis == "model"] == [4]
    stiff = [each for each in found.comparisons if each.case.group == "ferraris-1998"]
    assert len(stiff) == 4 and not any(each.held_out for each in stiff)
    assert all(each.ratio < 0.5 for each in stiff) and [each.inside for each in stiff] == [1.0, 1.0, 1.0, 0.0]
    held = [each for each in found.comparisons if each.held_out]
    assert {each.case.group for each in held} == {"suzuki-2004"} and all(each.inside for each in held)


def test_the_band_of_a_rheometer_holds_nine_of_ten_slumps():
    """Draw 4000 concretes from the relation of Ferraris & de Larrard (1998) with a mean deviation of 162 Pa."""
    draws = np.random.default_rng(1)
    stresses = np.geomspace(5, 6000, 120)
    slumps = np.array([min(HEIGHT - heap_at_rest(VOLUME, x, 2400)[1], tall_cone_slump(TOP, BASE, HEIGHT, x, 2400))
                       for x in stresses])  # fmt: skip
    measured = draws.uniform(0.05, 0.27, 4000)
    rheometer = 2400 * (30 - 100 * measured) / 34.7 + 212 + draws.normal(0, 162 * math.sqrt(math.pi / 2), 4000)
    measured, rheometer = measured[rheometer > 50], rheometer[rheometer > 50]
    heap = np.exp(np.interp(measured, slumps[::-1], np.log(stresses[::-1])))
    quantiles = np.quantile(rheometer / heap, [0.5, 0.9])
    assert quantiles == pytest.approx([2.3, 5.4], rel=0.03)
    assert np.mean(rheometer / heap < RHEOMETER_OVER_HEAP) == pytest.approx(0.89, abs=0.01)


def test_powder_rich_families_have_two_to_five_times_the_friction_of_others():
    """Compare nine families with a water-binder ratio below 0.3 with the three above 0.4, as ratios of 27 pairs."""
    found = [each for each in validate(kinds=["pipe"], quick=True).comparisons if "coils" in each.case.name]
    lean, rich = ([each for each in found if (float(each.case.mix["water_binder"]) < 0.3) == side] for side in (0, 1))
    assert (len(lean), len(rich)) == (3, 9)
    measured = [x.measured / y.measured for x in rich for y in lean]
    predicted = [x.band.value / y.band.value for x in rich for y in lean]
    assert np.median(measured) == pytest.approx(2.25, abs=0.02) and np.median(predicted) == pytest.approx(2.7, abs=0.05)
    assert np.quantile(measured, [0.05, 0.95]) == pytest.approx([1.3, 4.9], abs=0.05)


@pytest.mark.thorough
def test_a_simulated_slump_is_compared_as_well(device):
    """Yeh's median cone, 235 mm: a homogeneous heap slumps further, as the closed form without piled-up stones does."""
    (case,) = [each for each in representatives(shipped_cases()) if each.group == "yeh-2007"]
    found = simulate(case, False, device=device, spacing=12.5e-3)
    heap = compare(case).band.value + HEAP_CENTRE_MEDIAN
    assert found.simulated and found.measured == pytest.approx(case.measured[0])
    assert found.band.value == pytest.approx(heap, rel=0.05) and found.band.value > found.measured


def test_the_command_writes_tables_and_a_figure(tmp_path):
    path = written(tmp_path, PIPE.format(one=gradient(20) / 1e3, two=gradient(40) / 1e3))
    out = tmp_path / "out"
    done = CliRunner().invoke(cli, ["validate", "--cases", str(path), "--every", "--out", str(out), "--quiet"])
    assert done.exit_code == 0, done.output
    assert "| yard | pipe | measurement | no | Pa/m |" in done.output and "| 1.00 | 100 % |" in done.output
    assert {each.name for each in out.iterdir()} == {f"validation.{end}" for end in ("md", "csv", "json", "png")}
    again = CliRunner().invoke(cli, ["validate", "--cases", str(path), "--out", str(out)])
    assert again.exit_code != 0
    wrong = CliRunner().invoke(cli, ["validate", "--kind", "pipes"])
    assert "kind = 'pipes': must be one of pipe" in str(wrong.exception)
    for more in ([], ["--quick"]):
        lost = CliRunner().invoke(cli, ["validate", "--cases", str(path), "--device", "cuda:99", *more])
        assert str(lost.exception).startswith("device = 'cuda:99': ")


def test_a_wrong_prediction_does_not_squeeze_the_measurements():
    """The measured values set the width of a panel, and measured and predicted values its height."""
    cases: Any = [
        SimpleNamespace(
            case=SimpleNamespace(kind="slump", basis="measured"), measured=measured, simulated=False, held_out=False,
            band=SimpleNamespace(value=value, low=value, high=0.3),
        ) for measured, value in ((0.1, 0.005), (0.25, 0.2))
    ]  # fmt: skip
    (axes,) = draw(cases).axes
    assert axes.get_xlim() == pytest.approx((100 / 1.6, 250 * 1.6))
    assert axes.get_ylim() == pytest.approx((5 / 2, 250 * 2))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("kind: pipe", "kind: pope", "case kind = 'pope': must be one of pipe"),
        ("source: own", "source: mine", "case source = 'mine': must be one of own"),
        ("where: log 7", "basis: hearsay", "case basis = 'hearsay': must be one of measurement, model, guideline"),
        ("where: log 7", "were: log 7", "key of a case = 'were': must be one of id"),
        ("[20 m3/h, 40 m3/h]", "[20 m3/h]", "case measured = '2 values': must have one value for each of the 1 flows"),
        ("measured: [1 kPa/m, 2 kPa/m]", "measured: [1 kPa, 2 kPa]", "case measured = '1 kPa': must be a number"),
        ("id: yard", "ids: yard", "key of a case = 'ids'"),
        ("flow: [20 m3/h, 40 m3/h]", "note: none", "case flow: is missing in a case of kind 'pipe'"),
        ("[1 kPa/m, 2 kPa/m]", "[0 kPa/m, 2 kPa/m]", "case measured = '0 kPa/m'"),
        ("{diameter: 125 mm}", "125 mm", "cases test = '125 mm': must consist of"),
        ("where: log 7", "scatter: {concretes: 5}", "has no 'from'; for example {concretes: 6"),
        ("where: log 7", "scatter: {concretes: 1, from: 1 kPa/m, to: 2 kPa/m}", "must be a whole number of at least 2"),
        ("where: log 7", "scatter: {concretes: 3, from: 2 kPa/m, to: 1 kPa/m}", "must reach from a positive value"),
        ("where: log 7", "scatter: {concretes: 3, from: 1 kPa/m, to: 2 kPa/m}", "needs a single measured value"),
        ("where: log 7", "scatter: {concretes: 3, of: 2}", "key of a scatter = 'of'"),
        ("cases:", "case:", "key of a file of cases = 'case'"),
        (
            "{diameter: 125 mm}",
            "{diamter: 125 mm}",
            "case test = 'diamter': is not an entry of a case of kind 'pipe'",
        ),
        ("{diameter: 125 mm}", "{}", "case test = 'yard': has no 'diameter'; add 'diameter: ...'"),
        ("[20 m3/h, 40 m3/h]", "[20, 40]", "case flow = 20.0: is impossible"),
        ("[1 kPa/m, 2 kPa/m]", "[]", "case measured = []: has no value"),
        ("[20 m3/h, 40 m3/h]", "[]", "case flow: is missing in a case of kind 'pipe'"),
    ],
)
def test_files_of_cases_with_errors_are_refused_in_one_line(tmp_path, old, new, says):
    text = PIPE.format(one=1, two=2)
    assert old in text
    with pytest.raises(SceneError) as refused:
        read_cases(written(tmp_path, text.replace(old, new)))
    assert says in str(refused.value) and "\n" not in str(refused.value)


def test_a_refused_case_is_listed_with_its_reason(tmp_path):
    text = PIPE.format(one=1, two=2).replace("density: ", "densty: ")
    path = written(tmp_path, text)
    found = validate(read_cases(path), quick=True)
    line = next(k for k, each in enumerate(text.splitlines(), 1) if "densty" in each)
    assert found.comparisons == [] and found.refused["yard"].startswith(f"{path.name}, line {line}: mix key = 'densty'")


@pytest.mark.parametrize("measured", [2, 0.5, -1])
def test_a_concrete_blocked_or_did_not(tmp_path, measured):
    text = "sources: {a: b}\ncases:\n- {id: a, kind: blocking, source: a, test: {bore: 125 mm}, measured: {}}\n"
    with pytest.raises(
        SceneError, match=r"line 3: case measured = .*: must be 1 if the concrete blocked, or 0 if it did not"
    ):
        read_cases(written(tmp_path, text.replace("{}", str(measured))))


def test_rules_against_blocking_are_compared_with_what_blocked():
    found = validate(kinds=["blocking", "fitting"], quick=True)
    by_name = {each.case.name: each for each in found.blocking}
    assert by_name["tuutti-240"].blocked and by_name["tuutti-240"].agrees and "powder" in by_name["tuutti-240"].rules
    for name in ("lightweight-1in-in-4in", "nara-lightweight"):
        assert by_name[name].blocked and by_name[name].rules == "lightweight aggregate"
    assert not by_name["frankfurt-1977"].agrees  # stones of 32 mm in 125 mm are a hair above a quarter of the bore
    wrong = {"frankfurt-1977", "houston-1979", "mayco-pea-gravel"}
    assert {each.case.name for each in found.blocking if not each.agrees} == wrong
    assert {each.verdict for each in found.blocking if not each.agrees and not each.blocked} == {"risky"}
    assert "agree with 18 of 21 observations" in found.table() and len(found.record()["blocking"]) == 21
    assert all(each.inside for each in found.comparisons)
    assert [(x.band.low, x.band.high) for x in found.comparisons] == [pytest.approx((1, 3))] * 2


def test_the_width_of_bands_agrees_with_the_scatter_of_the_cases():
    """Compare deviations with half the width of the band on their side, both on a logarithmic scale.

    For bands that hold nine of ten values of a normal distribution, the root mean square of this ratio is 1 / 1.645.
    The numbers are those of the page on measurements.
    """
    found = validate(kinds=["pipe", "slump"], quick=True).comparisons

    def scores(each):
        values = [each.measured] if each.case.ends is None else np.geomspace(*each.case.ends, each.case.concretes)
        off = np.log(np.array(values) / each.band.value)
        below, above = math.log(each.band.value / each.band.low), math.log(each.band.high / each.band.value)
        return 1.645 * off / np.where(off > 0, above, below)

    def spread(chosen):
        return math.sqrt(np.mean(np.concatenate([scores(each) for each in chosen]) ** 2))

    pipes = [each for each in found if each.case.kind == "pipe"]
    assert spread([x for x in pipes if not x.held_out]) == pytest.approx(1.03, abs=0.005)
    assert spread([x for x in pipes if x.held_out]) == pytest.approx(0.70, abs=0.005)
    slumps = [x for x in found if x.case.kind == "slump" and not x.held_out and x.band.low > 0.006]
    assert spread(slumps) == pytest.approx(0.79, abs=0.005)


def test_every_shipped_measurement_is_positive_and_has_a_source():
    for case in shipped_cases():
        assert np.all(np.array(case.measured) >= 0) and len(case.source) > 20
        assert case.kind == "blocking" or min(case.measured) > 0


def test_kept_predictions(monkeypatch):
    """Bands of one measured case of each kind (see `kept`); the time of a funnel, which takes seconds, is made up."""

    def funnel_time(*given, layer, **law):
        (outlet, top), (low, high), depth, viscosity, stress, density = given
        slips = 1.0 if layer is None else 0.7 + 1e-4 * layer[0] + 1e-3 * layer[1] + 0.1 * sum(layer[2:])
        return (viscosity + 0.1 * stress) * slips * sum(law.values()) * top * high * depth / (outlet * low * density)

    monkeypatch.setattr(predictions, "funnel_time", funnel_time)
    first = {}
    for case in shipped_cases():
        first.setdefault(case.kind, case)
    del first["blocking"]
    assert set(first) == set(PREDICTORS)
    kept.compare(
        "predictions",
        {kind: [case.name, [[b.value, b.low, b.high, b.shares] for b in PREDICTORS[kind](case)]]
         for kind, case in first.items()},
    )  # fmt: skip


@pytest.mark.parametrize("kind", ["slump", "spread", "funnel"])
def test_a_simulation_gets_the_concrete_of_the_case(kind, monkeypatch):
    """Its result, which is made up, takes the place of the closed form; both have the same relative band."""
    cases = [each for each in representatives(shipped_cases()) if each.kind == kind]
    case, scenes = cases[0], []

    def simulation(scene, *, device):
        scenes.append([scene, device])
        names = {"slump": "slump", "spread": "spread", "funnel": "funnel_time"}
        result = {names[kind]: quantity(0.123, "m")}
        return SimpleNamespace(run=lambda: SimpleNamespace(finished=len(scenes) < 2, result=result))

    form = compare(next(each for each in shipped_cases() if each.kind == "slump"))
    monkeypatch.setattr(simulated, "method_of", lambda scene: SimpleNamespace(simulation=simulation))
    monkeypatch.setattr(simulated, "compare", lambda known: form)  # that of a funnel takes seconds
    found = simulate(case, True, device="cpu", spacing=0.015)
    assert found.simulated and found.held_out and found.measured == form.measured and found.case is case
    assert found.band.value == 0.123 and found.band.shares == form.band.shares
    assert [found.band.low, found.band.high] == pytest.approx(
        [0.123 * each / form.band.value for each in (form.band.low, form.band.high)]
    )
    ((scene, device),) = scenes
    own = mix_of_case(case).concrete
    assert device == "cpu" and scene.spacing == 0.015 and scene.name == ("funnel" if kind == "funnel" else "slump")
    for name in ("viscosity", "yield_stress", "density", "slip_viscosity"):
        assert getattr(scene.concrete, name) == getattr(own, name)
    with pytest.raises(KeyboardInterrupt):
        simulate(case, False, device="cpu")


def test_the_band_of_a_simulated_slump_ends_at_a_flat_heap(monkeypatch):
    (case,) = [each for each in representatives(shipped_cases()) if each.group == "ferraris-1998"]
    run = SimpleNamespace(finished=True, result={"slump": quantity(0.123, "m")})
    made = SimpleNamespace(simulation=lambda scene, device: SimpleNamespace(run=lambda: run))
    monkeypatch.setattr(simulated, "method_of", lambda scene: made)
    form = compare(case).band
    assert 0.123 * form.high / form.value > 0.3 and simulate(case, False, device="cpu").band.high == FLATTEST


def test_the_case_with_the_median_stands_for_its_group():
    cases = shipped_cases()
    chosen = representatives(cases)
    assert [case.kind for case in chosen] == sorted([case.kind for case in chosen], key=["slump", "spread",
                                                                                        "funnel"].index)  # fmt: skip
    for case in chosen:
        values = sorted(each.measured[0] for each in cases if (each.kind, each.group) == (case.kind, case.group))
        assert case.measured[0] == values[len(values) // 2]
