"""Properties that follow from a mix, against known answers, published measurements and simulations."""

import math

import numpy as np
import pytest
from mixes import BULK, written

from warpcrete import SceneError, Simulation, scenes
from warpcrete.core.inputs.concretes import concrete
from warpcrete.core.units import number
from warpcrete.mix.layer import layers
from warpcrete.mix.mix import mix_of, read_mix
from warpcrete.mix.reading import USUAL_AIR
from warpcrete.theory.fits import straight_line
from warpcrete.theory.inverse import (
    BASE,
    HEIGHT,
    SPREADS,
    TOP,
    VOLUME,
    viscosity_of_t500,
    viscosity_of_t500_sedran,
    yield_of_heap,
    yield_of_long_heap,
    yield_of_slump,
    yield_of_slump_measured,
)
from warpcrete.theory.pipe import CONCRETES, Concrete, Line, steady
from warpcrete.theory.suspension import mortar_of, thickening
from warpcrete.theory.vessels import heap_at_rest, long_heap_spread, tall_cone_slump


@pytest.mark.parametrize("stress", [8.0, 50.0, 200.0])
def test_a_spread_tells_the_yield_stress_that_made_it(stress):
    assert yield_of_heap(2 * heap_at_rest(VOLUME, stress, 2300.0)[0], 2300.0) == pytest.approx(stress, rel=1e-9)
    assert yield_of_long_heap(long_heap_spread(VOLUME, stress, 2300.0), 2300.0) == pytest.approx(stress, rel=1e-12)
    found = mix_of({"density": 2300, "spread": 2 * heap_at_rest(VOLUME, stress, 2300.0)[0]})["yield stress"]
    assert found.value == pytest.approx(stress, rel=1e-9) and found.low < stress < found.high


@pytest.mark.parametrize("bears", [math.sqrt(3), 2.0])
@pytest.mark.parametrize("stress", [200.0, 900.0])
def test_a_slump_tells_the_yield_stress_that_made_it(stress, bears):
    slump = tall_cone_slump(TOP, BASE, HEIGHT, stress, 2300.0, bears=bears)
    assert yield_of_slump(slump, 2300.0, bears) == pytest.approx(stress, rel=1e-6)


def test_what_was_measured_of_slumps():
    """Ferraris & de Larrard 1998 by hand: 2400 x 12 / 34.7 + 212."""
    assert yield_of_slump_measured(0.18, 2400.0) == pytest.approx(1041.97, abs=0.01)
    found = mix_of({"density": 2400, "slump": "18 cm"})["yield stress"]
    assert found.low < yield_of_slump(0.18, 2400.0, 2.0) < found.value < 1041.97 < found.high


def test_t500_against_a_fluid_without_yield_stress_and_against_sedran():
    """Widest spreads come near Huppert's viscous heap about an axis, and every one is below what a rheometer had."""
    huppert = 3 * 0.25**8 / (0.894**8 * VOLUME**3)  # time times rho g / viscosity at a radius of 250 mm
    assert viscosity_of_t500(1.0, 1.2, 2300.0) * huppert / (2300 * 9.81) == pytest.approx(0.85, abs=0.01)
    assert viscosity_of_t500_sedran(3.0, 0.65, 2300.0) == pytest.approx(98.2, abs=0.1)  # by hand
    for spread in SPREADS[1:]:
        ratio = viscosity_of_t500_sedran(1.0, spread, 2300.0) / viscosity_of_t500(1.0, spread, 2300.0)
        assert 1.3 < ratio < 2.2


@pytest.mark.thorough
def test_t500_of_a_simulated_cone_tells_its_viscosity(device):
    """A third of the viscosity and another yield stress than the relation was measured with."""
    scene = scenes.slump(concrete="own", density=2300.0, viscosity=100.0, yield_stress=27.0, spacing=12.5e-3,
                         lift_time=1.0, duration=6.0)  # fmt: skip
    t500 = number(Simulation(scene, device=device).run().result["t500"])
    spread = 2 * heap_at_rest(VOLUME, 27.0, 2300.0)[0]
    assert viscosity_of_t500(t500, spread, 2300.0) == pytest.approx(100.0, rel=0.1)
    found = mix_of({"density": 2300, "spread": spread, "t500": t500})["viscosity"]
    assert found.low < 100 < found.high


