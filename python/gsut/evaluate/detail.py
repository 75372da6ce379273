"""Measures how much of a photograph's detail a render shows in the right place.

PSNR falls with fog in a sky and with brightness as much as with blur. The contrast and structure
term of SSIM (Wang et al., 2004) compares what an eye calls sharp: local contrast, not its level.
"""

from __future__ import annotations

import numpy as np

# Longer side in pixels at which pictures are compared: that of a picture on a page.
_SIDE = 800
# Standard deviation in pixels of the window in which contrast is measured, as in SSIM.
_WINDOW = 1.5
# Contrast, of full scale, below which a place shows no detail: SSIM's constant K2.
_CONTRAST = 0.03
# Contrast-structure term above which a detail is right: half of a perfect one.
_RIGHT = 0.5


def measure_detail(photograph: np.ndarray, image: np.ndarray, mask: np.ndarray) -> float:
    """Measures the share of a photograph's detail that a render shows in the right place.

    Args:
        photograph: (H, W, 3) uint8.
        image: (H, W, 3) of the render in [0, 1], in the photograph's light.
        mask: (H, W) bool; True where pixels count.

    Returns:
        From 0 to 1, of the pixels whose surroundings have contrast; of all pixels where none have.
    """
    import cv2

    factor = min(1.0, _SIDE / max(mask.shape))
    size = max(1, round(mask.shape[1] * factor)), max(1, round(mask.shape[0] * factor))
    pictures = (photograph.astype(np.float32) / np.float32(255), image.astype(np.float32))
    truth, shown, weight = (
        cv2.resize(each, size, interpolation=cv2.INTER_AREA)
        for each in (*(picture.mean(axis=2) for picture in pictures), mask.astype(np.float32))
    )

    def average(values: np.ndarray) -> np.ndarray:
        return cv2.GaussianBlur(values, (0, 0), _WINDOW)

    means = average(truth), average(shown)
    variances = [average(x * x) - m * m for x, m in zip((truth, shown), means, strict=True)]
    covariance = average(truth * shown) - means[0] * means[1]
    least = _CONTRAST**2
    right = (2 * covariance + least) / (variances[0] + variances[1] + least) > _RIGHT
    counts = average(weight) > 1 - 1e-3
    detail = counts & (variances[0] > least)
    chosen = next((each for each in (detail, counts) if each.any()), np.ones_like(counts))
    return float(right[chosen].mean())
