"""Help texts of the command line."""

MIX_HELP = """What follows from a mix: `warpcrete mix MIX.yaml`.

A table of yield stress, viscosity, slip layer, mortar and sizes: each value with its band, from what it follows, and
after whom. The file goes wherever --concrete takes one.

\b
  mix:
    density: 2350 kg/m3                  # or parts: {cement: 340 kg/m3, water: 170 kg/m3, ...}
    aggregate: 36 %                      # coarse, of the volume; or 360 l/m3, or 950 kg/m3
    sieve: {4: 0, 8: 0.4, 16: 1}         # of it, mm: what passes; or sizes: [4 mm, 16 mm]
    shape: crushed                       # rounded, or longest over shortest width
    spread: 650 mm                       # with t500: 3.5 s; or slump: 180 mm, or
    # concrete: {yield_stress: 60 Pa, viscosity: 40 Pa s, uncertainty: 15 %}, or of its mortar, or
    # viscometer: [[5, 210], [20, 660]]  # 1/s and Pa, or a .csv file
    layer: {yield_stress: 20 Pa, viscosity: 900 Pa s/m}
    # or {points: points.csv, diameter: 125 mm, length: 12 m}: flows and pressures; or {tribometer: [[0.2, 110], ...]}
"""
