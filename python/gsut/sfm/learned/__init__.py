"""Features of a neural network, for photographs too far apart for SIFT."""

from gsut.sfm.learned.supplement import add_learned_features
from gsut.sfm.learned.weights import describe_weights
