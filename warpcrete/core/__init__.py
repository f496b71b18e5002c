"""Code that all simulation methods share: errors, units, inputs, devices, drawing and the run loop.

Modules here import `kernels.common` and each other, but no geometry and no simulation method. The modules of this
folder import none of its subpackages. Start with `run.run_loop`, and go on with `run.method`, the interface of a
simulation method.
"""
