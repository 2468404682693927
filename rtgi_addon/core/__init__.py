"""Frames, cameras, lights, units and parameters: numpy only, no Blender and no numba."""
