"""Help texts of the commands `mix`, `study`, `trade`, `calibrate`, `line` and `explain`."""

MIX_HELP = """Derive the properties of a concrete from its mix: `warpcrete mix MIX.yaml`.

The command prints a table of yield stress, viscosity, slip layer, mortar and aggregate sizes: each value with its
uncertainty band, the entry of the mix from which it is derived, and the source of the formula. It also prints the
verdict of each rule of practice on blocking: fine, risky, blocks, or unknown, with the entry that the rule needs. The
option --concrete of other commands accepts the file.

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
    voids: 24 %                          # voids of sand and stones together; fine_sand: 18 % (sand below 0.3 mm)
    layer: {yield_stress: 20 Pa, viscosity: 900 Pa s/m}                           # slip layer; or one of:
    # layer: {points: points.csv, diameter: 125 mm, length: 12 m}                 # flows and pressures of a pipe
    # layer: {tribometer: [[0.2, 110], [0.4, 190]]}                               # slip velocity [m/s], stress [Pa]
"""

ON_WORKERS = """\
  --scheduler WHICH      run on Dask workers (pip install 'warpcrete[cluster]'): 'local' starts one per GPU or core,
                         'slurm' submits jobs by Dask's configuration; or the address of a running scheduler
  --workers N            number of workers that the scheduler starts
"""

STUDY_HELP = f"""Run a scene with many values: `warpcrete study SCENE --PARAMETER VALUE VALUE ... [options]`.

The command `warpcrete run SCENE --help-all` lists the parameters of a scene. Each takes one value or several. Every
combination of the values is a case. On a GPU, cases of discrete elements run in batches, and flows side by side. On a
CPU, cases run in parallel processes, one per core. The folder holds study.md, study.csv, study.png and a run folder
for each case. Tables and figures show a parameter in the unit in which its values are given, as in --flow 5m3/h
10m3/h.

\b
  --repeat N             run every case with N seeds                                      [default: 1]
  --one-at-a-time        vary one parameter at a time and keep the others at their defaults
  --out FOLDER           new folder                                                       [default: runs/study-NNN]
  --resume FOLDER        continue a study; finished cases are not run again
  --device, --precision  as for run
  --processes N          number of parallel processes on a CPU, each with one thread      [default: one per core]
{ON_WORKERS}  --frames, --checkpoint-every, --rerun and other recorders   as for run; recordings are off by default
  --quiet                show no progress bar

The exit code is 1 if a case failed, 3 if all cases finished but one of them failed a check, and 130 if the study was
interrupted.
"""

TRADE_HELP = f"""Measure speed against accuracy of a scene: `warpcrete trade SCENE [--PARAMETER VALUE ...] [options]`.

The command varies the settings that trade accuracy for speed (time step, precision, sizes, walls, spacing ...), first
each alone, then together. It finds the cheapest settings for errors of 20 % down to 1 % and verifies them with new
seeds. Runs take place one at a time, or one on each worker. The folder holds trade.md, trade.csv, trade.json, trade.png
and a run folder for each run.

\b
  --budget TIME          total wall time, such as 90s, 20min or 2h                        [default: 20min]
  --quantity NAME ...    quantities of result.json whose errors are measured              [default: the scene's]
  --knob NAME ...        settings that are varied, such as time-step                      [default: all of the scene]
  --repeat N             number of seeds of each setting                                  [default: 3]
  --out FOLDER           new folder                                                       [default: runs/trade-NNN]
  --resume FOLDER        continue a trade for another --budget; its finished runs are kept
  --device, --threads    as for run; workers have this number of threads each             [default of workers: 1]
{ON_WORKERS}  --quiet                show no progress bar

The exit code is 2 for bad input and 130 if the trade was interrupted.
"""

