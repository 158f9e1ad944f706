"""Timings of jaxlens and of its peers in one run. `python -m benchmarks` writes README.md; see its first lines."""
