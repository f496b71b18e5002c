"""Comparison of blind predictions with measurements that are shipped with the package.

Modules here import `core`, `theory`, `geometry`, `mix` and `studies.lines`. The module `cases` reads the measurements,
`predictions` calculates the predictions, and `validate` compares them.
"""
