"""Studies that run many scenes: parameter studies, calibrations, trade-offs, reproductions and whole pump lines.

Modules here import `record`, `scenes`, `methods` and everything below them. Start with `study`, and go on with
`running` and `workers`, which distribute the runs.
"""
