"""Comparison of blind predictions with measurements that are shipped with the package.

Modules here import `core`, `theory`, `geometry`, `mix` and `studies.lines`. Start with `cases` for the
measurements, `predictions` for what is calculated, and `validate` for the comparison.
"""
