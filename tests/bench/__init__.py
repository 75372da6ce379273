"""Benchmarks and their rivals: speed with error. `./run bench --help` lists them."""
