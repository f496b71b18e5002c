"""Help text of the command `warpcrete mix`, which is too long for the module of the commands."""

MIX_HELP = """Derive the properties of a concrete from its mix: `warpcrete mix MIX.yaml`.

The command prints a table of yield stress, viscosity, slip layer, mortar and aggregate sizes: each value with its
uncertainty band, the entry of the mix from which it is derived, and the source of the formula. It also prints what the
rules of practice say about blocking: fine, risky, blocks, or which entry would answer. The option --concrete of other
commands accepts the file.

\b
  mix:
    density: 2350 kg/m3                  # or parts: {cement: 340 kg/m3, water: 170 kg/m3, ...}
    aggregate: 36 %                      # coarse aggregate, share of the volume; or 360 l/m3, or 950 kg/m3
    sieve: {4: 0, 8: 0.4, 16: 1}         # sieve curve: opening [mm] and share that passes; or sizes: [4 mm, 16 mm]
    shape: crushed                       # or rounded, or the ratio of longest to shortest width
    spread: 650 mm                       # also t500: 3.5 s; or one of slump, concrete, mortar, viscometer:
    # slump: 180 mm
    # concrete: {yield_stress: 60 Pa, viscosity: 40 Pa s, uncertainty: 15 %}      # the same keys for mortar
    # concrete: {yield_stress: 60 Pa, viscosity: 30 Pa s, flow_index: 1.3}        # or quadratic_viscosity: 0.5 Pa s2
    # viscometer: [[5, 210], [20, 660]]  # shear rate [1/s] and stress [Pa], or a .csv file
    voids: 24 %                          # voids of sand and stones together; fine_sand: 18 % of it is below 0.3 mm
    layer: {yield_stress: 20 Pa, viscosity: 900 Pa s/m}                           # slip layer; or one of:
    # layer: {points: points.csv, diameter: 125 mm, length: 12 m}                 # flows and pressures of a pipe
    # layer: {tribometer: [[0.2, 110], [0.4, 190]]}                               # slip velocity [m/s], stress [Pa]
"""
