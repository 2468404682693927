"""Errors against Cycles one-bounce: metrics, reference, pictures and benchmarks."""
