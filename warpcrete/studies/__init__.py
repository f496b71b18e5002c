"""Studies that run many scenes: parameter studies, calibrations, trade-offs, reproductions and whole pump lines.

Modules here may import all packages of warpcrete except `cli`. To read the code, start with the module `study`, which
defines parameter studies. The modules `running` and `workers` distribute the runs of a study over a GPU or processes.
"""
