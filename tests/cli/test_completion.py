"""Tests of shell completion: options, names and units."""

import os
import subprocess
import sys

import pytest
from click.shell_completion import ShellComplete

from warpcrete.cli.main import cli
from warpcrete.core.inputs.amounts import amount
from warpcrete.core.inputs.hyphens import spelled
from warpcrete.geometry.lines import shipped_lines
from warpcrete.scenes import modules
from warpcrete.studies.reproduction.reproduce import chosen


def completed(line: str) -> list[str]:
    """Return the completions of the last word of a line; paths of files are <files>."""
    *words, incomplete = line.split(" ")
    found = ShellComplete(cli, {}, "warpcrete", "").get_completions(words, incomplete)
    return ["<files>" if each.type == "file" else each.value for each in found]


VALUES = {
    "run pi": ["pipe"],
    "run pipe --unit ": ["vertical", "horizontal", "bend-to-horizontal", "bend-to-vertical"],
    "run pipe --plug b": ["balls"],
    "run pipe --concrete z": ["zhan", "zhan-table1", "<files>"],
    "run pipe --contact h": ["hertz-mindlin"],
    "run tube --concrete o": ["own", "<files>"],
    "run tube --flow 35m3/": ["35m3/s", "35m3/h", "35m3/min"],
    "run tube --diameter 125m": ["125m", "125mm"],
    "run tube --diameter ": [],
    "run tube --device c": ["cpu", "cuda"],
    "run --method dem slum": ["slump", "slump-dem"],
    "run slump --method dem --contact h": ["hertz-mindlin"],
    "study slump --method dem --mould-g": ["--mould-grip"],
    "study --method dem slum": ["slump", "slump-dem"],
    "run slump --method ": ["mps", "dem", "suspension"],
    "run pipe --wall ": ["analytic", "mesh", "<files>"],
    "run pipe --shapes re": ["reference", "<files>"],
    "run pipe --sizes ": ["gaussian", "uniform"],
    "run tube --accuracy 5": ["5%"],
    "trade tube --budget 20": ["20s", "20min", "20h"],
    "trade slump --quantity t5": ["t500"],
    "trade tube --knob ": ["spacing", "time-step", "tolerance", "regularisation", "precision", "steadiness"],
    "trade pipe --hydration 0.1 --knob h": ["hydrated-stiffness", "hydrated-bonds"],
    "trade pipe --knob h": [],
    "line x.yaml --gauge 2b": ["2bar"],
    "line ": [*shipped_lines(), "<files>"],
    "line x.yaml --flow 30m3/h": ["30m3/h"],
    "line x.yaml --concrete no": ["no1", "no2", "no3", "<files>"],
    "mix e": ["example-scc", "<files>"],
    "theory --concrete no": ["no1", "no2", "no3", "<files>"],
    "theory --rest 10": ["10s", "10ms", "10min", "10h"],
    "schema ": ["concrete", "line", "mix", "targets"],
    "reproduce ": ["xu", "zhan"],
    "reproduce zhan --only y": ["yielding-layer"],
    "reproduce zhan --only hydrated": ["hydrated-fraction", "hydrated-modulus"],
    "verify --only a": ["assemblies", "angle-of-repose", "aggregates-in-mortar"],
    "validate --kind sl": ["slump"],
    "study ": list(modules()),
    "study pipe --vel": ["--velocity"],
    "study pipe --velocity 0.1 30c": ["30cm/s"],
    "study pipe --velocity 0.1 --unit vertical h": ["horizontal"],
    "study pipe --bonds ": ["true", "false"],
    "study pipe --repeat ": [],
    "study pipe --prec": ["--precision"],
    "study pipe --precision float6": ["float64"],
    "study pipe --contact hertz-mindlin --contact-unl": ["--contact-unloading"],
    "study pipe --contact wrong --ela": [],
    "study pipe --contact wrong --diam": ["--diameter"],
    "study pipe --resume ": ["<files>"],
    "study --sched": ["--scheduler"],
    "study --method d": ["dem"],
    "trade tube --kn": ["--knob"],
    "explain slump --yield": ["--yield-stress", "--yield-factor"],
    "calibrate ": ["<files>"],
    "calibrate targets.yaml --tri": ["--trials"],
}  # fmt: skip


@pytest.mark.parametrize("line", VALUES)
def test_values_are_completed(line):
    assert completed(line) == VALUES[line]


@pytest.mark.parametrize(
    "line", ["run tube --flow 2", "run slump --density 2", "run tube --pressure 2", "line x --rise 2"]
)
def test_every_completed_unit_is_accepted(line):
    unit = {"--flow": "m3/s", "--density": "kg/m3", "--pressure": "Pa", "--rise": "m"}[line.split()[-2]]
    found = completed(line)
    assert len(found) > 3 and len({amount("value", each, unit) for each in found}) > 2


def test_hyphens_replace_the_spaces_of_names():
    assert chosen("zhan", ["stiff-stones", "elbow radius", "units"]) == (["stiff stones"], ["units", "elbow radius"])
    assert spelled("time-steps", ["time step"]) == "time-steps"


def test_a_shell_gets_completions():
    words = {"COMP_WORDS": "warpcrete study pipe --unit v", "COMP_CWORD": "4", "_WARPCRETE_COMPLETE": "bash_complete"}
    code = "from warpcrete.cli.main import main; main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", env=os.environ | words)
    assert done.stdout == "plain,vertical\n" and done.stderr == ""
