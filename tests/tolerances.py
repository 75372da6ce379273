"""Every tolerance of the Python tests: value, reason, worst seen. One section a folder."""
