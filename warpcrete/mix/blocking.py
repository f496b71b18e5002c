"""Rules of practice (rules of thumb) that tell whether concrete will block a pump line.

Each rule compares a property of the mix, or the largest stone in a bore, with a published limit. The rules need no
simulation, and cover causes that discrete elements cannot show, such as bleeding under pressure. They do not replace a
pumping trial. Best & Lane (report ADA107524, Waterways Experiment Station) found that a check list of ten properties
predicts blocking best, but is conservative.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from ..core.inputs.customary import both
from ..core.records import Record
from ..geometry.pipe_line import Part, PipeLine
from .entries import MixEntries
from .ingredients import cement_mass, powder_mass, water_mass

VERDICTS = ("fine", "unknown", "risky", "blocks")
"""Verdicts of a rule, from the best to the worst; 'unknown' means that the mix lacks an entry that the rule needs."""
ANSWERS = {
    "fine": "no, by all rules of practice",
    "unknown": "no rule of practice says so, but not all could be applied",
    "risky": "perhaps, by rules of practice",
    "blocks": "yes, by rules of practice",
}
"""Answers to the question whether concrete will block a pump line, by the worst verdict of all rules of practice."""
TOO_LITTLE = "too little is known about the concrete to say"
"""Answer if the mix lacks the entries for more than half of the rules, and all other rules have the verdict 'fine'."""
CRUSHED, ROUNDED = 1 / 3, 0.4
"""Maximum ratio of stone diameter to bore for which concrete can be pumped: for crushed and for rounded stones (ACI
304.2R)."""
SAFE = 0.25
"""Ratio of the largest stone diameter to the bore up to which, by experience, stones do not form an arch."""
SELF_COMPACTING = 0.55
"""Spread [m] from which a concrete counts as self-compacting (class SF1 of EN 206)."""
POWDER_MIN, POWDER_SAFE = 250.0, 300.0
"""Two powder contents of concrete [kg/m3]. Below the first, concrete blocked in tests (Tuutti 1976). From the second
on, the rule judges the mix to be safe."""
VOIDS = (0.20, 0.27)
"""Usual range of the volume of voids in compacted sand and stones, per bulk volume [m3/m3]. The range is an assumption
for mixes that state no voids."""
VOIDS_ERROR = 0.02
"""Largest error of a measured volume of voids in compacted sand and stones, per bulk volume [m3/m3]. The true volume
may be larger or smaller by this value."""
SAND_SHARES = (0.38, 0.45)
"""Smallest and largest fraction of sand in the aggregate that the rule JGJ/T 10 requires."""
PUMPED_SAND_SHARES = (0.365, 0.52)
"""Smallest and largest fraction of sand in the aggregate in 403 measured flows of concrete through coils of pipe (W.
Shen). All of these concretes could be pumped."""
FINE_SAND = (0.15, 0.30)
"""Lower and upper limit for the fraction of the sand's mass that is finer than 0.3 mm. With less fine sand the concrete
segregates, with more it becomes sticky."""
WATER_BINDER = 0.60
"""Largest ratio of water to powder, by mass, that the rule JGJ/T 10 allows."""
FINES_PER_WATER = 1.75
"""Smallest ratio of the mass of powder and fine sand to the mass of water. With less, water may bleed out under
pressure."""
SLUMPS = (0.05, 0.10, 0.16)
"""Three slumps [m]: the smallest slump of concrete that can be pumped, the smallest slump that is usual for pumping,
and the largest slump that is expected without a plasticizer."""
LARGEST_SPREAD = 0.795
"""Largest spread [m] of a concrete in 403 measured flows of concrete through coils of pipe (W. Shen). All of these
concretes could be pumped."""
LIGHTWEIGHT = 2000.0
"""Density [kg/m3] below which concrete counts as lightweight (EN 206, which states it for oven-dry concrete)."""
LIGHTWEIGHT_SLUMP, LIGHTWEIGHT_CEMENT = 0.18, 320.0
"""Slump [m] and mass of cement in a cubic metre [kg/m3] up to which lightweight concrete must be examined before it is
pumped high or far (Japanese check list). Lightweight aggregate absorbs water under pressure, and the concrete
stiffens."""
TAPER_RUN = 5.0
"""Minimum length of straight pipe behind a reducer [m], in which stones and mortar mix again (JGJ/T 10)."""

ACI = "ACI 304.2R"
SOCIETY = "Concrete Society: 3.5 to 4 times the stone"
SHEN = "403 flows through coils, W. Shen"
JGJ = "JGJ/T 10"
CHECK_LIST = "Japanese check list, http://pmkujira.sakura.ne.jp/Exsokuryo/Free/Kentiku/KcheckL3/02-04-KC-044.htm"
BLEEDING = "Browne & Bamforth 1977; Kaplan, de Larrard & Sedran 2005"


@dataclass(frozen=True)
class RuleVerdict:
    """Verdict of one rule of practice on whether concrete will block a pump line."""

    rule: str
    """Name of the rule of practice that gives the verdict."""
    verdict: str
    """Verdict on the mix or the line: 'fine', 'unknown', 'risky' or 'blocks'."""
    found: str
    """Sentence with the numbers on which the verdict is based."""
    change: str
    """Advice on how to change the mix or the line. It is empty for the verdict 'fine'. For the verdict 'unknown', it
    names the entry that the mix lacks."""
    source: str

    @property
    def text(self) -> str:
        """The verdict, its numbers and the advice as one or two lines of text."""
        line = f"{self.verdict:8s} {self.rule}: {self.found} ({self.source})"
        return f"{line}\n{'':8s} -> {self.change}" if self.change else line

    def record(self) -> dict[str, str]:
        """Return the verdict as a mapping that can be written to a JSON file."""
        return {"rule": self.rule, "verdict": self.verdict, "found": self.found, "change": self.change,
                "source": self.source}  # fmt: skip


def worst(verdicts: Sequence[RuleVerdict]) -> str:
    """Return the worst verdict of several rules."""
    return max((each.verdict for each in verdicts), key=VERDICTS.index, default="unknown")


def blocking_rules(
    mix: MixEntries | None, bore: float | None = None, stone: float | None = None, customary: bool = False
) -> list[RuleVerdict]:
    """Return the verdicts of all rules of practice on blocking, for a mix in a pipe with an inner diameter `bore` [m].

    `stone` is the size of the largest stone [m], and takes precedence over the size that the mix states. Without a mix,
    the result contains only the rule that compares the stone with the bore. The verdicts also state amounts in US units
    if `customary` is true, or if the mix is described in US units.
    """
    verdicts = [stone_in_bore(bore, stone or (mix.largest if mix else None), mix, customary)]
    if mix is not None:
        verdicts += [powder(mix), paste(mix), sand_share(mix), fine_sand(mix), bleeding(mix), slump(mix)]
        verdicts += lightweight(mix)
    return verdicts


def line_rules(line: PipeLine, mix: MixEntries | None) -> list[RuleVerdict]:
    """Return the verdicts of all rules on a mix in a pump line: at its narrowest bore, and behind its reducers."""
    if mix is not None and line.customary:
        mix = replace(mix, customary=True)
    verdicts = blocking_rules(mix, narrowest(line).narrow, line.largest_stone, line.customary)
    return [*verdicts, *behind_reducers(line)]


def narrowest(line: PipeLine) -> Part:
    """Return the narrowest part of a pump line, where stones are most likely to form an arch.

    Among equally narrow parts, a reducer comes first, then a part whose bore is a mesh, then a bend, then any other
    part. A valve comes last.
    """
    order = {"reducer": 0, "bore": 1, "bend": 2, "valve": 9}
    return min(line.parts, key=lambda part: (round(part.narrow, 9), order.get(part.kind, 3), part.number))


def stone_in_bore(
    bore: float | None, stone: float | None, mix: MixEntries | None, customary: bool = False
) -> RuleVerdict:
    """Judge whether the largest stone is too large for the bore; such stones jam and form an arch across the pipe."""
    name = "stone in bore"
    if stone is None:
        return RuleVerdict(name, "unknown", "the size of the largest stone is not known",
                           "add 'sieve' or 'sizes' to the mix, or 'largest_stone' to the line", ACI)  # fmt: skip
    us = customary or (mix is not None and mix.customary)
    largest, wide = both(us, "mm", stone), both(us, "mm", stone / SAFE)
    if bore is None:
        widths = f"{both(us, 'mm', stone / CRUSHED)}, better {wide}"
        return RuleVerdict(name, "unknown", f"stones of {largest} need a bore of {widths} or more",
                           "give the narrowest bore with --bore", f"{ACI}; {SOCIETY}")  # fmt: skip
    ratio = stone / bore
    round_ones = mix is not None and mix.shape == "spheres"
    flowing = mix is not None and (mix.spread or 0) >= SELF_COMPACTING
    limit = ROUNDED if round_ones and not flowing else CRUSHED
    kind = "rounded" if round_ones else "crushed" if mix is not None and mix.shape is not None else "unknown shape"
    words = (
        f"a stone of {largest} in a bore of {both(us, 'mm', bore)} has the ratio {ratio:.3g}; {SAFE:g} is safe, "
        f"and {limit:.2g} is the limit ({kind}{', self-compacting' if flowing else ''})"
    )
    widths = f"use a bore of {wide}, or stones up to {both(us, 'mm', SAFE * bore, digits=3)}"
    if ratio > limit * (1 + 1e-9):
        return RuleVerdict(name, "blocks", words, widths, f"{ACI}; {SOCIETY}")
    if ratio > SAFE * (1 + 1e-9):
        return RuleVerdict(name, "risky", words, widths, f"{ACI}; {SOCIETY}")
    return RuleVerdict(name, "fine", words, "", f"{ACI}; {SOCIETY}")


def powder(mix: MixEntries) -> RuleVerdict:
    """Judge whether the concrete contains enough powder; concretes with less powder blocked in tests."""
    name, mass = "powder", powder_mass(mix.parts)
    source = f"Tuutti 1976, 16 mm stone: blocked below 250 kg/m3, least pressure at 320; {JGJ}: 300"
    if mass == 0:
        return RuleVerdict(
            name, "unknown", "the mass of cement and other powder is not known", "add 'parts' to the mix", source
        )
    us = mix.customary
    words = f"{both(us, 'kg/m3', mass)} of cement and other powder; {both(us, 'kg/m3', POWDER_SAFE)} or more is safe"
    if mass >= POWDER_SAFE:
        return RuleVerdict(name, "fine", words, "", source)
    more = f"add {both(us, 'kg/m3', POWDER_SAFE - mass, digits=3)} of cement, ash, slag or limestone"
    return RuleVerdict(name, "blocks" if mass < POWDER_MIN else "risky", words, more, source)


def paste(mix: MixEntries) -> RuleVerdict:
    """Compare the volume of the paste with the volume of the voids between sand and stones.

    Paste that does not fill the voids cannot carry the sand and stones through a pipe.
    """
    name, source = "paste and voids", "void meter of Browne & Bamforth 1977"
    if mix.paste_share is None or mix.sand_and_stone is None:
        return RuleVerdict(name, "unknown", "the volume of the paste is not known", "add 'parts' to the mix", source)
    low, high = VOIDS if mix.voids is None else (mix.voids - VOIDS_ERROR, mix.voids + VOIDS_ERROR)
    needed = [mix.sand_and_stone * voids / (1 - voids) for voids in (low, high)]
    measured = "assumed" if mix.voids is None else "measured"

    def shown(*volumes: float) -> str:
        return both(mix.customary, "l/m3", *volumes, digits=3)

    words = (
        f"{shown(mix.paste_share)} of powder and water; the voids between {shown(mix.sand_and_stone)} "
        f"of aggregate have {shown(*needed)} (void content {100 * low:.3g} to "
        f"{100 * high:.3g} %, {measured})"
    )
    if mix.paste_share > needed[1]:
        return RuleVerdict(name, "fine", words, "", source)
    more = f"add {both(mix.customary, 'l/m3', needed[1] - mix.paste_share, digits=2)} of paste or improve the grading"
    more += "" if mix.voids is not None else "; measure the voids and state them, as in 'voids: 24 %'"
    return RuleVerdict(name, "blocks" if mix.paste_share < needed[0] else "risky", words, more, source)


def sand_share(mix: MixEntries) -> RuleVerdict:
    """Compare the share of sand in the aggregate with the shares in concretes that have been pumped.

    The verdict also states the range that the standard JGJ/T 10 requires. Too little sand is a risk: in the tests of
    Tuutti (1976), pumping failed suddenly above a certain share of stones.
    """
    name, source = "sand", f"{JGJ}; {SHEN}; Tuutti 1976"
    share = mix.sand_share
    if share is None:
        advice = "add 'parts' to the mix, with separate entries for sand and gravel"
        if mix.parts:
            advice = (
                "use separate entries for sand and gravel in 'parts', or state the volume share of the gravel, "
                "as in 'aggregate: 36 %'"
            )
        return RuleVerdict(name, "unknown", "the share of sand in the aggregate is not known", advice, source)
    words = (
        f"{100 * share:.3g} % of the aggregate; {JGJ} requires {100 * SAND_SHARES[0]:g} to "
        f"{100 * SAND_SHARES[1]:g} %; concretes with {100 * PUMPED_SAND_SHARES[0]:.3g} to "
        f"{100 * PUMPED_SAND_SHARES[1]:g} % have been pumped"
    )
    if share < PUMPED_SAND_SHARES[0] - 1e-9:
        return RuleVerdict(name, "risky", words, "replace some of the stones by sand", source)
    if share > PUMPED_SAND_SHARES[1] + 1e-9:
        return RuleVerdict(name, "risky", words, "replace some of the sand by stones, or add paste", source)
    return RuleVerdict(name, "fine", words, "", source)


def fine_sand(mix: MixEntries) -> RuleVerdict:
    """Compare the share of fine sand with the range in which concrete neither segregates nor becomes sticky."""
    name, source = "fine sand", "GB 50119; a Japanese check list"
    sieve = "0.3 mm (No. 50 sieve)" if mix.customary else "0.3 mm"
    if mix.fine_sand is None:
        return RuleVerdict(name, "unknown", f"the share of the sand finer than {sieve} is not known",
                           "add this share to the mix, as in 'fine_sand: 18 %'", source)  # fmt: skip
    low, high = FINE_SAND
    words = f"{100 * mix.fine_sand:.3g} % of the sand is finer than {sieve}; {100 * low:g} to {100 * high:g} % is safe"
    if mix.fine_sand < low - 1e-9:
        return RuleVerdict(name, "risky", words, "blend with a finer sand, or add powder", source)
    if mix.fine_sand > high + 1e-9:
        return RuleVerdict(name, "risky", words, "blend with a coarser sand", source)
    return RuleVerdict(name, "fine", words, "", source)


def bleeding(mix: MixEntries) -> RuleVerdict:
    """Judge whether pressure can squeeze water out of the concrete, so that a plug of dry stones is left."""
    name, source = "bleeding", f"{BLEEDING}; limits: {JGJ}, and Indian practice"
    ratio, water = mix.water_binder, water_mass(mix.parts)
    if ratio is None:
        return RuleVerdict(name, "unknown", "the ratio of water to binder is not known",
                           "add 'parts' or 'water_binder' to the mix", source)  # fmt: skip
    words, good = f"water-binder ratio {ratio:.2f}; {WATER_BINDER:.2f} or less is safe", ratio <= WATER_BINDER
    if water > 0:
        sand = mix.sand_mass * (FINE_SAND[0] if mix.fine_sand is None else mix.fine_sand)
        fines = (powder_mass(mix.parts) + sand) / water
        words += f"; mass of powder and fine sand {fines:.2f} times the water, {FINES_PER_WATER:g} or more is safe"
        good = good and fines >= FINES_PER_WATER
    if good:
        return RuleVerdict(name, "fine", words, "", source)
    if mix.thickener:
        return RuleVerdict(name, "fine", f"{words}; the viscosity-modifying admixture holds the water", "", source)
    if ratio <= WATER_BINDER and mix.sand_mass == 0:
        return RuleVerdict(name, "unknown", f"{words}; the mass of the sand is not known, and 0 is assumed",
                           "add 'parts' to the mix, with separate entries for sand and gravel", source)  # fmt: skip
    return RuleVerdict(name, "risky", words, "reduce the water, add powder or a viscosity-modifying admixture, and "
                       "measure the bleeding under pressure (GB/T 50080: 10 s and 140 s at "
                       f"{both(mix.customary, 'MPa', 3.5e6)})", source)  # fmt: skip


def slump(mix: MixEntries) -> RuleVerdict:
    """Judge whether the slump or the spread of the concrete lies in the range that is usual for pumping.

    Stiffer concrete does not fill the cylinder of the pump, and wetter concrete segregates.
    """
    name, source = "consistency", f"{JGJ}; B. Palmer, jlconline.com; {SHEN}"
    least, usual, largest = SLUMPS

    def shown(*sizes: float) -> str:
        return both(mix.customary, "mm", *sizes)

    if mix.spread is not None:
        words = f"spread {shown(mix.spread)}; concretes with up to {shown(LARGEST_SPREAD)} have been pumped"
        if mix.spread < SELF_COMPACTING and mix.slump is None:
            return RuleVerdict(name, "unknown", f"{words}; the spread is assumed to come from a cone without jolts",
                               "if a flow table with jolts was used (EN 12350-5), state the slump instead, because "
                               "the concrete is then much stiffer", source)  # fmt: skip
        if mix.spread <= LARGEST_SPREAD:
            return RuleVerdict(name, "fine", words, "", source)
        return RuleVerdict(name, "risky", words, "lower the spread; check that stones do not sink", source)
    if mix.slump is None:
        return RuleVerdict(
            name, "unknown", "neither slump nor spread is known", "add 'slump' or 'spread' to the mix", source
        )
    words = f"slump {shown(mix.slump)}; {shown(usual, largest)} are usual"
    if mix.slump < usual - 1e-9:
        stiff, change = mix.slump < least - 1e-9, "raise the slump with a plasticizer, not with water"
        limit = f"; concrete below {shown(least)} cannot be pumped" if stiff else ""
        return RuleVerdict(name, "blocks" if stiff else "risky", words + limit, change, source)
    if mix.slump > largest + 1e-9 and (mix.thickener or mix.plasticizer):
        cause = "superplasticizer" if mix.plasticizer else "viscosity-modifying admixture"
        return RuleVerdict(name, "fine", f"{words}; a {cause}, as in this mix, allows more", "", source)
    if mix.slump > largest + 1e-9 and not mix.parts:
        words += "; a larger slump needs a superplasticizer"
        return RuleVerdict(name, "unknown", words, "add 'parts' to the mix, with its superplasticizer", source)
    if mix.slump > largest + 1e-9:
        return RuleVerdict(name, "risky", words, "reach this slump with a superplasticizer, not with water, and add "
                           "the superplasticizer to 'parts'", source)  # fmt: skip
    return RuleVerdict(name, "fine", words, "", source)


def lightweight(mix: MixEntries) -> Iterator[RuleVerdict]:
    """Yield a verdict on lightweight concrete, whose aggregate absorbs water under the pressure of the pump.

    Yield nothing if the concrete is not lightweight.
    """
    if mix.density >= LIGHTWEIGHT:
        return
    name, us = "lightweight aggregate", mix.customary
    words, good = f"density {both(us, 'kg/m3', mix.density)}", True
    if mix.slump is None and mix.spread is None and not mix.parts:
        yield RuleVerdict(name, "unknown", words, "add 'slump' or 'parts' to the mix", CHECK_LIST)
        return
    if mix.slump is not None and mix.spread is None:
        words += f"; slump {both(us, 'mm', mix.slump)}, more than {both(us, 'mm', LIGHTWEIGHT_SLUMP)} is safe"
        good = mix.slump > LIGHTWEIGHT_SLUMP + 1e-9
    if mix.parts:
        cement = cement_mass(mix.parts)
        words += f"; {both(us, 'kg/m3', cement)} of cement, more than {both(us, 'kg/m3', LIGHTWEIGHT_CEMENT)} is safe"
        good = good and cement > LIGHTWEIGHT_CEMENT
    change = "soak the aggregate before mixing, raise the slump with a plasticizer, or add cement, and test the pumping"
    yield RuleVerdict(name, "fine" if good else "risky", words, "" if good else change, CHECK_LIST)


def behind_reducers(line: PipeLine) -> Iterator[RuleVerdict]:
    """Yield the verdict "risky" for each reducer that narrows and has too little straight pipe behind it.

    Stones separate from the mortar in a reducer, and a long enough straight pipe behind it mixes them again.
    """
    for here, part in enumerate(line.parts):
        if part.kind != "reducer" or part.outlet >= part.diameter:
            continue
        run = 0.0
        for after in line.parts[here + 1 :]:
            if after.kind != "straight":
                break
            run += after.length
        else:
            run = math.inf
        follows, required = (both(line.customary, "m", length, digits=3) for length in (run, TAPER_RUN))
        words = f"{follows} of straight pipe behind part {part.number}, {part.label}; {required} is required"
        if run < TAPER_RUN:
            yield RuleVerdict("behind a reducer", "risky", words, "move the next bend or hose downstream", JGJ)


def rule_lines(verdicts: Sequence[RuleVerdict], where: str = "") -> list[str]:
    """Return lines of text: first the answer to "will it block?", then the verdicts of the rules, the worst first.

    `where` describes the part of the line to which the answer applies, such as the narrowest part.
    """
    counts = [f"{sum(each.verdict == name for each in verdicts)} {name}" for name in reversed(VERDICTS)
              if any(each.verdict == name for each in verdicts)]  # fmt: skip
    order = sorted(verdicts, key=lambda each: -VERDICTS.index(each.verdict))
    unknown = sum(each.verdict == "unknown" for each in verdicts)
    answer = ANSWERS[worst(verdicts)]
    if worst(verdicts) == "unknown" and 2 * unknown > len(verdicts):
        answer = TOO_LITTLE
    return [
        f"will it block? {answer} ({', '.join(counts)}{f'; {where}' if where else ''})",
        *(line for each in order for line in each.text.splitlines()),
    ]


def rule_records(verdicts: Sequence[RuleVerdict]) -> Record:
    """Return the verdicts of rules of practice on whether a line will block, as a mapping for a JSON file.

    The entry "rules" contains the verdict of each rule, and "worst" the worst of these verdicts, such as "risky".
    """
    return {"worst": worst(verdicts), "rules": [each.record() for each in verdicts]}
