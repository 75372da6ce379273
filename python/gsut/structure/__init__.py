"""Structure from motion: photographs and a lens in, camera poses and points out."""
