"""Trade-off studies: measured errors and costs of the accuracy settings of a scene.

Modules here import `core`, `methods`, `record` and the modules of `studies` itself. Start with `trade`, which runs a
study. Go on with `fronts`, which keeps the cheapest settings.
"""
