"""Values and tables of the theory of pipes and vessels for a few concretes, kept (see `kept`)."""

from dataclasses import astuple, is_dataclass, replace

import kept
import numpy as np

from warpcrete.core.errors import WarpcreteError
from warpcrete.theory import fits, inverse, pipe, suspension, vessels
from warpcrete.theory.laws import FlowLaw
from warpcrete.theory.pipe import CONCRETES, FORMS, Concrete, Line
from warpcrete.theory.pipe_table import restart_table, table
from warpcrete.theory.segregated import Segregated, segregation_table

USUAL = Concrete(density=2350, viscosity=30, yield_stress=40, slip_viscosity=800, slip_yield=20)
SHEARED = replace(USUAL, slip_yield=90)
"""Concrete whose bulk yields at a lower stress than its slip layer."""
OTHERS = {
    "usual": USUAL,
    "sheared": SHEARED,
    "no yield stress": replace(USUAL, yield_stress=0.0, slip_yield=0.0),
    "thins": replace(USUAL, flow_index=0.7, slip_flow_index=1.4),
    "squared": replace(SHEARED, quadratic_viscosity=2.0, slip_quadratic_viscosity=900.0),
}
LINES = {
    "upright": Line(),
    "thick layer": Line(radius=0.0625, length=10.0, slip_thickness=0.01, rise=0.3),
    "downwards": Line(radius=0.05, length=2.0, rise=-1.0, gravity=1.6),
}
LAW = FlowLaw(40.0, 30.0, 0.6)


def attempt(function, *arguments, **named):
    """Return a result, or the message of a refusal; a dataclass is replaced by a list of its numbers."""
    try:
        found = function(*arguments, **named)
        if not is_dataclass(found):
            return found
        return [each for each in astuple(found) if not isinstance(each, str)]
    except WarpcreteError as error:
        return str(error)


def test_kept_theory_of_pipes():
    found = {}
    for name, concrete in OTHERS.items():
        for place, line in LINES.items():
            bulk = line.radius - line.slip_thickness
            one = found[f"{name}, {place}"] = {"least stress": pipe.least_stress(concrete, line)}
            for form in FORMS:
                state = pipe.steady(concrete, line, 2e-3, form)
                one[form] = {
                    "steady": [attempt(pipe.steady, concrete, line, flow, form) for flow in (0.0, 2e-3)],
                    "stress": [
                        attempt(pipe.steady_of_stress, concrete, line, stress, form) for stress in (0.0, 45.0, 95.0)
                    ],
                    "pressure": [attempt(pipe.flow_of_pressure, concrete, line, each, form) for each in (0.0, 1e5)],
                    "velocity": pipe.velocity(concrete, line, state, np.linspace(0, bulk, 7)),
                }
            one["share"] = attempt(pipe.layer_share, concrete, line, 2e-3)
            one["kaplan"] = attempt(pipe.kaplan, concrete, line, 2e-3)
    for name, concrete in OTHERS.items():
        found[f"{name}, changed"] = [
            attempt(pipe.after_rest, concrete, 600.0, 0.2),
            attempt(pipe.scaled, concrete, 1.3, 0.8),
            attempt(pipe.restart, concrete, Line(), 600.0, 0.2, 1e-3, "plane"),
            attempt(suspension.mortar_of, concrete, 0.35, 2650.0),
            attempt(suspension.concrete_of_mortar, concrete, 0.35, 2650.0, "discs"),
        ]
    kept.compare("theory-pipes", found)


def test_kept_tables_of_pipes():
    lines = []
    for concrete in (CONCRETES["no1"], *OTHERS.values()):
        for line in LINES.values():
            lines += [table(concrete, line, flows=(1e-3, 5e-3)), attempt(table, concrete, line, pressures=(1.2e4, 1e5))]
    lines += [
        restart_table(SHEARED, LINES["thick layer"], 600.0, 0.2, 2e-3),
        segregation_table(USUAL, LINES["thick layer"], 0.4, (-0.3, 0.0, 0.3), (0.0, 2e-3)),
    ]
    kept.compare("theory-tables", "\n".join(lines))


