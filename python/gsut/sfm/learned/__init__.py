"""Features of a neural network, for photographs too far apart for SIFT."""

from gsut.sfm.learned.supplement import add_learned_features

__all__ = ["add_learned_features"]
