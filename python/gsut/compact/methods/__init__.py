"""Ways to reduce Gaussians, one a file, found by their names: `ghap-paper` is ghap_paper.py."""