def test_aggregate_thickens_by_its_limits():
    """Nothing of nothing; Einstein's 2.5 at first; without bound at the densest packing; Chateau's root."""
    assert thickening(0.0, 2.5, 0.6) == (1.0, 1.0)
    viscosity, stress = thickening(1e-6, 2.5, 0.6)
    assert (viscosity - 1) / 1e-6 == pytest.approx(2.5, rel=2e-5)
    assert (stress - 1) / 1e-6 == pytest.approx(0.75, rel=1e-5)
    assert thickening(0.6 - 1e-9, 2.5, 0.6)[0] > 1e12
    viscosity, stress = thickening(0.3, 2.5, 0.6)
    assert viscosity == pytest.approx(2 * math.sqrt(2)) and stress == pytest.approx(math.sqrt(0.7 * viscosity))
    with pytest.raises(SceneError, match="aggregate fraction"):
        thickening(0.6, 2.5, 0.6)


def test_mortar_and_back():
    """A mortar's mix has the constants of which mortar_of finds that mortar again."""
    mortar = {"yield_stress": 20, "viscosity": "8 Pa s", "uncertainty": 0}
    mix = mix_of({"density": 2350, "aggregate": "340 l/m3", "aggregate_density": 2700, "mortar": mortar})
    back = mortar_of(mix.concrete, 0.34, 2700.0)
    assert (back.viscosity, back.yield_stress) == (pytest.approx(8.0), pytest.approx(20.0))
    assert mix["mortar's density"].value == pytest.approx(back.density)
    other = mix_of({"density": 2350, "aggregate": "34 %", "aggregate_density": 2700,
                    "concrete": {"yield_stress": back.yield_stress * thickening(0.34, 2.5, 0.6)[1],
                                 "viscosity": mix.concrete.viscosity}})  # fmt: skip
    assert other["mortar's viscosity"].value == pytest.approx(8.0)
    assert mix["viscosity"].low == pytest.approx(8 * thickening(0.34, 2.5, 0.65)[0])
    assert mix["viscosity"].high == pytest.approx(8 * thickening(0.34, 3.25, 0.57)[0])


def test_as_much_aggregate_as_there_can_be():
    """Short of packing every end of the band is finite."""
    mix = mix_of({"density": 2500, "aggregate": 0.569, "mortar": {"yield_stress": 20, "viscosity": 8}})
    assert mix["viscosity"].value < mix["viscosity"].high < 1e8


def test_a_line_through_points_and_its_errors():
    random = np.random.default_rng(3)
    x = np.linspace(1, 9, 8)
    y = 5 + 3 * x + random.normal(size=8)
    fit = straight_line(x, y)
    best, covariance = np.polyfit(x, y, 1, cov=True)
    assert (fit.slope, fit.offset) == (pytest.approx(best[0]), pytest.approx(best[1]))
    assert (fit.slope_error, fit.offset_error) == tuple(pytest.approx(e) for e in np.sqrt(np.diag(covariance)))
    assert math.isnan(straight_line([1, 2], [1, 2]).slope_error)


def test_a_layer_from_points_of_a_pipe(tmp_path):
    """The fit recovers the known slip layer from which the points are computed.

    With scatter in the pressures, the known slip viscosity lies inside the fitted band.
    """
    known = Concrete(name="known", density=2300, viscosity=40, yield_stress=60, slip_viscosity=640, slip_yield=30)
    line = Line(radius=0.0625, length=12.0, rise=0.25)
    flows = np.array([10, 20, 30, 40]) / 3600
    pressures = np.array([steady(known, line, q).pressure for q in flows])
    section = BULK | {"layer": {"points": "points.csv", "diameter": "125 mm", "length": "12 m", "rise": "3 m"}}

    def fitted(pressures):
        rows = "\n".join(f"{3600 * q!r},{p / 1e5!r}" for q, p in zip(flows.tolist(), pressures.tolist()))
        (tmp_path / "points.csv").write_text(f"flow [m3/h],pressure [bar]\n{rows}\n", encoding="utf-8")
        return read_mix(written(tmp_path, section))

    exact = fitted(pressures)
    assert exact["slip viscosity"].value == pytest.approx(640, rel=1e-6)
    assert exact["slip yield"].value == pytest.approx(30, rel=1e-5)
    assert exact["slip viscosity"].high == pytest.approx(1.3 * 640) and exact["slip yield"].low == pytest.approx(
        30 / 1.3
    )
    rough = fitted(pressures * [1.01, 0.99, 1.01, 0.99])
    eta = rough["slip viscosity"]
    assert eta.low < 640 < eta.high == pytest.approx(1.3 * eta.value)
    rougher = fitted(pressures * [1.04, 0.96, 1.04, 0.96])["slip viscosity"]
    assert rougher.low < 640 < rougher.high and rougher.high > 1.5 * rougher.value


