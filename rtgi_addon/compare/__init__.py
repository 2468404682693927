"""Measuring: metrics, references by Cycles, tables, pictures, benchmarks. Only `reference` and `rooms` import Blender."""