CALIBRATE_HELP = f"""Find a concrete's parameters from measured results: `warpcrete calibrate TARGETS.yaml [options]`.

The file lists the measured quantities of scenes with their uncertainties, and the parameters to find with the range of
each. New runs are placed where the answer is likely, until further runs would no longer change it. The folder holds
calibration.md and calibration.png (the parameters that fit the data, and those that the data do not determine),
answer.json, concrete.yaml (for --concrete), and all runs.

\b
  vary:
    viscosity: [10, 100]
    yield_stress: [20, 200]
  targets:
    - {{scene: slump, parameters: {{concrete: own, density: 2350}}, quantity: spread, value: 0.55, uncertainty: 2%}}
    - {{scene: funnel, parameters: {{concrete: own, density: 2350}}, quantity: funnel_time, value: 9, uncertainty: 5%}}
    - {{scene: slump, parameters: {{concrete: own, density: 2350}}, quantity: t500, value: 4, uncertainty: 10%,
       held_out: true}}

\b
  --trials N             maximum number of trials, each of which runs all scenes; coarse trials at the beginning
                         and runs that verify the answer do not count    [default: 10 + 10 per parameter]
  --batch N              number of trials in a round; a coarse round at the beginning has twice as many, and each
                         round after it half as many                     [default: 4 + 2 per parameter]
  --repeat N             number of seeds of the final check              [default: 3]
  --seed N               seed of the search                              [default: 0]
  --out FOLDER           new folder                                      [default: runs/calibration-NNN]
  --resume FOLDER        continue a calibration, also with more --trials; its finished runs are kept
  --device, --precision, --processes   as for study
{ON_WORKERS}  --quiet                show no progress bar

The exit code is 2 for bad input and 130 if the calibration was interrupted. The command needs pip install
'warpcrete[calibrate]'.
"""

LINE_HELP = """Compute the pressure that a pipeline needs: `warpcrete line LINE.yaml [options]`.

Without a file, a straight line and a slump suffice: `warpcrete line --slump 180mm --stone 20mm --diameter 125mm
--length 190m --rise 20m --flow 30m3/h`. Without --flow, it prints the pressure for usual flows.

The file lists the parts of the pipeline in order. The answer comes at once, from theory and from factors of earlier
simulations. Parts that are sharper than all earlier simulated ones are simulated now, unless --theory is given. With
--simulate, each different part is simulated once as a flow; a straight pipe is simulated once and its pressure scaled
with its length. --method dem simulates the parts with discrete elements, --method both with both methods, in one
table. A folder (--out) holds line.md, line.json, line.png (pressure along the line) and the runs, which another line
can reuse with --known. Two lines are shipped: burj-khalifa and shanghai-tower.

\b
  diameter: 125 mm
  flow: 30 m3/h
  concrete: no1                 # or a file, as for run
  largest_stone: 16 mm
  pump: {pressure: 85 bar, flow: 90 m3/h, power: 110 kW}      # optional, from its data sheet
  begin: level                  # up, down
  parts:
    - straight: 10 m
    - bend: {to: up, radius: 0.5 m}               # to: up, down, left, right, level, back; with angle: 45 it turns
                                                  # only 45 degrees towards it
    - straight: {length: 20 m}
    - reducer: {to: 100 mm, length: 1 m}
    - hose: {points: [[1, 0, -0.2], [2, 0.5, -1]]}    # relative to its start: ahead, left, up [m]
    - bend: level                 # radius 0.5 m, or two diameters if these are larger
    - valve: {equivalent: 20 m}   # as much friction as 20 m of straight pipe; any part may have this entry
    - hose: {length: 4 m, factor: 2.5}            # or its friction divided by that of straight pipe of its length
    - bore: {file: valve.stl, scale: 0.001, length: 0.6, outlet: 100 mm}
    - straight: 5 m

A bore is a mesh of the inner surface that begins at its origin and leads along its x axis. Its path is relative to the
folder of LINE.yaml. Its outlet has the diameter of the line unless `outlet` is given. The mesh must hold the bore
alone; straight pipe is added before and behind it.

Rules of practice say whether the mix may block the narrowest part. --blocking 50 also simulates that part with 50 seeds
and prints the probability of a blockage.

To simulate a short line as one scene: warpcrete run part --line LINE.yaml, as a flow or with --method dem.

Values without a unit are in m, m3/s, Pa and degrees. The exit code is 3 if a check of a part failed.
"""

EXPLAIN_HELP = """Estimate the cost of a run beforehand: `warpcrete explain SCENE [--PARAMETER VALUE ...] [options]`.

The command prints the compiled features and why they are needed, the memory by part, the time step and what limits it,
the number of steps and the wall time on this device, and the changes that would shorten the run most. It simulates the
scene for a few seconds to measure this, and keeps the result in the user's cache. If kernels for this kind of scene
have not been compiled yet, it compiles them first, which can take minutes; so does the first run. The estimated wall
time does not include compilation.

\b
  --trade FOLDER         folder of a 'warpcrete trade' of this scene, which gives the errors
                         of the proposed changes                                          [default: a shipped one]
  --device, --threads    as for run
  --fresh                measure again and ignore the cache
"""
