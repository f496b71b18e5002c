"""Trade-off studies: measured errors and costs of the accuracy settings of a scene.

Modules here import `core`, `methods`, `record`, `scenes` and the modules of `studies` itself. Start with `trade`, and
go on with `fronts`, which keeps the cheapest settings. The module `explain` forecasts the cost of a single run.
"""
