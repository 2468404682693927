"""Measuring: metrics, references by Cycles, tables, pictures and benchmarks. Only `reference` imports Blender."""
