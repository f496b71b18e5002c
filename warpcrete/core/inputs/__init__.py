"""Reading and checking of users' inputs: parameters, amounts with units, limits, YAML, CSV and JSON files.

Modules here import only the modules of `core` itself and each other. Start with `parameters`, which turns declared
fields into options and checks their values.
"""