def test_points_of_tribometer_and_viscometer():
    mix = mix_of({"density": 2300, "viscometer": [[2, 140], [5, 260], ["10 1/s", "0.46 kPa"]],
                  "layer": {"tribometer": [["10 cm/s", 110], [0.3, 290]]}})  # fmt: skip
    assert [mix[name].value for name in ("viscosity", "yield stress", "slip viscosity", "slip yield")] == pytest.approx(
        [40, 60, 900, 20])  # fmt: skip
    assert "values from pipes are 0.3 to 2 times" in mix["slip yield"].source
    assert (mix["slip viscosity"].low, mix["slip viscosity"].high) == pytest.approx((0.3 * 900, 2 * 900))


@pytest.mark.parametrize(("stresses", "student"), [((100, 141, 178), 12.706), ((100, 150, 160, 230), 4.303)])
def test_a_line_through_several_points_has_the_interval_of_student(stresses, student):
    """Expect a slope's standard error times the quantile for as many degrees of freedom as points less two."""
    rate, stress = np.arange(1.0, 1 + len(stresses)), np.array(stresses)
    slope, offset = np.polyfit(rate, stress, 1)
    variance = np.sum((stress - slope * rate - offset) ** 2) / (len(rate) - 2)
    error = math.sqrt(variance / np.sum((rate - rate.mean()) ** 2))
    found = mix_of({"density": 2300, "viscometer": np.transpose([rate, stress]).tolist()})["viscosity"]
    assert found.value == pytest.approx(slope)
    assert student * error > 0.2 * slope
    assert found.high - slope == pytest.approx(student * error, rel=2e-3)  # Measured: 3e-4, as 12.706 is rounded.


def test_points_on_a_straight_line_still_have_the_error_of_a_rheometer():
    """Two points, three on their line, and the constants of this line themselves give one band for the viscosity."""
    points = [[5, 400], [20, 700], [10, 500]]
    given = [{"viscometer": points[:2]}, {"viscometer": points}, {"concrete": {"yield_stress": 300, "viscosity": 20}}]
    found = [mix_of({"density": 2300, **each}) for each in given]
    for mix in found:
        assert [getattr(mix["viscosity"], end) for end in ("low", "value", "high")] == pytest.approx([16, 20, 24])
        assert [getattr(mix["yield stress"], end) for end in ("low", "value", "high")] == pytest.approx([60, 300, 360])


def test_the_viscosity_is_a_guess_if_nothing_tells_it():
    assert mix_of({"density": 2300, "slump": "100 mm"})["viscosity"].way.startswith("assumption")


def test_a_mix_of_the_literature_beside_what_it_published():
    """Xu, Li & Jiang 2021: pressure of their case 9.40 kPa, mortar 2190 kg/m3 (Table 4), all of no1's constants."""
    mix = read_mix("xu-no1")
    assert mix.concrete == Concrete(name="xu-no1", **concrete("no1").flow)
    assert mix.given.share == 946 / 2630
    assert steady(mix.concrete, Line(), 1500e-6, "paper").pressure == pytest.approx(9400, rel=0.005)
    assert mix["mortar's density"].value == pytest.approx(2190, rel=0.005)
    low, high = (steady(each, Line(), 1500e-6, "paper").pressure for each in mix.variants["slip layer"])
    assert low < 9400 < high


@pytest.mark.parametrize(("name", "slump"), [("no1", 130), ("no2", 180), ("no3", 220)])
def test_slumps_of_the_literature_fit_the_rheometer(name, slump):
    """The rheometer of Xu, Li & Jiang 2021 reads less than a homogeneous cone implies, within the slump's band."""
    own = CONCRETES[name]
    section = {"density": own.density, "slump": f"{slump} mm"}
    both = mix_of(section | {"concrete": {"yield_stress": own.yield_stress, "viscosity": own.viscosity}})
    assert both["yield stress"].value == own.yield_stress and not any("sieve" not in each for each in both.remarks)
    alone = mix_of(section)["yield stress"]
    assert alone.low < own.yield_stress < alone.value


