"""What is measured during a run of discrete elements: series, stresses, segregation, blockage, wear, results.

Modules here read the arrays of `dem.engine` and never change them. Start with `sampling`, which fills the rows.
"""
