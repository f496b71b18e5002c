"""Report on a fit to pressures along a trial line, with entries to copy into the files of the concrete and the line."""

import numpy as np

from ...core.inputs.customary import CUSTOMARY_SIZES, beside, both
from ...geometry.pipe_line import PipeLine
from ...mix.layer import PIPE_UNCERTAINTY
from .fittings import MODEL_ERRORS
from .line_fit import LineFit, Stretch
from .taps import Tap, at_one_flow

NOTICED = 0.01
"""Weight of the slip layer expected before the fit, from 0 to 1, from which on the report mentions this weight."""


def fit_lines(fit: LineFit, line: PipeLine, factors: tuple[float, float] = (1.0, 1.0), mix: bool = True) -> list[str]:
    """Return a report on the fit as lines of Markdown.

    The report contains the fitted constants, the deviations from the measurements, entries that the user can copy into
    the files of the concrete and of the line, and a table of all measured pressures. `factors` are the factors on yield
    stresses and on viscosities in the file of the concrete, and `mix` is False for a concrete without a mix.
    """
    bends = fit.constants[2:]
    off = fit.deviations()
    worst = int(np.argmax(np.abs(off)))
    measured = [tap.pressure for tap in fit.taps]
    texts = [
        f"**Fit to {len(fit.taps)} taps of {line.name}** (least squares; bands of 95 % for gauges that are "
        f"off by up to {fit.gauge / 1e5:.2g} bar{beside(line.customary, 'psi', fit.gauge)}, see --gauge)",
        "",
        *(f"- {each.text}" for each in fit.constants),
        *(
            [f"- the slip layer expected before the fit has a weight of {100 * fit.prior_share:.2g} % in this result"]
            if fit.prior_share >= NOTICED
            else []
        ),
        f"- {_meaning(fit)}",
        *([f"- {_open_yield(fit, line.customary)}"] if not fit.knows_yield else []),
        *([_surprise(fit.surprise)] if fit.surprise is not None else []),
        f"- measured pressures scatter by {fit.scatter / 1e5:.2g} bar{beside(line.customary, 'psi', fit.scatter)} "
        "about the fit; the largest deviation (fitted minus measured) is "
        f"{off[worst] / 1e5:+.2g} bar{beside(line.customary, 'psi', off[worst])} of {measured[worst] / 1e5:.4g} bar"
        f"{beside(line.customary, 'psi', measured[worst])} "
        f"(line {fit.taps[worst].row})",
        *_repeats(fit, line.customary),
        *([f"- {warning_of(fit, line.customary)}"] if fit.contradiction is not None else _beyond(fit, line.customary)),
        "",
        *_layer_entries(fit, factors, mix),
        "",
        f"This uncertainty holds from half to twice the measured flow. At the measured flow alone, it is "
        f"{max(100 * fit.uncertainty, 0.1):.3g} %.",
        "",
    ]
    low, high = MODEL_ERRORS["bend"].low, MODEL_ERRORS["bend"].high
    if bends and bends[0].fitted:
        texts += ["and into the line's file:", "", f"    bend_factor: {{factor: {bends[0].value:.4g}, "
                  f"low: {bends[0].low:.4g}, high: {bends[0].high:.4g}}}", ""]  # fmt: skip
        if not low <= bends[0].value <= high:
            share = sum(part.length for part in line.parts if part.kind == "bend") / line.length
            texts += [f"The factor lies outside the range of published measurements, {low:g} to {high:g}. Bends make "
                      f"{100 * share:.2g} % of the length of this line, so one wrong gauge or place explains such a "
                      "factor: check the taps before you use it.", ""]  # fmt: skip
    names = ("ft", "yd3/h", "psi") if line.customary else ("m", "m3/h", "bar")
    place, rate, size = (CUSTOMARY_SIZES[name] for name in names) if line.customary else (1.0, 1 / 3600, 1e5)
    unit = names[2]
    texts += [
        f"| place [{names[0]}] | flow [{names[1]}] | measured [{unit}] | fitted [{unit}] | deviation [{unit}] |",
        "|---|---|---|---|---|",
    ]
    for tap, fitted, each in zip(fit.taps, fit.pressures, off, strict=True):
        cells = (f"{tap.place / place:.4g}", f"{tap.flow / rate:.4g}", f"{tap.pressure / size:.4g}",
                 f"{fitted / size:.4g}", f"{each / size:+.2g}")  # fmt: skip
        texts.append(f"| {' | '.join(cells)} |")
    return texts


def _layer_entries(fit: LineFit, factors: tuple[float, float], mix: bool) -> list[str]:
    """Return lines of text with the fitted slip layer as entries for the concrete's file, and where to write them.

    The entries are divided by the `factors` on yield stresses and on viscosities in this file, because the program
    multiplies the entries by these factors when it reads the file. They belong to the section `mix` if `mix` is True,
    and to the section `flow` otherwise.
    """
    before = "" if factors == (1.0, 1.0) else ", divided by the factors that it states"
    if mix:
        return [
            f"Write into the section `mix` of the concrete's file{before} (for this delivery; without `uncertainty`, "
            "the band is 30 %, as for other deliveries), or let --out FOLDER write the whole file:",
            "",
            f"    layer: {{{', '.join(f'{key}: {value}' for key, value in fit.layer_entry(factors).items())}}}",
        ]
    own = max(fit.later_uncertainty, 0.001)
    others = (
        f" for this delivery, or --layer-factor {1 + PIPE_UNCERTAINTY:g} for others" if own < PIPE_UNCERTAINTY else ""
    )
    return [
        f"Write into the section `flow` of the concrete's file{before}, and add --layer-factor {1 + own:.4g}{others}; "
        "or let --out FOLDER write the whole file:",
        "",
        f"    slip_viscosity: {fit.constants[0].value / factors[1]:.6g} Pa s/m",
        f"    slip_yield: {fit.constants[1].value / factors[0]:.6g} Pa",
        *(f"    slip_{key}: {value:g}" for key, value in fit.law_entries(factors[1]).items()),
    ]


