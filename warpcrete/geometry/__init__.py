"""Geometry shared by both methods: pipe axes, triangle meshes, walls, and pipelines read from files."""