def test_a_rheometer_may_read_five_times_the_yield_stress_of_a_heap():
    """The band of a measured yield stress reaches down to a fifth, unless its uncertainty is stated."""
    section = {"density": 2350, "concrete": {"yield_stress": "900 Pa", "viscosity": "60 Pa s"}}
    found = mix_of(section)["yield stress"]
    assert (found.low, found.value, found.high) == pytest.approx((180, 900, 1080)) and "slumps" in found.source
    viscosity = mix_of(section)["viscosity"]
    assert (viscosity.low, viscosity.high) == pytest.approx((48, 72))
    section["concrete"]["uncertainty"] = "10 %"
    stated = mix_of(section)["yield stress"]
    assert (stated.low, stated.high) == pytest.approx((810, 990)) and stated.source == "as given"


def test_concrete_without_air_may_be_stated():
    """Cement and water fill 0.29 m3 of a cubic metre, and two per cent of air are usual."""
    entries = {"parts": {"cement": 340, "water": 180, "sand": 790, "gravel": 1040}, "slump": "120 mm"}
    usual, none, some = (mix_of(entries | more).given.sand_and_stone for more in ({}, {"air": "0 %"}, {"air": "3 %"}))
    assert none == pytest.approx(usual + USUAL_AIR, abs=1e-12) and some == pytest.approx(none - 0.03, abs=1e-12)


@pytest.mark.parametrize("air", [None, "5 %"])
def test_an_assumed_air_content_is_told(air):
    """320 / 3100 + 60 / 2250 + 175 / 1000 + 2 % = 0.325 of a cubic metre, and the rest is sand and stones."""
    parts = {"cement": 320, "fly ash": 60, "water": 175, "sand": 790, "gravel": 980}
    mix = mix_of({"parts": parts, "slump": "7 in", **({} if air is None else {"air": air})})
    said = [each for each in mix.remarks if "states no air content: 2 % is assumed" in each]
    assert len(said) == (air is None)
    if air is None:
        assert (
            f"leaves {1e3 * (1 - 320 / 3100 - 60 / 2250 - 0.175 - 0.02):.3g} l/m3 ({0.675 * 27:.3g} ft3/yd3)" in said[0]
        )
        assert mix["yield stress"].way == "slump of 177.8 mm (7 in)"


@pytest.mark.parametrize(
    ("stated", "bulk", "stress"),
    [
        ({"spread": "600 mm", "water_binder": 0.4}, 3.0, (1.0, 1.0)),
        ({"slump": "200 mm"}, 1.0, (1 / 1.25, 1.25)),
        ({"concrete": {"yield_stress": 60, "viscosity": 40}}, 1.0, (1.0, 1.0)),
    ],
    ids=["paste", "slump", "nothing"],
)
def test_a_thickener_triples_the_viscosity_of_an_estimated_layer_and_widens_its_band(stated, bulk, stress):
    """The band becomes wider by a factor of 1.25 to both sides; so does that of a yield stress from the slump.

    A viscosity of the bulk that follows from the paste is tripled as well, with the same relative band.
    """
    plain, thick = (mix_of({"density": 2350, **stated, "thickener": each}) for each in (False, True))

    def ratios(name):
        ends = ([each[name].low, each[name].value, each[name].high] for each in (plain, thick))
        return [b / a if a else 1.0 for a, b in zip(*ends, strict=True)]

    assert ratios("slip viscosity") == pytest.approx([3 / 1.25, 3.0, 3 * 1.25])
    assert ratios("slip yield") == pytest.approx([stress[0], 1.0, stress[1]])
    assert ratios("viscosity") == pytest.approx([bulk] * 3)


def test_the_band_of_a_layer_from_the_viscosity_has_the_band_of_the_viscosity():
    """The layer is 3 mm of the paste that is thickened by a volume fraction a of aggregate as (1 - a / 0.8)^-2.

    The band of the viscosity, 20 % to both sides, is widened by a factor of 3 to both sides.
    """
    parts = {"cement": 380, "water": 185, "sand": 800, "gravel": 980}
    mix = mix_of({"concrete": {"yield_stress": 60, "viscosity": 40, "uncertainty": "20 %"}, "parts": parts})
    (eta,) = [eta for eta, _ in layers(mix.given, mix.concrete, mix["viscosity"]) if eta.way.startswith("viscosity")]
    paste = (1 - mix.given.sand_and_stone / 0.8) ** 2 / 0.003
    assert (eta.low, eta.value, eta.high) == pytest.approx((32 * paste / 3, 40 * paste, 48 * paste * 3))
