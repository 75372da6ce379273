"""How much of a dataset the doctor's checks examine, and what they trust."""

SIDE = 640  # pixels of the images on which pixels and lenses are checked
