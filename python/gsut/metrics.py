"""More image metrics: PSNR by field angle, weighted, and with colours corrected."""

from gsut.render import color_corrected_psnr, ring_psnr, weighted_psnr

__all__ = ["color_corrected_psnr", "ring_psnr", "weighted_psnr"]
