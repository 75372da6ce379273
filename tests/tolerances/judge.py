"""Tolerances of the choices between structures."""

ESTIMATED_NOISE = 0.05  # relative, standard deviation of 780 right matches; 0.024
ESTIMATED_SHARE = 0.03  # of 1,120 matches, two of its standard deviations; 0.013