def _meaning(fit: LineFit) -> str:
    """Return a sentence that compares the fit with the values expected from the concrete's file."""
    text = f"the friction in straight pipe is {fit.expected:.3g} times the value expected from the concrete's file"
    if fit.outside:
        text += f"; outside the expected band: {', '.join(fit.outside)}"
    return text


def _open_yield(fit: LineFit, customary: bool) -> str:
    """Return a sentence on the slip layer's unknown yield stress, and on the flows at which it widens the band."""
    assert not fit.knows_yield, "the yield stress is known"
    unit, size = ("yd3/h", CUSTOMARY_SIZES["yd3/h"]) if customary else ("m3/h", 1 / 3600)
    (_, low), (_, high) = fit.yield_layers
    rates = [tap.flow / size for tap in fit.taps]
    flows = sorted({f"{rate:.4g}" for rate in rates}, key=float)
    if at_one_flow(fit.taps):
        about = f"{'about ' if len(flows) > 1 else ''}{sum(rates) / len(rates):.4g}"
        read, more = f"All gauges were read at {about}", "read gauges at a second flow"
    else:
        read, more = f"The gauges were read at {' and '.join(flows)}", "read more gauges, or at flows that differ more"
    return (
        f"{read} {unit}; at another flow the band is wider, because the pressures do not "
        f"determine the yield stress of the slip layer, which may be {low:.3g} to {high:.3g} Pa; {more}"
    )


def _beyond(fit: LineFit, customary: bool) -> list[str]:
    """Return a line of text on the gauges that deviate from the fit by more than their error limit, if there are any.

    The deviation of a gauge is the mean over its readings, because all readings of a gauge have the same error.
    """
    at, off = np.array([tap.place for tap in fit.taps]), fit.deviations()
    means = {float(place): float(off[at == place].mean()) for place in np.unique(at)}
    far = [place for place in means if abs(means[place]) > fit.gauge > 0]
    if not far:
        return []
    worst = max(far, key=lambda place: abs(means[place]))
    deviation = abs(means[worst])
    cause = ""
    if len(fit.constants) > 2 and fit.bend_factor is None:
        cause = ", or bends have more or less friction than the table states"
    return [
        f"- {len(far)} of {len(means)} gauges {'deviates' if len(far) == 1 else 'deviate'} from the fit by more than "
        f"the error limit, most of all the gauge at {both(customary, 'm', worst)}, which shows "
        f"{deviation / 1e5:.2g} bar{beside(customary, 'psi', deviation)} {'more' if means[worst] < 0 else 'less'} than "
        f"the fit: a gauge, its place or a flow is wrong{cause}"
    ]


def _repeats(fit: LineFit, customary: bool) -> list[str]:
    """Return a line of text on repeated readings that contradict each other, if there are any.

    Readings of one gauge at one flow have the same error of the gauge, so they should differ by less than its limit.
    """
    readings: dict[tuple[float, float], list[Tap]] = {}
    for tap in fit.taps:
        readings.setdefault((tap.place, tap.flow), []).append(tap)
    spreads = {key: max(x.pressure for x in taps) - min(x.pressure for x in taps) for key, taps in readings.items()}
    worst = max(spreads, key=lambda key: spreads[key])
    if not spreads[worst] > fit.gauge > 0:
        return []
    rows = " and ".join(str(tap.row) for tap in readings[worst])
    return [
        f"- lines {rows} of the file state different pressures for one gauge and one flow, and the fit uses all of "
        f"them; they differ by {spreads[worst] / 1e5:.2g} bar{beside(customary, 'psi', spreads[worst])}, more than the "
        "error limit of a gauge: check them, and delete the wrong one"
    ]


def _surprise(ratio: float) -> str:
    """Return a warning for the user that the fitted friction lies outside the band of the expected friction.

    `ratio` is the fitted friction of straight pipe, divided by the expected friction.
    """
    return (
        f"- the measured friction in straight pipe is {ratio:.2g} times the expected one, and lies outside its band: "
        "check the slump, the gauges (pressure of the concrete, not of the oil), and whether concrete leaks or a plug "
        "begins"
    )


def warning_of(fit: LineFit, customary: bool) -> str:
    """Return a warning that no slip layer explains the readings of all gauges.

    The warning states the measured friction of the two stretches of the line that contradict each other most, in psi/ft
    if `customary` is true, and in bar/m otherwise. `fit.contradiction` must not be None.
    """
    contradiction = fit.contradiction
    assert contradiction is not None, "the gauges do not contradict each other"
    unit, metre = ("ft", CUSTOMARY_SIZES["ft"]) if customary else ("m", 1.0)
    named, size = ("psi/ft", CUSTOMARY_SIZES["psi"] / metre) if customary else ("bar/m", 1e5)

    def where(stretch: Stretch) -> str:
        begin = f"{stretch.begin / metre:.3g}"
        if stretch.end is None:
            return f"behind {begin} {unit}"
        return f"between {begin} and {stretch.end / metre:.3g} {unit}"

    low, high = contradiction.low, contradiction.high
    return (
        f"WARNING: no slip layer explains all gauges, so the band was widened until it contains them. The gauges show "
        f"{low.measured / size:.2g} {named} of friction {where(low)}, but {high.measured / size:.2g} {named} "
        f"{where(high)}; the fitted layer gives {low.fitted / size:.2g} and {high.fitted / size:.2g}. Check the "
        "places of rises, hoses, reducers and gauges, and whether the gauges were read on this line"
    )
