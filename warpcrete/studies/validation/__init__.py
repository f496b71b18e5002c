"""Comparison of blind predictions with measurements that are shipped with the package.

Modules here import `core`, `theory`, `geometry`, `mix`, `mps.common`, `methods`, `scenes` and `studies.lines`. To read
the code, start with `validate`, which compares predictions with measurements; the module `cases` reads the
measurements, and `predictions` calculates the predictions.
"""
