"""How much of a dataset the doctor's checks examine, and what they trust."""

FEWEST = 30  # samples of which a median is trusted
SIDE = 640  # pixels of the images on which pixels and lenses are checked
