"""Access to devices: kernel launches, CUDA graphs, CPU threads, asynchronous copies, and the handling of interrupts.

Modules here import only Warp, NumPy, `kernels.common`, the modules of `core` itself and each other. Start with
`launching`, which turns a kernel and its arguments into a stage of a time step.
"""
