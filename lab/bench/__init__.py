"""Benchmarks that settle questions, beside those whose tables the pages show."""