def test_kept_theory_of_vessels():
    box = {
        volume: [
            vessels.box_at_rest(volume, 1.2, 0.2, 60.0, 2300.0),
            attempt(vessels.box_yield_stress, 0.9, volume, 0.2, 2300.0),
        ]
        for volume in (0.003, 0.006, 0.02)
    }
    kept.compare(
        "theory-vessels",
        {
            "box": box,
            "slope": vessels.box_slope(0.1, 0.2),
            "heaps": [
                [
                    vessels.heap_at_rest(0.0055, stress, 2300.0, form=form),
                    vessels.heap_depth(np.linspace(0, 0.2, 4), stress, 2300.0, 5.0, form),
                    vessels.heap_volume(0.25, stress, 2300.0, form=form),
                ]
                for form in ("plane", "axial")
                for stress in (20.0, 500.0)
            ],
            "long heap": vessels.long_heap_spread(0.01, 50.0, 2300.0, 5.0),
            "front": vessels.viscous_front(0.01, 30.0, 2300.0, 4.0, 5.0),
            "cone": [vessels.tall_cone_slump(0.05, 0.1, 0.3, stress, 2300.0) for stress in (10.0, 800.0, 3000.0)],
            "cone by Tresca": vessels.tall_cone_slump(0.05, 0.1, 0.3, 800.0, 2300.0, bears=2.0),
            "volume": vessels.cone_volume(0.05, 0.1, 0.3),
            "ducts": [vessels.duct_constants(aspect) for aspect in (0.0, 0.05, 0.3, 0.6, 0.9, 1.0)],
            "duct": [
                vessels.duct_stress(np.array([0.1, 2.0]), np.array([0.06, 0.2]), 0.075, 30.0, 40.0, *more)
                for more in ((), ((800.0, 20.0, 1.0, 0.0),), (None, 0.7), (None, 1.0, 2.0))
            ],
            "funnel": [
                vessels.funnel_time((0.0325, 0.245), (0.15, 0.572), 0.075, 30.0, stress, 2300.0, layer=layer)
                for stress, layer in ((40.0, None), (0.0, (800.0, 20.0, 1.0, 0.0)), (4000.0, None))
            ],
        },
    )  # fmt: skip


def test_kept_theory_of_tests_of_fresh_concrete():
    """Yield stresses and viscosities for slumps and spreads from stiff to thin, where less than 1 Pa remains."""
    kept.compare(
        "theory-inverse",
        {
            "spread": [
                [inverse.yield_of_long_heap(spread, 2300.0), inverse.yield_of_heap(spread, 2300.0),
                 inverse.viscosity_of_t500(3.0, spread, 2300.0), inverse.viscosity_of_t500_sedran(3.0, spread, 2300.0)]
                for spread in (0.09, 0.5, 0.65, 1.2, 1.6)
            ],
            "slump": [
                [inverse.yield_of_slump(slump, 2300.0), inverse.yield_of_slump_measured(slump, 2300.0)]
                for slump in (0.001, 0.1, 0.2, 0.2999)
            ],
            "slump by Tresca": inverse.yield_of_slump(0.1, 2300.0, bears=2.0),
        },
    )  # fmt: skip


def test_kept_laws_and_fits():
    stress = np.array([0.0, 40.0, 41.0, 300.0])
    kept.compare(
        "theory-laws",
        {
            "laws": [
                [law.name, law.stress(np.array([0.0, 0.5, 20.0])), law.rate(stress), law.integrals(stress),
                 law.mean_velocity(stress[1:], 0.05, "pipe"), law.mean_velocity(stress[1:], 0.05, "plane")]
                for law in (LAW, FlowLaw(40.0, 30.0), FlowLaw(0.0, 30.0, 1.4), FlowLaw(40.0, 30.0, quadratic=2.0))
            ],
            "fits": [fits.straight_line((0, 1, 2, 4), (1.0, 2.9, 5.2, 8.8)), fits.straight_line((1, 2), (5, 3))],
            "student": [fits.student_t(freedom) for freedom in (1, 10, 11, 40)],
            "suspensions": [
                [suspension.thickening(0.35, *constants), suspension.power_thickening(3.0, 0.35, 0.6)]
                for constants in suspension.SUSPENSIONS.values()
            ],
            "segregated": [
                [Segregated(concrete, line, 0.4, index).steady(2e-3) for concrete in OTHERS.values()]
                for line, index in zip(LINES.values(), (-0.3, 0.2, 0.1))
            ],
        },
    )  # fmt: skip
