"""Descriptions of concretes as mixes, for tests, and a function that writes them to a file."""

from warpcrete.core.inputs.yaml_files import yaml_text

SPREADING = {"density": "2300 kg/m3", "spread": "600 mm", "t500": "4 s"}
STONES = {"aggregate": "36 %", "sieve": {4: 0, 8: 0.4, 16: 1}, "shape": "crushed"}
BULK = {"density": 2300, "concrete": {"yield_stress": 60, "viscosity": "40 Pa s", "uncertainty": "10 %"}}


def written(folder, section, name="mix.yaml", **more):
    path = folder / name
    path.write_text(yaml_text({"mix": section, **more}), encoding="utf-8")
    return path
