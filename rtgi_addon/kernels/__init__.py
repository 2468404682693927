"""The numba vocabulary: functions on arrays and scalars, with no knowledge of frames, lights or Blender."""
