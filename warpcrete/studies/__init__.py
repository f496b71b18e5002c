"""Studies that run many scenes: parameter studies, calibrations, trade-offs, reproductions and whole pump lines.

Modules here import `record`, `scenes`, `methods` and everything below them. Start with the module `study`, which
defines parameter studies. The modules `running` and `workers` distribute their runs.
"""
