"""Trade-off studies: measured errors and costs of the accuracy settings of a scene.

Modules here import `core`, `methods`, `record`, `scenes` and the modules of `studies` itself. To read the code, start
with `trade`, which runs a study, and continue with `fronts`, which contains the statistics. The module `explain`
forecasts the cost of a single run.
"""
