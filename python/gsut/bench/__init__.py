"""`gsut bench`: speed with error, never one alone. One module a measurement.

Nothing is imported here: the command line asks for a measurement by name (see arguments.py).
"""
