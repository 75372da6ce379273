"""Tolerances of the viewer."""

# relative, and scene units of a few: a float32 distance along the ray; worst 1.1e-7
PICKED_POINT = 1e-5
# degrees; bisection in double over a sum of 128 arcs' cosines, each good to 1e-8; worst 2e-6
FIELD_OF_VIEW_DEGREES = 0.01
