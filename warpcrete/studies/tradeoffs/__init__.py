"""Trade-off studies: measured errors and costs of the accuracy settings of a scene.

Modules here run a scene with many settings and keep the cheapest ones. Start with `trade`.
"""
